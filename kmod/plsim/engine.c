// SPDX-License-Identifier: GPL-2.0-only
/*
 * A DMA engine without hardware.
 *
 * virt-dma.h belongs to drivers/dma alone, so the little that is needed of it
 * is here.  Data is moved in move.c.
 */
#include <linux/debugfs.h>
#include <linux/dma-mapping.h>
#include <linux/io.h>
#include <linux/mod_devicetable.h>
#include <linux/of.h>
#include <linux/of_dma.h>
#include <linux/platform_device.h>
#include <linux/property.h>
#include <linux/slab.h>

#include "cm_compat.h"
#include "cm_dma.h"
#include "plsim.h"

#define PLSIM_FIFO 65536

static dma_cookie_t plsim_submit(struct dma_async_tx_descriptor *tx)
{
	struct plsim_desc *desc = container_of(tx, struct plsim_desc, tx);
	struct plsim_chan *chan = to_plsim_chan(tx->chan);
	unsigned long flags;
	dma_cookie_t cookie;

	spin_lock_irqsave(&chan->lock, flags);
	cookie = chan->chan.cookie + 1;
	if (cookie < DMA_MIN_COOKIE)
		cookie = DMA_MIN_COOKIE;
	chan->chan.cookie = cookie;
	tx->cookie = cookie;
	list_add_tail(&desc->node, &chan->submitted);
	spin_unlock_irqrestore(&chan->lock, flags);
	return cookie;
}

static struct plsim_desc *desc_new(struct plsim_chan *chan, enum dma_transfer_direction direction,
				   unsigned long flags)
{
	enum dma_transfer_direction own = chan->direction == CM_DMA_MM2S ? DMA_MEM_TO_DEV :
									   DMA_DEV_TO_MEM;
	struct plsim_desc *desc;

	if (direction != own)
		return NULL;
	desc = kzalloc(sizeof(*desc), GFP_NOWAIT);
	if (!desc)
		return NULL;
	dma_async_tx_descriptor_init(&desc->tx, &chan->chan);
	desc->tx.flags = flags;
	desc->tx.tx_submit = plsim_submit;
	desc->lines = 1;
	return desc;
}

static struct dma_async_tx_descriptor *plsim_prep_slave_sg(struct dma_chan *dma_chan,
							   struct scatterlist *sgl,
							   unsigned int sg_len,
							   enum dma_transfer_direction direction,
							   unsigned long flags, void *context)
{
	struct plsim_desc *desc;

	if (sg_len != 1)
		return NULL;
	desc = desc_new(to_plsim_chan(dma_chan), direction, flags);
	if (!desc)
		return NULL;
	desc->address = sg_dma_address(sgl);
	desc->line_bytes = sg_dma_len(sgl);
	return &desc->tx;
}

static struct dma_async_tx_descriptor *plsim_prep_cyclic(struct dma_chan *dma_chan,
							 dma_addr_t address, size_t length,
							 size_t period,
							 enum dma_transfer_direction direction,
							 unsigned long flags)
{
	struct plsim_desc *desc = desc_new(to_plsim_chan(dma_chan), direction, flags);

	if (!desc)
		return NULL;
	desc->address = address;
	desc->line_bytes = length;
	desc->period = period;
	return &desc->tx;
}

static struct dma_async_tx_descriptor *
plsim_prep_interleaved(struct dma_chan *dma_chan, struct dma_interleaved_template *template,
		       unsigned long flags)
{
	struct plsim_desc *desc;

	if (template->frame_size != 1 || !template->numf || !template->sgl[0].size)
		return NULL;
	desc = desc_new(to_plsim_chan(dma_chan), template->dir, flags);
	if (!desc)
		return NULL;
	desc->address = template->dir == DMA_MEM_TO_DEV ? template->src_start :
							  template->dst_start;
	desc->lines = template->numf;
	desc->line_bytes = template->sgl[0].size;
	desc->stride = template->sgl[0].size + template->sgl[0].icg;
	return &desc->tx;
}

static void plsim_issue_pending(struct dma_chan *dma_chan)
{
	struct plsim_chan *chan = to_plsim_chan(dma_chan);
	unsigned long flags;

	spin_lock_irqsave(&chan->lock, flags);
	list_splice_tail_init(&chan->submitted, &chan->issued);
	spin_unlock_irqrestore(&chan->lock, flags);
	plsim_kick(chan);
}

static enum dma_status plsim_tx_status(struct dma_chan *dma_chan, dma_cookie_t cookie,
				       struct dma_tx_state *state)
{
	struct plsim_chan *chan = to_plsim_chan(dma_chan);
	unsigned long flags;
	dma_cookie_t used, complete;

