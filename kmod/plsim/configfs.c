// SPDX-License-Identifier: GPL-2.0-only
/*
 * Simulated boards, described in configfs:
 *
 *	mkdir cm_plsim/<board>
 *	mkdir cm_plsim/<board>/dma/<channel>   kind, peer, direction, ...
 *	mkdir cm_plsim/<board>/uio/<name>      address, size, doorbell
 *	echo 1 > cm_plsim/<board>/live
 *
 * While a board is live its description cannot be changed (-EBUSY).
 */
#include <linux/idr.h>
#include <linux/kstrtox.h>
#include <linux/module.h>
#include <linux/slab.h>

#include "board.h"
#include "cm_dma.h"

static DEFINE_IDA(board_ids);

static struct plsim_board *to_board(struct config_item *item)
{
	return container_of(to_config_group(item), struct plsim_board, group);
}

static struct plsim_channel_item *to_channel(struct config_item *item)
{
	return container_of(item, struct plsim_channel_item, item);
}

static struct plsim_uio_item *to_uio(struct config_item *item)
{
	return container_of(item, struct plsim_uio_item, item);
}

static int store_u32(struct plsim_board *board, u32 *where, const char *page)
{
	u32 value;
	int ret = kstrtou32(page, 0, &value);

	if (ret)
		return ret;
	mutex_lock(&board->lock);
	if (board->live)
		ret = -EBUSY;
	else
		*where = value;
	mutex_unlock(&board->lock);
	return ret;
}

static int store_name(struct plsim_board *board, char *where, const char *page, size_t count)
{
	size_t length = count && page[count - 1] == '\n' ? count - 1 : count;
	int ret = 0;

	if (!length || length >= PLSIM_NAME_MAX)
		return -EINVAL;
	mutex_lock(&board->lock);
	if (board->live) {
		ret = -EBUSY;
	} else {
		memcpy(where, page, length);
		where[length] = 0;
	}
	mutex_unlock(&board->lock);
	return ret;
}

#define CHANNEL_U32(_name)                                                                         \
	static ssize_t channel_##_name##_show(struct config_item *item, char *page)                \
	{                                                                                          \
		return sprintf(page, "%u\n", READ_ONCE(to_channel(item)->_name));                  \
	}                                                                                          \
	static ssize_t channel_##_name##_store(struct config_item *item, const char *page,         \
					       size_t count)                                       \
	{                                                                                          \
		struct plsim_channel_item *channel = to_channel(item);                             \
												   \
		return store_u32(channel->board, &channel->_name, page) ?: count;                  \
	}                                                                                          \
	CONFIGFS_ATTR(channel_, _name)

CHANNEL_U32(frame_length);
CHANNEL_U32(interval_us);
CHANNEL_U32(fifo);
CHANNEL_U32(idcode);
CHANNEL_U32(timeout_ms);
CHANNEL_U32(video);

static ssize_t channel_kind_show(struct config_item *item, char *page)
{
	return sprintf(page, "%s\n", to_channel(item)->kind);
}

static ssize_t channel_kind_store(struct config_item *item, const char *page, size_t count)
{
	static const char * const kinds[] = { "loopback", "source", "sink", "icap",
					     "readback" };
	struct plsim_channel_item *channel = to_channel(item);
	int kind = sysfs_match_string(kinds, page);
	int ret;

	if (kind < 0)
		return kind;
	ret = store_name(channel->board, channel->kind, page, count);
	if (ret)
		return ret;
	if (!strcmp(channel->kind, "source") || !strcmp(channel->kind, "readback"))
		channel->direction = CM_DMA_S2MM;
	else if (strcmp(channel->kind, "loopback"))
		channel->direction = CM_DMA_MM2S;
	return count;
}
CONFIGFS_ATTR(channel_, kind);

static ssize_t channel_peer_show(struct config_item *item, char *page)
{
	return sprintf(page, "%s\n", to_channel(item)->peer);
}

static ssize_t channel_peer_store(struct config_item *item, const char *page, size_t count)
{
	struct plsim_channel_item *channel = to_channel(item);

	return store_name(channel->board, channel->peer, page, count) ?: count;
}
CONFIGFS_ATTR(channel_, peer);

static ssize_t channel_direction_show(struct config_item *item, char *page)
{
	return sprintf(page, "%s\n", to_channel(item)->direction == CM_DMA_MM2S ? "mm2s" : "s2mm");
}

static ssize_t channel_direction_store(struct config_item *item, const char *page, size_t count)
{
	struct plsim_channel_item *channel = to_channel(item);
	int ret;

	if (sysfs_streq(page, "mm2s"))
		ret = store_u32(channel->board, &channel->direction, "1");
	else if (sysfs_streq(page, "s2mm"))
		ret = store_u32(channel->board, &channel->direction, "2");
	else
		return -EINVAL;
	return ret ?: count;
}
CONFIGFS_ATTR(channel_, direction);

