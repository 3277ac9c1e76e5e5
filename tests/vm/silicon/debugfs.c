// SPDX-License-Identifier: GPL-2.0-only
/* What tests do with an engine: /sys/kernel/debug/cm_axi/<label>. */
#include <linux/debugfs.h>
#include <linux/module.h>
#include <linux/seq_file.h>
#include <linux/slab.h>
#include <linux/uaccess.h>

#include "model.h"

#define PACKET_MAX (8 << 20)

static int trace_show(struct seq_file *file, void *unused)
{
	struct axi_engine *engine = file->private;
	struct axi_access *access;
	unsigned long flags;
	u64 i, first;

	spin_lock_irqsave(&engine->lock, flags);
	first = engine->traced > AXI_TRACE ? engine->traced - AXI_TRACE : 0;
	for (i = first; i < engine->traced; i++) {
		access = &engine->trace[i % AXI_TRACE];
		seq_printf(file, "%c %#x %#x\n", access->what, access->offset, access->value);
	}
	spin_unlock_irqrestore(&engine->lock, flags);
	return 0;
}

static int trace_open(struct inode *inode, struct file *file)
{
	return single_open_size(file, trace_show, inode->i_private, AXI_TRACE * 32);
}

static ssize_t trace_clear(struct file *file, const char __user *from, size_t count, loff_t *offset)
{
	struct axi_engine *engine = file_inode(file)->i_private;
	unsigned long flags;

	spin_lock_irqsave(&engine->lock, flags);
	engine->traced = 0;
	spin_unlock_irqrestore(&engine->lock, flags);
	return count;
}

static const struct file_operations trace_fops = {
	.owner = THIS_MODULE,
	.open = trace_open,
	.read = seq_read,
	.write = trace_clear,
	.llseek = seq_lseek,
	.release = single_release,
};

static int state_show(struct seq_file *file, void *unused)
{
	struct axi_engine *engine = file->private;
	static const char * const names[] = { "mm2s", "s2mm" };
	struct axi_packet *packet;
	unsigned long flags;
	u32 waiting;
	int i;

	spin_lock_irqsave(&engine->lock, flags);
	for (i = 0; i < 2; i++) {
		struct axi_channel *channel = &engine->channels[i];

		waiting = 0;
		list_for_each_entry(packet, &channel->stream, node)
			waiting++;
		seq_printf(file, "%s_cr: %u\n%s_sr: %u\n%s_armed: %u\n%s_transfers: %llu\n", names[i],
			   channel->cr, names[i], axi_status(channel), names[i], channel->armed,
			   names[i], channel->transfers);
		seq_printf(file, "%s_bytes: %llu\n%s_interrupts: %llu\n%s_resets: %llu\n", names[i],
			   channel->bytes, names[i], channel->interrupts, names[i],
			   channel->resets);
		seq_printf(file, "%s_misuse: %llu\n%s_waiting: %u\n", names[i], channel->misuse,
			   names[i], waiting);
	}
	spin_unlock_irqrestore(&engine->lock, flags);
	return 0;
}
DEFINE_SHOW_ATTRIBUTE(state);

/* one write is one packet into S2MM */
static ssize_t packet_write(struct file *file, const char __user *from, size_t count, loff_t *offset)
{
	struct axi_engine *engine = file->private_data;
	struct axi_packet *packet;
	unsigned long flags;

	if (!count || count > PACKET_MAX)
		return -EINVAL;
	packet = axi_packet_new(count, GFP_KERNEL);
	if (!packet)
		return -ENOMEM;
	if (copy_from_user(packet->data, from, count)) {
		kfree(packet);
		return -EFAULT;
	}
	packet->tdest = engine->tdest;
	spin_lock_irqsave(&engine->lock, flags);
	list_add_tail(&packet->node, &engine->channels[1].stream);
	spin_unlock_irqrestore(&engine->lock, flags);
	axi_kick(engine);
	return count;
}

/* one read is one packet that MM2S has sent */
static ssize_t packet_read(struct file *file, char __user *to, size_t count, loff_t *offset)
{
	struct axi_engine *engine = file->private_data;
	struct axi_packet *packet;
	unsigned long flags;
	ssize_t ret;

	spin_lock_irqsave(&engine->lock, flags);
	packet = axi_packet_first(&engine->channels[0]);
	if (packet)
		list_del_init(&packet->node);
	spin_unlock_irqrestore(&engine->lock, flags);
	if (!packet)
		return 0;
	ret = min(count, packet->length);
	if (copy_to_user(to, packet->data, ret))
		ret = -EFAULT;
	kfree(packet);
	return ret;
}

static const struct file_operations packet_fops = {
	.owner = THIS_MODULE,
	.open = simple_open,
	.read = packet_read,
	.write = packet_write,
	.llseek = noop_llseek,
};

static int kick_set(void *data, u64 value)
{
	axi_kick(data);
	return 0;
}
DEFINE_DEBUGFS_ATTRIBUTE(kick_fops, NULL, kick_set, "%llu\n");

static void channel_files(struct axi_channel *channel, const char *name, struct dentry *folder)
{
	struct dentry *own = debugfs_create_dir(name, folder);

	debugfs_create_x32("inject", 0600, own, &channel->inject);
	debugfs_create_u32("hold", 0600, own, &channel->hold);
	debugfs_create_u32("sticks", 0600, own, &channel->sticks);
}

/**
 * axi_debugfs() - the files of an engine
 * @engine: engine
 * @root: folder of the model
 */
void axi_debugfs(struct axi_engine *engine, struct dentry *root)
{
	struct dentry *folder = debugfs_create_dir(engine->label, root);

	engine->debugfs = folder;
	debugfs_create_file("trace", 0600, folder, engine, &trace_fops);
	debugfs_create_file("state", 0400, folder, engine, &state_fops);
	debugfs_create_file("packet", 0600, folder, engine, &packet_fops);
	debugfs_create_file_unsafe("kick", 0200, folder, engine, &kick_fops);
	debugfs_create_u32("tdest", 0600, folder, &engine->tdest);
	debugfs_create_u32("fail_next", 0600, folder, &engine->fail_next);
	debugfs_create_u64("loads", 0400, folder, &engine->port.loads);
	debugfs_create_u32("words", 0400, folder, &engine->port.words);
	debugfs_create_x32("inject_errors", 0600, folder, &engine->port.inject);
	debugfs_create_x32("force_status", 0600, folder, &engine->port.force);
	debugfs_create_x32("identity", 0600, folder, &engine->port.loaded);
	debugfs_create_u32("delay_us", 0600, folder, &engine->port.delay_us);
	channel_files(&engine->channels[0], "mm2s", folder);
	channel_files(&engine->channels[1], "s2mm", folder);
}
