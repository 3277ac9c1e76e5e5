// SPDX-License-Identifier: GPL-2.0-only
/* What a process can do with /dev/cm_dma/<name>. */
#include <linux/compat.h>
#include <linux/fs.h>
#include <linux/poll.h>
#include <linux/slab.h>
#include <linux/uaccess.h>
#include <linux/wait.h>

#include "cm_compat.h"
#include "node.h"
#include "queue.h"

/**
 * struct cm_file - one open file
 * @node: a reference to its device is held
 * @channel: claimed
 * @table: buffers
 * @read_lock: one reader at a time
 * @lock: protects @queue
 * @queue: completions
 * @ring: memory of @queue
 */
struct cm_file {
	struct cm_node *node;
	struct cm_channel *channel;
	struct cm_buffer_table table;
	struct mutex read_lock; /* one reader at a time */
	spinlock_t lock; /* protects queue */
	struct cm_queue queue;
	struct cm_dma_completion ring[];
};

static int cm_dma_open(struct inode *inode, struct file *file)
{
	struct cm_node *node = container_of(inode->i_cdev, struct cm_node, cdev);
	struct cm_channel *channel = node->channel;
	u32 entries = channel->info.queue_depth + 1;
	struct cm_file *self;
	int ret;

	self = kvzalloc(struct_size(self, ring, entries), GFP_KERNEL);
	if (!self)
		return -ENOMEM;
	ret = cm_buffer_table_init(&self->table);
	if (ret)
		goto no_table;
	ret = cm_channel_claim(channel);
	if (ret)
		goto no_channel;
	get_device(&node->dev);
	self->node = node;
	self->channel = channel;
	mutex_init(&self->read_lock);
	spin_lock_init(&self->lock);
	cm_queue_init(&self->queue, self->ring, entries);
	file->private_data = self;
	return stream_open(inode, file);

no_channel:
	cm_buffer_table_destroy(&self->table);
no_table:
	kvfree(self);
	return ret;
}

/* the engine stops before any memory can go */
static int cm_dma_release(struct inode *inode, struct file *file)
{
	struct cm_file *self = file->private_data;

	cm_channel_release(self->channel);
	cm_buffer_table_destroy(&self->table);
	put_device(&self->node->dev);
	kvfree(self);
	return 0;
}

static void file_done(void *context, const struct cm_result *result)
{
	struct cm_file *self = context;
	struct cm_dma_completion completion = {
		.cookie = result->cookie,
		.length = result->length,
		.timestamp_ns = result->timestamp_ns,
		.status = result->status,
	};

	spin_lock_bh(&self->lock);
	if (result->last)
		cm_queue_push(&self->queue, &completion);
	else
		cm_queue_push_cyclic(&self->queue, &completion, result->readable);
	spin_unlock_bh(&self->lock);
	wake_up_interruptible(&self->channel->waiting);
}

static bool file_ready(struct cm_file *self)
{
	bool ready;

	spin_lock_bh(&self->lock);
	ready = cm_queue_count(&self->queue);
	spin_unlock_bh(&self->lock);
	return ready || !READ_ONCE(self->channel->chan);
}

static bool file_peek(struct cm_file *self, u64 *index, struct cm_dma_completion *completion)
{
	bool found;

	spin_lock_bh(&self->lock);
	found = cm_queue_peek(&self->queue, index, completion);
	spin_unlock_bh(&self->lock);
	return found;
}

static void file_drop(struct cm_file *self, u64 index)
{
	spin_lock_bh(&self->lock);
	cm_queue_drop(&self->queue, index);
	spin_unlock_bh(&self->lock);
}

static ssize_t read_some(struct cm_file *self, char __user *to, size_t count)
{
	struct cm_dma_completion completion;
	ssize_t done = 0;
	u64 index;

	while (count - done >= sizeof(completion) && file_peek(self, &index, &completion)) {
		if (copy_to_user(to + done, &completion, sizeof(completion)))
			return done ?: -EFAULT;
		file_drop(self, index);
		done += sizeof(completion);
	}
	return done;
}

static int wait_ready(struct cm_file *self, bool nonblock)
{
	if (file_ready(self))
		return 0;
	if (nonblock)
		return -EAGAIN;
	return wait_event_interruptible(self->channel->waiting, file_ready(self));
}

static ssize_t cm_dma_read(struct file *file, char __user *to, size_t count, loff_t *position)
{
	struct cm_file *self = file->private_data;
	ssize_t ret;

	if (count < sizeof(struct cm_dma_completion))
		return -EINVAL;
	do {
		ret = wait_ready(self, file->f_flags & O_NONBLOCK);
		if (ret)
			return ret;
		if (mutex_lock_interruptible(&self->read_lock))
			return -ERESTARTSYS;
		ret = read_some(self, to, count);
		mutex_unlock(&self->read_lock);
	} while (!ret && READ_ONCE(self->channel->chan));
	return ret ?: -ENODEV;
}

static __poll_t cm_dma_poll(struct file *file, poll_table *wait)
{
	struct cm_file *self = file->private_data;
	__poll_t events = 0;

	poll_wait(file, &self->channel->waiting, wait);
	spin_lock_bh(&self->lock);
	if (cm_queue_count(&self->queue))
		events |= EPOLLIN | EPOLLRDNORM;
	spin_unlock_bh(&self->lock);
	if (!READ_ONCE(self->channel->chan))
		events |= EPOLLHUP | EPOLLERR;
	return events;
}

