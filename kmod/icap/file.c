// SPDX-License-Identifier: GPL-2.0-only
/* What a process can do with /dev/cm_icap<N>. */
#include <linux/compat.h>
#include <linux/fs.h>
#include <linux/poll.h>
#include <linux/slab.h>
#include <linux/uaccess.h>

#include "cm_compat.h"
#include "icap.h"

/* most completions that a file keeps for a program that does not read them */
#define CM_ICAP_UNREAD_MAX 64

/**
 * struct cm_icap_file - one open file
 * @icap: port; a reference is held
 * @table: buffers
 * @lock: protects @ended, @unread, @loading, @next
 * @ended: struct cm_icap_ended, to be read
 * @unread: how many there are
 * @loading: a load of this file runs
 * @next: entry for the load that runs
 */
struct cm_icap_file {
	struct cm_icap *icap;
	struct cm_buffer_table table;
	spinlock_t lock; /* protects ended, unread, loading, next */
	struct list_head ended;
	u32 unread;
	bool loading;
	struct cm_icap_ended *next;
};

/**
 * struct cm_icap_ended - a completion that was not read
 * @node: in the file's list
 * @completion: completion
 */
struct cm_icap_ended {
	struct list_head node;
	struct cm_icap_completion completion;
};

static int cm_icap_open(struct inode *inode, struct file *file)
{
	struct cm_icap *icap = container_of(file->private_data, struct cm_icap, misc);
	struct cm_icap_file *self = kzalloc(sizeof(*self), GFP_KERNEL);

	if (!self)
		return -ENOMEM;
	if (cm_buffer_table_init(&self->table)) {
		kfree(self);
		return -ENOMEM;
	}
	kref_get(&icap->ref);
	self->icap = icap;
	spin_lock_init(&self->lock);
	INIT_LIST_HEAD(&self->ended);
	file->private_data = self;
	return stream_open(inode, file);
}

static bool file_loading(struct cm_icap_file *self)
{
	bool loading;

	spin_lock(&self->lock);
	loading = self->loading;
	spin_unlock(&self->lock);
	return loading;
}

/* a port is never stopped half way; a load ends in bounded time */
static int cm_icap_release(struct inode *inode, struct file *file)
{
	struct cm_icap_file *self = file->private_data;
	struct cm_icap_ended *ended, *next;

	wait_event(self->icap->idle, !file_loading(self));
	list_for_each_entry_safe(ended, next, &self->ended, node)
		kfree(ended);
	cm_buffer_table_destroy(&self->table);
	cm_icap_put(self->icap);
	kfree(self);
	return 0;
}

/* a waiting process is woken by the port, and finds the end of its file's load or not */
static void file_done(void *context, const struct cm_icap_completion *completion)
{
	struct cm_icap_file *self = context;

	spin_lock(&self->lock);
	self->next->completion = *completion;
	list_add_tail(&self->next->node, &self->ended);
	self->unread++;
	self->next = NULL;
	self->loading = false;
	spin_unlock(&self->lock);
}

static struct cm_icap_ended *take_ended(struct cm_icap_file *self)
{
	struct cm_icap_ended *ended;

	spin_lock(&self->lock);
	ended = list_first_entry_or_null(&self->ended, struct cm_icap_ended, node);
	if (ended) {
		list_del(&ended->node);
		self->unread--;
	}
	spin_unlock(&self->lock);
	return ended;
}

static void give_back(struct cm_icap_file *self, struct cm_icap_ended *ended)
{
	spin_lock(&self->lock);
	list_add(&ended->node, &self->ended);
	self->unread++;
	spin_unlock(&self->lock);
}

static bool has_ended(struct cm_icap_file *self)
{
	bool ended;

	spin_lock(&self->lock);
	ended = !list_empty(&self->ended);
	spin_unlock(&self->lock);
	return ended;
}

static ssize_t cm_icap_read(struct file *file, char __user *to, size_t count, loff_t *position)
{
	struct cm_icap_file *self = file->private_data;
	struct cm_icap_ended *ended;
	int ret;

	if (count < sizeof(ended->completion))
		return -EINVAL;
	while (!(ended = take_ended(self))) {
		if (READ_ONCE(self->icap->gone))
			return -ENODEV;
		if (file->f_flags & O_NONBLOCK)
			return -EAGAIN;
		ret = wait_event_interruptible(self->icap->idle, has_ended(self) ||
					       READ_ONCE(self->icap->gone));
		if (ret)
			return ret;
	}
	if (copy_to_user(to, &ended->completion, sizeof(ended->completion))) {
		give_back(self, ended);
		return -EFAULT;
	}
	kfree(ended);
	return sizeof(ended->completion);
}

static __poll_t cm_icap_poll(struct file *file, poll_table *wait)
{
	struct cm_icap_file *self = file->private_data;
	__poll_t events = 0;

	poll_wait(file, &self->icap->idle, wait);
	if (has_ended(self))
		events |= EPOLLIN | EPOLLRDNORM;
	if (READ_ONCE(self->icap->gone))
		events |= EPOLLHUP | EPOLLERR;
	return events;
}