static struct configfs_attribute *channel_attributes[] = {
	&channel_attr_kind,
	&channel_attr_peer,
	&channel_attr_direction,
	&channel_attr_video,
	&channel_attr_frame_length,
	&channel_attr_interval_us,
	&channel_attr_fifo,
	&channel_attr_idcode,
	&channel_attr_timeout_ms,
	NULL
};

static void channel_release(struct config_item *item)
{
	struct plsim_channel_item *channel = to_channel(item);

	mutex_lock(&channel->board->lock);
	list_del(&channel->siblings);
	mutex_unlock(&channel->board->lock);
	config_item_put(&channel->board->group.cg_item);
	kfree(channel);
}

static struct configfs_item_operations channel_operations = { .release = channel_release };

static const struct config_item_type channel_type = {
	.ct_item_ops = &channel_operations,
	.ct_attrs = channel_attributes,
	.ct_owner = THIS_MODULE,
};

static ssize_t uio_address_show(struct config_item *item, char *page)
{
	return sprintf(page, "%#llx\n", to_uio(item)->address);
}

static ssize_t uio_address_store(struct config_item *item, const char *page, size_t count)
{
	struct plsim_uio_item *uio = to_uio(item);
	u64 address;
	int ret = kstrtou64(page, 0, &address);

	if (ret)
		return ret;
	mutex_lock(&uio->board->lock);
	if (uio->board->live)
		ret = -EBUSY;
	else
		uio->address = address;
	mutex_unlock(&uio->board->lock);
	return ret ?: count;
}
CONFIGFS_ATTR(uio_, address);

static ssize_t uio_size_show(struct config_item *item, char *page)
{
	return sprintf(page, "%u\n", to_uio(item)->size);
}

static ssize_t uio_size_store(struct config_item *item, const char *page, size_t count)
{
	return store_u32(to_uio(item)->board, &to_uio(item)->size, page) ?: count;
}
CONFIGFS_ATTR(uio_, size);

static ssize_t uio_doorbell_show(struct config_item *item, char *page)
{
	return sprintf(page, "%d\n", (s32)to_uio(item)->doorbell);
}

static ssize_t uio_doorbell_store(struct config_item *item, const char *page, size_t count)
{
	return store_u32(to_uio(item)->board, &to_uio(item)->doorbell, page) ?: count;
}
CONFIGFS_ATTR(uio_, doorbell);

static struct configfs_attribute *uio_attributes[] = {
	&uio_attr_address,
	&uio_attr_size,
	&uio_attr_doorbell,
	NULL
};

static void uio_release(struct config_item *item)
{
	struct plsim_uio_item *uio = to_uio(item);

	mutex_lock(&uio->board->lock);
	list_del(&uio->siblings);
	mutex_unlock(&uio->board->lock);
	config_item_put(&uio->board->group.cg_item);
	kfree(uio);
}

static struct configfs_item_operations uio_operations = { .release = uio_release };

static const struct config_item_type uio_type = {
	.ct_item_ops = &uio_operations,
	.ct_attrs = uio_attributes,
	.ct_owner = THIS_MODULE,
};

static int add_to(struct plsim_board *board, struct list_head *list, struct list_head *node)
{
	int ret = 0;

	mutex_lock(&board->lock);
	if (board->live)
		ret = -EBUSY;
	else
		list_add_tail(node, list);
	mutex_unlock(&board->lock);
	if (!ret)
		config_item_get(&board->group.cg_item);
	return ret;
}

static struct config_item *make_channel(struct config_group *group, const char *name)
{
	struct plsim_board *board = container_of(group, struct plsim_board, channels_group);
	struct plsim_channel_item *channel;
	int ret;

	if (strlen(name) >= PLSIM_NAME_MAX)
		return ERR_PTR(-ENAMETOOLONG);
	channel = kzalloc(sizeof(*channel), GFP_KERNEL);
	if (!channel)
		return ERR_PTR(-ENOMEM);
	channel->board = board;
	channel->direction = CM_DMA_S2MM;
	channel->frame_length = PAGE_SIZE;
	channel->fifo = SZ_64K;
	channel->timeout_ms = PLSIM_TIMEOUT_MS;
	strscpy(channel->kind, "source", sizeof(channel->kind));
	ret = add_to(board, &board->channels, &channel->siblings);
	if (ret) {
		kfree(channel);
		return ERR_PTR(ret);
	}
	config_item_init_type_name(&channel->item, name, &channel_type);
	return &channel->item;
}