static long ioctl_info(struct cm_file *self, void __user *arg)
{
	struct cm_dma_info info;
	u32 size;
	int ret = cm_args_get(&info, sizeof(info), CM_DMA_INFO_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (info.flags)
		return -EINVAL;
	size = info.size;
	info = self->channel->info;
	info.size = size;
	return cm_args_put(arg, &info, sizeof(info));
}

static int reserve(struct cm_file *self)
{
	int ret;

	spin_lock_bh(&self->lock);
	ret = cm_queue_reserve(&self->queue);
	spin_unlock_bh(&self->lock);
	return ret;
}

static void unreserve(struct cm_file *self)
{
	spin_lock_bh(&self->lock);
	cm_queue_unreserve(&self->queue);
	spin_unlock_bh(&self->lock);
}

static long submit(struct cm_file *self, u32 handle, struct cm_request *request)
{
	int ret;

	request->buffer = cm_buffer_table_get(&self->table, handle);
	if (!request->buffer)
		return -ENOENT;
	request->done = file_done;
	request->context = self;
	ret = reserve(self);
	if (!ret) {
		ret = cm_channel_submit(self->channel, request);
		if (ret)
			unreserve(self);
	}
	cm_buffer_put(request->buffer);
	return ret;
}

static long ioctl_submit(struct cm_file *self, void __user *arg)
{
	struct cm_request request = {};
	struct cm_dma_submit args;
	int ret = cm_args_get(&args, sizeof(args), CM_DMA_SUBMIT_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (args.flags & ~CM_DMA_SUBMIT_CYCLIC || args.reserved)
		return -EINVAL;
	request.offset = args.offset;
	request.length = args.length;
	request.period = args.period;
	request.cyclic = args.flags & CM_DMA_SUBMIT_CYCLIC;
	request.cookie = args.cookie;
	return submit(self, args.handle, &request);
}

static long ioctl_submit_video(struct cm_file *self, void __user *arg)
{
	struct cm_request request = {};
	struct cm_dma_submit_video args;
	int ret = cm_args_get(&args, sizeof(args), CM_DMA_SUBMIT_VIDEO_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (args.flags & ~CM_DMA_SUBMIT_CYCLIC || !args.lines)
		return -EINVAL;
	request.offset = args.offset;
	request.lines = args.lines;
	request.line_bytes = args.line_bytes;
	request.stride = args.stride;
	request.cyclic = args.flags & CM_DMA_SUBMIT_CYCLIC;
	request.cookie = args.cookie;
	return submit(self, args.handle, &request);
}

static long ioctl_cancel(struct cm_file *self, void __user *arg)
{
	struct cm_dma_cancel args;
	int ret = cm_args_get(&args, sizeof(args), CM_DMA_CANCEL_SIZE_VER0, arg);

	if (ret)
		return ret;
	return args.flags ? -EINVAL : cm_channel_cancel(self->channel);
}

/* the channel may have gone since we looked, and what was mapped for others is unmapped */
static long mapped_for(struct cm_file *self, long ret)
{
	if (!READ_ONCE(self->channel->chan))
		cm_buffer_table_unmap(&self->table);
	return ret;
}

static long cm_dma_ioctl(struct file *file, unsigned int command, unsigned long value)
{
	struct cm_file *self = file->private_data;
	void __user *arg = (void __user *)value;

	if (_IOC_TYPE(command) != CM_IOC_MAGIC)
		return -ENOTTY;
	if (!READ_ONCE(self->channel->chan) && _IOC_NR(command) != _IOC_NR(CM_DMA_IOC_FREE))
		return -ENODEV;
	/* the number alone: the size of a structure may grow */
	switch (_IOC_NR(command)) {
	case _IOC_NR(CM_DMA_IOC_INFO):
		return ioctl_info(self, arg);
	case _IOC_NR(CM_DMA_IOC_ALLOC):
		return mapped_for(self, cm_buffer_ioctl_alloc(&self->table,
							      self->channel->alloc_dev, arg));
	case _IOC_NR(CM_DMA_IOC_IMPORT):
		return mapped_for(self, cm_buffer_ioctl_import(&self->table,
							       self->channel->dma_dev,
							       cm_channel_direction(self->channel),
							       arg));
	case _IOC_NR(CM_DMA_IOC_FREE):
		return cm_buffer_ioctl_free(&self->table, arg);
	case _IOC_NR(CM_DMA_IOC_SUBMIT):
		return ioctl_submit(self, arg);
	case _IOC_NR(CM_DMA_IOC_SUBMIT_VIDEO):
		return ioctl_submit_video(self, arg);
	case _IOC_NR(CM_DMA_IOC_CANCEL):
		return ioctl_cancel(self, arg);
	default:
		return -ENOTTY;
	}
}

const struct file_operations cm_dma_fops = {
	.owner = THIS_MODULE,
	.open = cm_dma_open,
	.release = cm_dma_release,
	.read = cm_dma_read,
	.poll = cm_dma_poll,
	.unlocked_ioctl = cm_dma_ioctl,
	.compat_ioctl = compat_ptr_ioctl,
};