	spin_lock_irqsave(&chan->lock, flags);
	used = chan->chan.cookie;
	complete = chan->chan.completed_cookie;
	spin_unlock_irqrestore(&chan->lock, flags);
	dma_set_tx_state(state, complete, used, 0);
	return dma_async_is_complete(cookie, complete, used);
}

static void free_list(struct list_head *list)
{
	struct plsim_desc *desc, *next;

	list_for_each_entry_safe(desc, next, list, node)
		kfree(desc);
}

/* what is under way is dropped by the work that has it */
static int plsim_terminate_all(struct dma_chan *dma_chan)
{
	struct plsim_chan *chan = to_plsim_chan(dma_chan);
	unsigned long flags;
	LIST_HEAD(gone);

	spin_lock_irqsave(&chan->lock, flags);
	chan->stopped++;
	list_splice_tail_init(&chan->submitted, &gone);
	list_splice_tail_init(&chan->issued, &gone);
	if (chan->current_desc)
		list_add(&chan->current_desc->node, &gone);
	chan->current_desc = NULL;
	chan->chan.completed_cookie = chan->chan.cookie;
	spin_unlock_irqrestore(&chan->lock, flags);
	free_list(&gone);
	return 0;
}

static void plsim_synchronize(struct dma_chan *dma_chan)
{
	cancel_delayed_work_sync(&to_plsim_chan(dma_chan)->work);
}

static void plsim_free_chan_resources(struct dma_chan *dma_chan)
{
	plsim_terminate_all(dma_chan);
	plsim_synchronize(dma_chan);
	plsim_drop_packets(to_plsim_chan(dma_chan));
}

static bool plsim_filter(struct dma_chan *dma_chan, void *param)
{
	return &to_plsim_chan(dma_chan)->chan == param;
}

static struct dma_chan *plsim_of_xlate(struct of_phandle_args *args, struct of_dma *of_dma)
{
	struct plsim_dma *dma = of_dma->of_dma_data;
	dma_cap_mask_t mask;

	if (args->args_count != 1 || args->args[0] >= dma->count)
		return NULL;
	dma_cap_zero(mask);
	dma_cap_set(DMA_SLAVE, mask);
	return __dma_request_channel(&mask, plsim_filter, &dma->channels[args->args[0]].chan,
				     of_dma->of_node);
}

static int read_kind(struct fwnode_handle *node, struct plsim_chan *chan)
{
	static const char * const kinds[] = {
		[PLSIM_LOOPBACK] = "loopback",
		[PLSIM_SOURCE] = "source",
		[PLSIM_SINK] = "sink",
		[PLSIM_ICAP] = "icap",
		[PLSIM_READBACK] = "readback",
	};
	const char *kind;
	int ret = fwnode_property_read_string(node, "fpga-cm,kind", &kind);

	if (ret)
		return ret;
	ret = match_string(kinds, ARRAY_SIZE(kinds), kind);
	if (ret < 0)
		return ret;
	chan->kind = ret;
	return 0;
}

static int add_frames(struct plsim_dma *dma, struct plsim_chan *chan)
{
	struct cm_frames *frames = devm_kzalloc(dma->dev, sizeof(*frames), GFP_KERNEL);

	if (!frames)
		return -ENOMEM;
	cm_frames_init(frames);
	chan->port.frames = frames;
	return 0;
}

static int read_channel(struct plsim_dma *dma, struct fwnode_handle *node)
{
	u32 number = dma->count, peer;
	struct plsim_chan *chan;
	int ret;

	fwnode_property_read_u32(node, "reg", &number);
	if (number >= PLSIM_CHANNELS_MAX)
		return -EINVAL;
	chan = &dma->channels[number];
	if (chan->label)
		return -EEXIST;
	ret = read_kind(node, chan);
	if (ret)
		return ret;
	ret = fwnode_property_read_string(node, "label", &chan->label);
	if (ret)
		return ret;
	chan->direction = chan->kind == PLSIM_SOURCE || chan->kind == PLSIM_READBACK ?
		CM_DMA_S2MM : CM_DMA_MM2S;
	chan->fifo = PLSIM_FIFO;
	chan->frame_length = PAGE_SIZE;
	fwnode_property_read_u32(node, "fpga-cm,direction", &chan->direction);
	fwnode_property_read_u32(node, "fpga-cm,frame-length", &chan->frame_length);
	fwnode_property_read_u32(node, "fpga-cm,interval-us", &chan->interval_us);
	fwnode_property_read_u32(node, "fpga-cm,fifo", &chan->fifo);
	fwnode_property_read_u32(node, "fpga-cm,idcode", &chan->port.idcode);
	if (!fwnode_property_read_u32(node, "fpga-cm,peer", &peer) && peer < PLSIM_CHANNELS_MAX)
		chan->peer = &dma->channels[peer];
	return chan->kind == PLSIM_ICAP ? add_frames(dma, chan) : 0;
}

