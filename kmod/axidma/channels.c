// SPDX-License-Identifier: GPL-2.0-only
/* Which channels an open file has, and under which numbers. */
#include <linux/kernel.h>
#include <linux/module.h>
#include <linux/slab.h>
#include <linux/string.h>
#include <linux/uaccess.h>

#include "axidma.h"
#include "cm_compat.h"

static char *channels;
module_param(channels, charp, 0444);
MODULE_PARM_DESC(channels, "name[:id],... of cm_dma channels; those of the device tree, or all, if empty");

/* takes over the caller's reference */
static int add(struct axidma_file *file, struct cm_channel *channel, int id)
{
	int i, ret = 0;

	for (i = 0; i < file->count; i++) {
		if (file->channels[i].id == id)
			ret = -EINVAL;
	}
	if (file->count == AXIDMA_CHANNELS_MAX)
		ret = -E2BIG;
	if (!ret)
		ret = cm_channel_claim(channel);
	if (ret) {
		cm_channel_put(channel);
		return ret;
	}
	file->channels[file->count].channel = channel;
	file->channels[file->count].id = id;
	file->count++;
	return 0;
}

static int add_all(struct axidma_file *file)
{
	struct cm_channel *channel = cm_channel_next(NULL), *next;
	int ret = 0;

	while (channel && !ret) {
		next = cm_channel_next(channel);
		ret = add(file, channel, file->count);
		channel = next;
	}
	if (channel)
		cm_channel_put(channel);
	return ret;
}

static int add_described(struct axidma_file *file)
{
	struct cm_channel *channel;
	int id, i, ret = 0;

	for (i = 0; !ret && (channel = axidma_tree_channel(i, &id)); i++)
		ret = add(file, channel, id);
	return ret;
}

static int add_named(struct axidma_file *file, char *entry)
{
	char *name = strsep(&entry, ":");
	struct cm_channel *channel;
	int id = file->count;

	if (entry && kstrtoint(entry, 0, &id))
		return -EINVAL;
	channel = cm_channel_find(name);
	return channel ? add(file, channel, id) : -ENODEV;
}

static int add_list(struct axidma_file *file)
{
	char *copy = kstrdup(channels, GFP_KERNEL), *rest = copy, *entry;
	int ret = copy ? 0 : -ENOMEM;

	while (!ret && (entry = strsep(&rest, ",")))
		ret = add_named(file, entry);
	kfree(copy);
	return ret;
}

/**
 * axidma_channels_claim() - have all channels to oneself
 * @file: file
 *
 * Those that the module parameter names; without it those that a device tree
 * describes; without that all of cm_dma.
 *
 * Return: 0, -EBUSY if one is in use, -ENODEV where there is none.
 */
int axidma_channels_claim(struct axidma_file *file)
{
	int ret = channels && *channels ? add_list(file) : add_described(file);

	if (!ret && !file->count)
		ret = add_all(file);
	if (!ret && !file->count)
		ret = -ENODEV;
	if (ret)
		axidma_channels_release(file);
	return ret;
}

/**
 * axidma_channels_release() - end all transfers and give the channels back
 * @file: file
 */
void axidma_channels_release(struct axidma_file *file)
{
	while (file->count) {
		struct axidma_channel *channel = &file->channels[--file->count];

		axidma_video_end(channel);
		cm_channel_release(channel->channel);
		cm_channel_put(channel->channel);
	}
}

/**
 * axidma_channel_find() - the channel of a number
 * @file: file
 * @id: number
 * @direction: CM_DMA_*, or 0 for either
 *
 * Return: the channel, or NULL.
 */
struct axidma_channel *axidma_channel_find(struct axidma_file *file, int id, u32 direction)
{
	int i;

	for (i = 0; i < file->count; i++) {
		struct axidma_channel *channel = &file->channels[i];

		if (channel->id == id &&
		    (!direction || channel->channel->info.direction == direction))
			return channel;
	}
	return NULL;
}

/**
 * axidma_get_counts() - how many channels there are
 * @file: file
 * @arg: struct axidma_abi_counts, filled in
 *
 * Return: 0 or -EFAULT.
 */
long axidma_get_counts(struct axidma_file *file, void __user *arg)
{
	struct axidma_abi_counts counts = { .channels = file->count };
	int i;

	for (i = 0; i < file->count; i++) {
		const struct cm_dma_info *info = &file->channels[i].channel->info;
		bool tx = info->direction == CM_DMA_MM2S;

		if (info->type == CM_DMA_TYPE_VDMA)
			*(tx ? &counts.vdma_tx : &counts.vdma_rx) += 1;
		else
			*(tx ? &counts.dma_tx : &counts.dma_rx) += 1;
	}
	return copy_to_user(arg, &counts, sizeof(counts)) ? -EFAULT : 0;
}

/**
 * axidma_get_channels() - what the channels are
 * @file: file
 * @arg: struct axidma_abi_channels, whose array is filled in
 *
 * Return: 0 or -EFAULT.
 */
long axidma_get_channels(struct axidma_file *file, void __user *arg)
{
	struct axidma_abi_channel __user *to;
	struct axidma_abi_channels args;
	int i;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	to = (struct axidma_abi_channel __user *)args.array;
	for (i = 0; i < file->count; i++) {
		const struct cm_dma_info *info = &file->channels[i].channel->info;
		struct axidma_abi_channel channel;

		memset(&channel, 0, sizeof(channel));
		channel.direction = info->direction == CM_DMA_MM2S ? AXIDMA_ABI_WRITE :
								     AXIDMA_ABI_READ;
		channel.type = info->type == CM_DMA_TYPE_VDMA ? AXIDMA_ABI_VDMA : AXIDMA_ABI_DMA;
		channel.id = file->channels[i].id;
		if (copy_to_user(to + i, &channel, sizeof(channel)))
			return -EFAULT;
	}
	return 0;
}