static struct config_item *make_uio(struct config_group *group, const char *name)
{
	struct plsim_board *board = container_of(group, struct plsim_board, uios_group);
	struct plsim_uio_item *uio = kzalloc(sizeof(*uio), GFP_KERNEL);
	int ret;

	if (!uio)
		return ERR_PTR(-ENOMEM);
	uio->board = board;
	uio->size = PAGE_SIZE;
	uio->doorbell = U32_MAX;
	ret = add_to(board, &board->uios, &uio->siblings);
	if (ret) {
		kfree(uio);
		return ERR_PTR(ret);
	}
	config_item_init_type_name(&uio->item, name, &uio_type);
	return &uio->item;
}

static struct configfs_group_operations channels_operations = { .make_item = make_channel };
static struct configfs_group_operations uios_operations = { .make_item = make_uio };

static const struct config_item_type channels_type = {
	.ct_group_ops = &channels_operations,
	.ct_owner = THIS_MODULE,
};

static const struct config_item_type uios_type = {
	.ct_group_ops = &uios_operations,
	.ct_owner = THIS_MODULE,
};

static ssize_t board_live_show(struct config_item *item, char *page)
{
	return sprintf(page, "%d\n", READ_ONCE(to_board(item)->live));
}

static ssize_t board_live_store(struct config_item *item, const char *page, size_t count)
{
	struct plsim_board *board = to_board(item);
	bool live;
	int ret = kstrtobool(page, &live);

	if (ret)
		return ret;
	mutex_lock(&board->lock);
	if (live == board->live)
		ret = -EPERM;
	else if (live)
		ret = plsim_board_activate(board);
	else
		plsim_board_deactivate(board);
	mutex_unlock(&board->lock);
	return ret ?: count;
}
CONFIGFS_ATTR(board_, live);

static ssize_t board_dev_name_show(struct config_item *item, char *page)
{
	return sprintf(page, "cm_plsim_dma.%d\n", to_board(item)->id);
}
CONFIGFS_ATTR_RO(board_, dev_name);

static struct configfs_attribute *board_attributes[] = {
	&board_attr_live,
	&board_attr_dev_name,
	NULL
};

static void board_release(struct config_item *item)
{
	struct plsim_board *board = to_board(item);

	plsim_board_deactivate(board);
	ida_free(&board_ids, board->id);
	mutex_destroy(&board->lock);
	kfree(board);
}

static struct configfs_item_operations board_operations = { .release = board_release };

static const struct config_item_type board_type = {
	.ct_item_ops = &board_operations,
	.ct_attrs = board_attributes,
	.ct_owner = THIS_MODULE,
};

static struct config_group *make_board(struct config_group *group, const char *name)
{
	struct plsim_board *board = kzalloc(sizeof(*board), GFP_KERNEL);

	if (!board)
		return ERR_PTR(-ENOMEM);
	board->id = ida_alloc(&board_ids, GFP_KERNEL);
	if (board->id < 0) {
		kfree(board);
		return ERR_PTR(-ENOSPC);
	}
	mutex_init(&board->lock);
	INIT_LIST_HEAD(&board->channels);
	INIT_LIST_HEAD(&board->uios);
	config_group_init_type_name(&board->group, name, &board_type);
	config_group_init_type_name(&board->channels_group, "dma", &channels_type);
	config_group_init_type_name(&board->uios_group, "uio", &uios_type);
	configfs_add_default_group(&board->channels_group, &board->group);
	configfs_add_default_group(&board->uios_group, &board->group);
	return &board->group;
}

/* rmdir of a live board: its devices go before its folder */
static void drop_board(struct config_group *group, struct config_item *item)
{
	struct plsim_board *board = to_board(item);

	mutex_lock(&board->lock);
	if (board->live)
		plsim_board_deactivate(board);
	mutex_unlock(&board->lock);
	config_item_put(item);
}

static struct configfs_group_operations root_operations = {
	.make_group = make_board,
	.drop_item = drop_board,
};

static const struct config_item_type root_type = {
	.ct_group_ops = &root_operations,
	.ct_owner = THIS_MODULE,
};

static struct configfs_subsystem plsim_subsystem = {
	.su_group = {
		.cg_item = {
			.ci_namebuf = "cm_plsim",
			.ci_type = &root_type,
		},
	},
};

/**
 * plsim_configfs_init() - at the module's start
 *
 * Return: 0 or a negative errno.
 */
int plsim_configfs_init(void)
{
	config_group_init(&plsim_subsystem.su_group);
	mutex_init(&plsim_subsystem.su_mutex);
	return configfs_register_subsystem(&plsim_subsystem);
}

/**
 * plsim_configfs_exit() - at the module's end
 */
void plsim_configfs_exit(void)
{
	configfs_unregister_subsystem(&plsim_subsystem);
	ida_destroy(&board_ids);
}
