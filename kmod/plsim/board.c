// SPDX-License-Identifier: GPL-2.0-only
/* From a description to devices, and back. */
#include <linux/err.h>
#include <linux/slab.h>

#include "board.h"
#include "cm_dma.h"

static struct plsim_channel_item *find_channel(struct plsim_board *board, const char *name)
{
	struct plsim_channel_item *channel;

	list_for_each_entry(channel, &board->channels, siblings) {
		if (!strcmp(config_item_name(&channel->item), name))
			return channel;
	}
	return NULL;
}

static int make_engine_node(struct plsim_board *board)
{
	char client[12];
	struct property_entry properties[] = {
		PROPERTY_ENTRY_STRING("fpga-cm,client", client),
		{}
	};

	snprintf(client, sizeof(client), "%d", board->id);
	board->engine_node = fwnode_create_software_node(properties, NULL);
	if (!IS_ERR(board->engine_node))
		return 0;
	return PTR_ERR(xchg(&board->engine_node, NULL));
}

static int make_channel_node(struct plsim_board *board, struct plsim_channel_item *channel)
{
	struct plsim_channel_item *peer = find_channel(board, channel->peer);
	struct property_entry properties[] = {
		PROPERTY_ENTRY_U32("reg", channel->number),
		PROPERTY_ENTRY_STRING("label", config_item_name(&channel->item)),
		PROPERTY_ENTRY_STRING("fpga-cm,kind", channel->kind),
		PROPERTY_ENTRY_U32("fpga-cm,direction", channel->direction),
		PROPERTY_ENTRY_U32("fpga-cm,frame-length", channel->frame_length),
		PROPERTY_ENTRY_U32("fpga-cm,interval-us", channel->interval_us),
		PROPERTY_ENTRY_U32("fpga-cm,fifo", channel->fifo),
		PROPERTY_ENTRY_U32("fpga-cm,idcode", channel->idcode),
		PROPERTY_ENTRY_U32("fpga-cm,peer", peer ? peer->number : U32_MAX),
		{}
	};
	struct fwnode_handle *node = fwnode_create_software_node(properties, board->engine_node);

	if (IS_ERR(node))
		return PTR_ERR(node);
	board->channel_nodes[channel->number] = node;
	return 0;
}

static int number_channels(struct plsim_board *board)
{
	struct plsim_channel_item *channel;
	u32 number = 0;

	list_for_each_entry(channel, &board->channels, siblings) {
		if (number == PLSIM_CHANNELS_MAX)
			return -E2BIG;
		channel->number = number++;
	}
	return number ? 0 : -ENODATA;
}

static struct platform_device *add_device(const char *name, int id, struct fwnode_handle *node,
					  const struct property_entry *properties,
					  const void *data, size_t size)
{
	struct platform_device_info info = {
		.name = name,
		.id = id,
		.fwnode = node,
		.properties = properties,
		.data = data,
		.size_data = size,
	};

	return platform_device_register_full(&info);
}

/* a device of ours has its driver at once, or never */
static int keep_bound(struct platform_device *device, struct platform_device **where)
{
	if (IS_ERR(device))
		return PTR_ERR(device);
	*where = device;
	return device->dev.driver ? 0 : -EINVAL;
}

static int add_engine(struct plsim_board *board)
{
	struct plsim_channel_item *channel;
	int ret = number_channels(board);

	if (!ret)
		ret = make_engine_node(board);
	if (ret)
		return ret;
	list_for_each_entry(channel, &board->channels, siblings) {
		ret = make_channel_node(board, channel);
		if (ret)
			return ret;
	}
	return keep_bound(add_device("cm_plsim_dma", board->id, board->engine_node, NULL, NULL, 0),
			  &board->engine);
}

static int add_client(struct plsim_board *board)
{
	const char *names[PLSIM_CHANNELS_MAX];
	u32 directions[PLSIM_CHANNELS_MAX], types[PLSIM_CHANNELS_MAX];
	u32 lengths[PLSIM_CHANNELS_MAX];
	struct plsim_channel_item *channel;
	struct platform_device *device;
	int count = 0;

	list_for_each_entry(channel, &board->channels, siblings) {
		if (!strcmp(channel->kind, "icap") || !strcmp(channel->kind, "readback"))
			continue;
		names[count] = config_item_name(&channel->item);
		directions[count] = channel->direction;
		types[count] = channel->video ? CM_DMA_TYPE_VDMA : CM_DMA_TYPE_AXIDMA;
		lengths[count] = strcmp(channel->kind, "source") ? 0 : channel->frame_length;
		count++;
	}
	if (!count)
		return 0;
	device = add_device("cm_dma", board->id, NULL,
			    (struct property_entry[]){
		PROPERTY_ENTRY_STRING_ARRAY_LEN("dma-names", names, count),
		PROPERTY_ENTRY_U32_ARRAY_LEN("fpga-cm,directions", directions, count),
		PROPERTY_ENTRY_U32_ARRAY_LEN("fpga-cm,types", types, count),
		PROPERTY_ENTRY_U32_ARRAY_LEN("fpga-cm,frame-lengths", lengths, count),
		{} },
			    NULL, 0);
	if (IS_ERR(device))
		return PTR_ERR(device);
	board->client = device;
	return 0;
}