static bool channel_valid(const struct plsim_chan *chan)
{
	if (!chan->label || !chan->frame_length || chan->frame_length > SZ_64M)
		return false;
	switch (chan->kind) {
	case PLSIM_LOOPBACK:
		return chan->peer && chan->peer->kind == PLSIM_LOOPBACK && chan->peer->label &&
		       chan->peer->direction + chan->direction == CM_DMA_MM2S + CM_DMA_S2MM;
	case PLSIM_SOURCE:
		return chan->direction == CM_DMA_S2MM;
	case PLSIM_READBACK:
		return chan->direction == CM_DMA_S2MM && chan->peer &&
		       chan->peer->kind == PLSIM_ICAP && chan->peer->peer == chan;
	default:
		return chan->direction == CM_DMA_MM2S;
	}
}

static int read_channels(struct plsim_dma *dma)
{
	struct fwnode_handle *node;
	int i, ret;

	device_for_each_child_node(dma->dev, node) {
		ret = read_channel(dma, node);
		if (ret) {
			fwnode_handle_put(node);
			return dev_err_probe(dma->dev, ret,
					     "no kind, no label, or another's number\n");
		}
		dma->count++;
	}
	/* only the way back names the port */
	for (i = 0; i < dma->count; i++) {
		struct plsim_chan *chan = &dma->channels[i];

		if (chan->kind == PLSIM_READBACK && chan->peer)
			chan->peer->peer = chan;
	}
	for (i = 0; i < dma->count; i++) {
		if (!channel_valid(&dma->channels[i]))
			return dev_err_probe(dma->dev, -EINVAL, "channel %d cannot be\n", i);
	}
	return dma->count ? 0 : dev_err_probe(dma->dev, -EINVAL, "no channels\n");
}

static void init_channel(struct plsim_dma *dma, struct plsim_chan *chan)
{
	chan->dma = dma;
	chan->chan.device = &dma->device;
	spin_lock_init(&chan->lock);
	INIT_LIST_HEAD(&chan->submitted);
	INIT_LIST_HEAD(&chan->issued);
	INIT_LIST_HEAD(&chan->packets);
	INIT_DELAYED_WORK(&chan->work, plsim_work);
	chan->chan.cookie = DMA_MIN_COOKIE;
	chan->chan.completed_cookie = DMA_MIN_COOKIE;
	list_add_tail(&chan->chan.device_node, &dma->device.channels);
}

static void init_device(struct plsim_dma *dma)
{
	struct dma_device *device = &dma->device;
	int i;

	device->dev = dma->dev;
	INIT_LIST_HEAD(&device->channels);
	dma_cap_set(DMA_SLAVE, device->cap_mask);
	dma_cap_set(DMA_PRIVATE, device->cap_mask);
	dma_cap_set(DMA_CYCLIC, device->cap_mask);
	dma_cap_set(DMA_INTERLEAVE, device->cap_mask);
	device->directions = BIT(DMA_MEM_TO_DEV) | BIT(DMA_DEV_TO_MEM);
	device->src_addr_widths = BIT(DMA_SLAVE_BUSWIDTH_4_BYTES);
	device->dst_addr_widths = BIT(DMA_SLAVE_BUSWIDTH_4_BYTES);
	device->residue_granularity = DMA_RESIDUE_GRANULARITY_SEGMENT;
	device->device_free_chan_resources = plsim_free_chan_resources;
	device->device_prep_slave_sg = plsim_prep_slave_sg;
	device->device_prep_dma_cyclic = plsim_prep_cyclic;
	device->device_prep_interleaved_dma = plsim_prep_interleaved;
	device->device_issue_pending = plsim_issue_pending;
	device->device_tx_status = plsim_tx_status;
	device->device_terminate_all = plsim_terminate_all;
	device->device_synchronize = plsim_synchronize;
	for (i = 0; i < dma->count; i++)
		init_channel(dma, &dma->channels[i]);
}

