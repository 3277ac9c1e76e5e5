// SPDX-License-Identifier: GPL-2.0-only
/* Faults to inject, and what the simulated logic saw. */
#include <linux/debugfs.h>
#include <linux/fs.h>
#include <linux/module.h>
#include <linux/sizes.h>
#include <linux/slab.h>
#include <linux/uaccess.h>

#include "plsim.h"

#define ORDER_MAX SZ_1M

struct dentry *plsim_debugfs_root;

/* a channel that was held goes on when the fault is taken back */
static int hang_get(void *data, u64 *value)
{
	*value = READ_ONCE(((struct plsim_chan *)data)->faults.hang);
	return 0;
}

static int hang_set(void *data, u64 value)
{
	struct plsim_chan *chan = data;

	WRITE_ONCE(chan->faults.hang, !!value);
	if (!value)
		plsim_kick(chan);
	return 0;
}
DEFINE_DEBUGFS_ATTRIBUTE(hang_fops, hang_get, hang_set, "%llu\n");

/* "FRAME BIT": 32 times the word, and the bit in it */
static ssize_t upset_write(struct file *file, const char __user *from, size_t count,
			   loff_t *position)
{
	struct plsim_chan *chan = file->private_data;
	char text[32] = {};
	u32 far, bit;
	int ret;

	if (count >= sizeof(text))
		return -EINVAL;
	if (copy_from_user(text, from, count))
		return -EFAULT;
	if (sscanf(text, "%i %u", &far, &bit) != 2)
		return -EINVAL;
	ret = cm_frames_upset(chan->port.frames, far, bit);
	return ret ?: count;
}

static const struct file_operations upset_fops = {
	.owner = THIS_MODULE,
	.open = simple_open,
	.write = upset_write,
};

/* the device's order of frames in one write: 32-bit words, all ones for a frame of no column */
static ssize_t order_write(struct file *file, const char __user *from, size_t count,
			   loff_t *position)
{
	struct plsim_chan *chan = file->private_data;
	struct cm_frames *frames = chan->port.frames;
	u32 *order;

	if (!count || count % sizeof(*order) || count > ORDER_MAX)
		return -EINVAL;
	order = vmemdup_user(from, count);
	if (IS_ERR(order))
		return PTR_ERR(order);
	mutex_lock(&frames->lock);
	swap(order, frames->order);
	frames->order_count = count / sizeof(*order);
	mutex_unlock(&frames->lock);
	kvfree(order);
	return count;
}

static const struct file_operations order_fops = {
	.owner = THIS_MODULE,
	.open = simple_open,
	.write = order_write,
};

static void channel_debugfs(struct plsim_chan *chan, struct dentry *parent)
{
	struct dentry *folder = debugfs_create_dir(chan->label, parent);

	debugfs_create_u32("delay_us", 0644, folder, &chan->faults.delay_us);
	debugfs_create_u32("fail_next", 0644, folder, &chan->faults.fail_next);
	debugfs_create_u32("short_next", 0644, folder, &chan->faults.short_next);
	debugfs_create_file_unsafe("hang", 0644, folder, chan, &hang_fops);
	debugfs_create_u64("bytes", 0444, folder, &chan->bytes);
	if (chan->kind == PLSIM_SOURCE) {
		debugfs_create_u64("frames", 0444, folder, &chan->frames);
		debugfs_create_u64("lost", 0444, folder, &chan->lost);
		debugfs_create_u32("interval_us", 0644, folder, &chan->interval_us);
	}
	if (chan->kind == PLSIM_SINK || chan->kind == PLSIM_ICAP)
		debugfs_create_x32("crc32", 0444, folder, &chan->crc32);
	if (chan->kind == PLSIM_ICAP) {
		debugfs_create_u64("loads", 0444, folder, &chan->loads);
		debugfs_create_x32("errors", 0444, folder, &chan->load_errors);
		debugfs_create_u32("words", 0444, folder, &chan->load_words);
		debugfs_create_u64("frame_words", 0444, folder, &chan->port.frame_words);
		debugfs_create_u32("crc_checks", 0444, folder, &chan->port.crc_checks);
		debugfs_create_bool("synced", 0444, folder, &chan->port.synced);
		debugfs_create_x32("inject_errors", 0644, folder, &chan->inject_errors);
		debugfs_create_u64("reads", 0444, folder, &chan->reads);
		debugfs_create_u32("frames", 0444, folder, &chan->port.frames->count);
		debugfs_create_file("upset", 0200, folder, chan, &upset_fops);
		debugfs_create_file("frame_order", 0200, folder, chan, &order_fops);
	}
}

/**
 * plsim_debugfs() - files of an engine
 * @dma: engine; @dma->debugfs is to be removed before it goes
 */
void plsim_debugfs(struct plsim_dma *dma)
{
	int i;

	dma->debugfs = debugfs_create_dir(dev_name(dma->dev), plsim_debugfs_root);
	for (i = 0; i < dma->count; i++)
		channel_debugfs(&dma->channels[i], dma->debugfs);
}