static long ioctl_info(struct cm_icap *icap, void __user *arg)
{
	struct cm_icap_info info;
	u32 size;
	int ret = cm_args_get(&info, sizeof(info), CM_ICAP_INFO_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (info.flags)
		return -EINVAL;
	size = info.size;
	info = icap->info;
	info.size = size;
	return cm_args_put(arg, &info, sizeof(info));
}

static long ioctl_status(struct cm_icap *icap, void __user *arg)
{
	struct cm_icap_status status;
	u32 size;
	int ret = cm_args_get(&status, sizeof(status), CM_ICAP_STATUS_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (status.flags)
		return -EINVAL;
	size = status.size;
	mutex_lock(&icap->lock);
	status = icap->status;
	mutex_unlock(&icap->lock);
	status.size = size;
	return cm_args_put(arg, &status, sizeof(status));
}

static int file_begin(struct cm_icap_file *self)
{
	struct cm_icap_ended *entry = kzalloc(sizeof(*entry), GFP_KERNEL);
	int ret = 0;

	if (!entry)
		return -ENOMEM;
	spin_lock(&self->lock);
	if (self->loading || self->unread >= CM_ICAP_UNREAD_MAX) {
		ret = -EBUSY;
	} else {
		self->loading = true;
		self->next = entry;
	}
	spin_unlock(&self->lock);
	if (ret)
		kfree(entry);
	return ret;
}

static void file_withdraw(struct cm_icap_file *self)
{
	struct cm_icap_ended *entry;

	spin_lock(&self->lock);
	entry = self->next;
	self->next = NULL;
	self->loading = false;
	spin_unlock(&self->lock);
	kfree(entry);
}

static long start(struct cm_icap_file *self, struct cm_icap_request *request)
{
	int ret = file_begin(self);

	if (ret)
		return ret;
	ret = cm_icap_start(self->icap, request);
	if (ret)
		file_withdraw(self);
	return ret;
}

static long ioctl_load(struct cm_icap_file *self, void __user *arg)
{
	struct cm_icap_request request = { .done = file_done, .context = self,
					   .own_bridges = true };
	struct cm_icap_load args;
	long ret = cm_args_get(&args, sizeof(args), CM_ICAP_LOAD_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (args.flags & ~(CM_ICAP_LOAD_FULL | CM_ICAP_LOAD_ENCRYPTED) || args.reserved)
		return -EINVAL;
	/* a full bitstream replaces the port that it comes through */
	if (args.flags & CM_ICAP_LOAD_FULL && !self->icap->full)
		return -EOPNOTSUPP;
	request.buffer = cm_buffer_table_get(&self->table, args.handle);
	if (!request.buffer)
		return -ENOENT;
	request.words.offset = args.offset;
	request.words.length = args.length;
	request.cookie = args.cookie;
	ret = start(self, &request);
	cm_buffer_put(request.buffer);
	return ret;
}

static long ioctl_read(struct cm_icap_file *self, void __user *arg)
{
	struct cm_icap_request request = { .done = file_done, .context = self };
	struct cm_icap_read args;
	long ret = cm_args_get(&args, sizeof(args), CM_ICAP_READ_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (args.flags || args.reserved)
		return -EINVAL;
	if (!self->icap->back)
		return -EOPNOTSUPP;
	/* without one it would be a load */
	if (!args.reply_length)
		return -EINVAL;
	request.buffer = cm_buffer_table_get(&self->table, args.handle);
	if (!request.buffer)
		return -ENOENT;
	request.words = (struct cm_icap_part){ args.request_offset, args.request_length };
	request.reply = (struct cm_icap_part){ args.reply_offset, args.reply_length };
	request.closing = (struct cm_icap_part){ args.closing_offset, args.closing_length };
	request.cookie = args.cookie;
	ret = start(self, &request);
	cm_buffer_put(request.buffer);
	return ret;
}

/* the port may have gone since we looked, and what was mapped for it is unmapped */
static long mapped_for(struct cm_icap_file *self, long ret)
{
	if (!READ_ONCE(self->icap->channel->chan))
		cm_buffer_table_unmap(&self->table);
	return ret;
}

static long cm_icap_ioctl(struct file *file, unsigned int command, unsigned long value)
{
	struct cm_icap_file *self = file->private_data;
	struct device *dev = self->icap->channel->alloc_dev;
	void __user *arg = (void __user *)value;

	if (_IOC_TYPE(command) != CM_IOC_MAGIC)
		return -ENOTTY;
	if (READ_ONCE(self->icap->gone) && _IOC_NR(command) != _IOC_NR(CM_ICAP_IOC_FREE))
		return -ENODEV;
	switch (_IOC_NR(command)) {
	case _IOC_NR(CM_ICAP_IOC_INFO):
		return ioctl_info(self->icap, arg);
	case _IOC_NR(CM_ICAP_IOC_ALLOC):
		return mapped_for(self, cm_buffer_ioctl_alloc(&self->table, dev, arg));
	case _IOC_NR(CM_ICAP_IOC_IMPORT):
		return mapped_for(self, cm_buffer_ioctl_import(&self->table,
							       self->icap->channel->dma_dev,
							       self->icap->back ?
							       DMA_BIDIRECTIONAL :
							       DMA_TO_DEVICE, arg));
	case _IOC_NR(CM_ICAP_IOC_FREE):
		return cm_buffer_ioctl_free(&self->table, arg);
	case _IOC_NR(CM_ICAP_IOC_LOAD):
		return ioctl_load(self, arg);
	case _IOC_NR(CM_ICAP_IOC_READ):
		return ioctl_read(self, arg);
	case _IOC_NR(CM_ICAP_IOC_STATUS):
		return ioctl_status(self->icap, arg);
	default:
		return -ENOTTY;
	}
}

const struct file_operations cm_icap_fops = {
	.owner = THIS_MODULE,
	.open = cm_icap_open,
	.release = cm_icap_release,
	.read = cm_icap_read,
	.poll = cm_icap_poll,
	.unlocked_ioctl = cm_icap_ioctl,
	.compat_ioctl = compat_ptr_ioctl,
};