/* clients without a device tree find a channel by their own name and its label */
static int init_maps(struct plsim_dma *dma)
{
	const char *client;
	int i;

	if (device_property_read_string(dma->dev, "fpga-cm,client", &client))
		return 0;
	dma->maps = devm_kcalloc(dma->dev, dma->count, sizeof(*dma->maps), GFP_KERNEL);
	if (!dma->maps)
		return -ENOMEM;
	for (i = 0; i < dma->count; i++) {
		struct plsim_chan *chan = &dma->channels[i];
		bool back = chan->kind == PLSIM_READBACK;
		const char *name = chan->kind == PLSIM_ICAP ? "icap" : back ? "rx" : chan->label;

		dma->maps[i].devname = chan->kind == PLSIM_ICAP || back ?
			devm_kasprintf(dma->dev, GFP_KERNEL, "cm_icap.%s", client) :
			devm_kasprintf(dma->dev, GFP_KERNEL, "cm_dma.%s", client);
		dma->maps[i].slave = name;
		dma->maps[i].param = &chan->chan;
		if (!dma->maps[i].devname)
			return -ENOMEM;
	}
	dma->device.filter.map = dma->maps;
	dma->device.filter.mapcnt = dma->count;
	dma->device.filter.fn = plsim_filter;
	return 0;
}

/* a loop's sender may have gone on after its receiver was given back */
static void destroy_queue(void *data)
{
	struct plsim_dma *dma = data;
	int i;

	destroy_workqueue(dma->queue);
	for (i = 0; i < dma->count; i++) {
		plsim_drop_packets(&dma->channels[i]);
		if (dma->channels[i].port.frames)
			cm_frames_destroy(dma->channels[i].port.frames);
	}
}

static void unregister_engine(void *device)
{
	dma_async_device_unregister(device);
}

static void remove_debugfs(void *dentry)
{
	debugfs_remove_recursive(dentry);
}

static void free_of(void *dev)
{
	of_dma_controller_free(((struct device *)dev)->of_node);
}

static int register_of(struct plsim_dma *dma)
{
	int ret;

	if (!dma->dev->of_node)
		return 0;
	ret = of_dma_controller_register(dma->dev->of_node, plsim_of_xlate, dma);
	return ret ?: devm_add_action_or_reset(dma->dev, free_of, dma->dev);
}

static int map_status(struct plsim_dma *dma, struct platform_device *pdev)
{
	struct resource *resource = platform_get_resource(pdev, IORESOURCE_MEM, 0);

	if (!resource)
		return 0;
	/* not requested: the loader's driver has the region */
	dma->status = devm_ioremap(dma->dev, resource->start, resource_size(resource));
	return dma->status ? 0 : -ENOMEM;
}

/* the engine is the CPU, its caches are the CPU's */
static int make_coherent(struct device *dev)
{
	cm_set_coherent(dev);
	return dma_coerce_mask_and_coherent(dev, DMA_BIT_MASK(64));
}

static int plsim_dma_probe(struct platform_device *pdev)
{
	struct device *dev = &pdev->dev;
	struct plsim_dma *dma;
	int ret;

	dma = devm_kzalloc(dev, struct_size(dma, channels, PLSIM_CHANNELS_MAX), GFP_KERNEL);
	if (!dma)
		return -ENOMEM;
	dma->dev = dev;
	platform_set_drvdata(pdev, dma);
	ret = make_coherent(dev);
	if (!ret)
		ret = map_status(dma, pdev);
	if (!ret)
		ret = read_channels(dma);
	if (!ret)
		ret = init_maps(dma);
	if (ret)
		return ret;
	dma->queue = alloc_workqueue("%s", WQ_UNBOUND, 0, dev_name(dev));
	if (!dma->queue)
		return -ENOMEM;
	init_device(dma);
	ret = devm_add_action_or_reset(dev, destroy_queue, dma);
	if (ret)
		return ret;
	ret = dma_async_device_register(&dma->device);
	if (ret)
		return ret;
	ret = devm_add_action_or_reset(dev, unregister_engine, &dma->device);
	if (ret)
		return ret;
	plsim_debugfs(dma);
	ret = devm_add_action_or_reset(dev, remove_debugfs, dma->debugfs);
	if (ret)
		return ret;
	return register_of(dma);
}

static const struct of_device_id plsim_dma_of_match[] = {
	{ .compatible = "fpga-cm,plsim-dma" },
	{}
};
MODULE_DEVICE_TABLE(of, plsim_dma_of_match);

struct platform_driver plsim_dma_driver = {
	.probe = plsim_dma_probe,
	.driver = {
		.name = "cm_plsim_dma",
		.of_match_table = plsim_dma_of_match,
	},
};