static bool has_kind(struct plsim_board *board, const char *kind)
{
	struct plsim_channel_item *channel;

	list_for_each_entry(channel, &board->channels, siblings) {
		if (!strcmp(channel->kind, kind))
			return true;
	}
	return false;
}

static int add_icap(struct plsim_board *board)
{
	static const char * const names[] = { "icap", "rx" };
	int count = has_kind(board, "readback") ? 2 : 1;
	struct cm_icap_platform_data data;
	struct plsim_channel_item *channel;
	struct platform_device *device;

	list_for_each_entry(channel, &board->channels, siblings) {
		if (strcmp(channel->kind, "icap"))
			continue;
		if (board->icap)
			return -EINVAL;
		board->port.engine = board->engine;
		board->port.number = channel->number;
		plsim_icap_platform_data(&board->port, &data);
		device = add_device("cm_icap", board->id, NULL,
				    (struct property_entry[]){
					PROPERTY_ENTRY_STRING_ARRAY_LEN("dma-names", names, count),
					PROPERTY_ENTRY_U32("fpga-cm,idcode", channel->idcode),
					PROPERTY_ENTRY_U32("fpga-cm,timeout-ms",
							   channel->timeout_ms),
					{} },
				    &data, sizeof(data));
		if (IS_ERR(device))
			return PTR_ERR(device);
		board->icap = device;
	}
	return 0;
}

static int add_uio(struct plsim_board *board, struct plsim_uio_item *uio, int index)
{
	return keep_bound(add_device("cm_plsim_uio", board->id * PLSIM_UIO_MAX + index, NULL,
				     (struct property_entry[]){
		PROPERTY_ENTRY_STRING("label", config_item_name(&uio->item)),
		PROPERTY_ENTRY_U64("fpga-cm,address", uio->address),
		PROPERTY_ENTRY_U32("fpga-cm,size", uio->size),
		PROPERTY_ENTRY_U32("fpga-cm,doorbell", uio->doorbell),
		{} },
				     NULL, 0),
			  &board->uio[index]);
}

static int add_uios(struct plsim_board *board)
{
	struct plsim_uio_item *uio;
	int index = 0, ret;

	list_for_each_entry(uio, &board->uios, siblings) {
		if (index == PLSIM_UIO_MAX)
			return -E2BIG;
		ret = add_uio(board, uio, index++);
		if (ret)
			return ret;
	}
	return 0;
}

/**
 * plsim_board_activate() - make the devices
 * @board: locked, not live
 *
 * Return: 0 or a negative errno, and then nothing is left of them.
 */
int plsim_board_activate(struct plsim_board *board)
{
	int ret = 0;

	if (!list_empty(&board->channels)) {
		ret = add_engine(board);
		if (!ret)
			ret = add_client(board);
		if (!ret)
			ret = add_icap(board);
	}
	if (!ret)
		ret = add_uios(board);
	if (ret)
		plsim_board_deactivate(board);
	else
		board->live = true;
	return ret;
}

static void drop(struct platform_device **device)
{
	platform_device_unregister(*device);
	*device = NULL;
}

/**
 * plsim_board_deactivate() - take the devices away, clients first
 * @board: locked
 */
void plsim_board_deactivate(struct plsim_board *board)
{
	int i;

	for (i = PLSIM_UIO_MAX - 1; i >= 0; i--)
		drop(&board->uio[i]);
	drop(&board->icap);
	drop(&board->client);
	drop(&board->engine);
	for (i = 0; i < PLSIM_CHANNELS_MAX; i++) {
		fwnode_remove_software_node(board->channel_nodes[i]);
		board->channel_nodes[i] = NULL;
	}
	fwnode_remove_software_node(board->engine_node);
	board->engine_node = NULL;
	board->live = false;
}
