// SPDX-License-Identifier: GPL-2.0-only
/*
 * Pages on loan.
 *
 * A grant's pages are not mapped until they are touched: the fault looks, under
 * windows_lock, whether the grant stands, and finds the register's page or the
 * grant's own page of ones.  Who revokes says so first and then takes away what
 * was mapped, all with the lock held for writing: a fault that came before is
 * undone, and one that comes after finds the ones.  They are PFNs without a
 * struct page, so nothing can pin one (get_user_pages(), ptrace, O_DIRECT).
 *
 * Each grant has an inode of its own for its mappings.  That of anon_inodes is
 * shared with all the kernel, and would have us take away others' pages.
 */
#include <linux/anon_inodes.h>
#include <linux/debugfs.h>
#include <linux/file.h>
#include <linux/fs.h>
#include <linux/gfp.h>
#include <linux/kref.h>
#include <linux/list.h>
#include <linux/magic.h>
#include <linux/miscdevice.h>
#include <linux/mm.h>
#include <linux/mount.h>
#include <linux/poll.h>
#include <linux/pseudo_fs.h>
#include <linux/rwsem.h>
#include <linux/slab.h>
#include <linux/suspend.h>
#include <linux/uaccess.h>

#include "cm_compat.h"
#include "cm_core.h"
#include "window.h"

#define CM_WINDOW_FS_MAGIC 0x434d574e
#define CM_GRANTS_MAX 4096

/**
 * struct cm_window - registers
 * @ref: one of who registered it, one of each grant
 * @siblings: in the list of all windows
 * @grants: of its pages, those revoked too
 * @config: where it is
 * @shut: its bridge is disabled: nothing is lent
 */
struct cm_window {
	struct kref ref;
	struct list_head siblings;
	struct list_head grants;
	struct cm_window_config config;
	bool shut;
};

/**
 * struct cm_window_file - who lends: an open file of the node
 * @grants: its grants, until their last event was read
 * @count: how many these are
 * @last: number of the newest one
 * @events: how many wait to be read
 * @waiting: woken for each event
 * @read_lock: one reader at a time
 */
struct cm_window_file {
	struct list_head grants;
	u32 count;
	u32 last;
	u32 events;
	wait_queue_head_t waiting;
	struct mutex read_lock; /* one reader at a time */
};

/**
 * struct cm_grant - pages on loan
 * @of_window: in the window's list; empty once it is released
 * @of_file: in the list of who lent it
 * @window: where the pages are; a reference is held
 * @file: who lent it; NULL once that is closed
 * @inode: for its mappings
 * @id: its number
 * @first: its first page, counted from the window's
 * @pages: how many
 * @write: it may be written
 * @revoked: why it ended, or 0
 * @untold: the end is an event that was not read
 * @released: its last descriptor and mapping are gone
 * @state: page 0
 * @ones: what it reads as once it is revoked
 */
struct cm_grant {
	struct list_head of_window;
	struct list_head of_file;
	struct cm_window *window;
	struct cm_window_file *file;
	struct inode *inode;
	u32 id;
	unsigned long first;
	unsigned long pages;
	bool write;
	u32 revoked;
	bool untold;
	bool released;
	struct page *state;
	struct page *ones;
};

/* read: a fault; write: everything else that looks at windows and grants */
static DECLARE_RWSEM(windows_lock);
static LIST_HEAD(windows);
static bool asleep; /* nothing is lent */
static atomic_t lent;

static struct vfsmount *window_mount;
static int window_pins;
static struct dentry *window_debugfs;

static int window_fs_init(struct fs_context *context)
{
	return init_pseudo(context, CM_WINDOW_FS_MAGIC) ? 0 : -ENOMEM;
}

static struct file_system_type window_fs = {
	.owner = THIS_MODULE,
	.name = "cm_window",
	.init_fs_context = window_fs_init,
	.kill_sb = kill_anon_super,
};

static struct inode *new_inode_of_ours(void)
{
	struct inode *inode;
	int ret = simple_pin_fs(&window_fs, &window_mount, &window_pins);

	if (ret)
		return ERR_PTR(ret);
	inode = alloc_anon_inode(window_mount->mnt_sb);
	if (IS_ERR(inode))
		simple_release_fs(&window_mount, &window_pins);
	return inode;
}

static void free_inode_of_ours(struct inode *inode)
{
	iput(inode);
	simple_release_fs(&window_mount, &window_pins);
}

static void tell_locked(struct cm_window_file *file)
{
	WRITE_ONCE(file->events, file->events + 1);
	wake_up(&file->waiting);
}

static void window_free(struct kref *ref)
{
	kfree(container_of(ref, struct cm_window, ref));
}

/* what was mapped is gone, from every process and every TLB, when this returns */
static void revoke_locked(struct cm_grant *grant, u32 reason)
{
	struct cm_window_state *state = page_address(grant->state);

	if (grant->revoked)
		return;
	grant->revoked = reason;
	WRITE_ONCE(state->revoked, reason);
	/* who finds the ones, finds it said */
	smp_wmb();
	unmap_mapping_range(grant->inode->i_mapping, PAGE_SIZE, 0, 1);
	if (grant->file && reason != CM_WINDOW_REVOKED_CALL && reason != CM_WINDOW_REVOKED_OWNER) {
		grant->untold = true;
		tell_locked(grant->file);
	}
}

static u32 revoke_window_locked(struct cm_window *window, unsigned long first, unsigned long end,
				u32 reason)
{
	struct cm_grant *grant;
	u32 count = 0;

	list_for_each_entry(grant, &window->grants, of_window) {
		if (grant->revoked || grant->first >= end || grant->first + grant->pages <= first)
			continue;
		revoke_locked(grant, reason);
		count++;
	}
	return count;
}

static vm_fault_t grant_fault(struct vm_fault *vmf)
{
	struct cm_grant *grant = vmf->vma->vm_private_data;
	const struct cm_window_config *config = &grant->window->config;
	pgprot_t prot = vmf->vma->vm_page_prot;
	unsigned long pfn;
	vm_fault_t ret;

	down_read(&windows_lock);
	if (!vmf->pgoff) {
		pfn = page_to_pfn(grant->state);
	} else if (grant->revoked) {
		pfn = page_to_pfn(grant->ones);
	} else {
		pfn = config->pfn(config->context, grant->first + vmf->pgoff - 1);
		if (!config->memory)
			prot = pgprot_noncached(prot);
	}
	ret = vmf_insert_pfn_prot(vmf->vma, vmf->address, pfn, prot);
	up_read(&windows_lock);
	return ret;
}

static const struct vm_operations_struct grant_vm_ops = {
	.fault = grant_fault,
};

/* page 0 is never written, the others only where that was lent */
static bool may_write(const struct cm_grant *grant, const struct vm_area_struct *vma)
{
	return grant->write && vma->vm_pgoff;
}

static int grant_mmap(struct file *file, struct vm_area_struct *vma)
{
	struct cm_grant *grant = file->private_data;

	if (vma->vm_pgoff > grant->pages ||
	    vma_pages(vma) > grant->pages + 1 - vma->vm_pgoff || !(vma->vm_flags & VM_MAYSHARE))
		return -EINVAL;
	if (vma->vm_flags & VM_EXEC || (vma->vm_flags & VM_WRITE && !may_write(grant, vma)))
		return -EACCES;
	cm_vm_flags_clear(vma, VM_MAYEXEC | (may_write(grant, vma) ? 0 : VM_MAYWRITE));
	cm_vm_flags_set(vma, VM_IO | VM_PFNMAP | VM_DONTEXPAND | VM_DONTDUMP | VM_DONTCOPY);
	vma->vm_private_data = grant;
	vma->vm_ops = &grant_vm_ops;
	return 0;
}

static void grant_free(struct cm_grant *grant)
{
	if (!IS_ERR_OR_NULL(grant->inode))
		free_inode_of_ours(grant->inode);
	if (grant->state)
		__free_page(grant->state);
	if (grant->ones)
		__free_page(grant->ones);
	if (grant->window)
		kref_put(&grant->window->ref, window_free);
	kfree(grant);
}

static bool over_locked(const struct cm_grant *grant)
{
	return grant->released && !grant->file;
}

/* the last descriptor, and each mapping has one */
static int grant_release(struct inode *inode, struct file *file)
{
	struct cm_grant *grant = file->private_data;
	bool over;

	down_write(&windows_lock);
	list_del_init(&grant->of_window);
	grant->released = true;
	over = over_locked(grant);
	if (!over)
		tell_locked(grant->file);
	up_write(&windows_lock);
	atomic_dec(&lent);
	if (over)
		grant_free(grant);
	return 0;
}

static const struct file_operations grant_fops = {
	.owner = THIS_MODULE,
	.mmap = grant_mmap,
	.release = grant_release,
	.llseek = noop_llseek,
};

static struct cm_grant *grant_new(const struct cm_window_grant *args)
{
	struct cm_grant *grant = kzalloc(sizeof(*grant), GFP_KERNEL_ACCOUNT);
	struct cm_window_state *state;

	if (!grant)
		return ERR_PTR(-ENOMEM);
	INIT_LIST_HEAD(&grant->of_window);
	INIT_LIST_HEAD(&grant->of_file);
	grant->state = alloc_page(GFP_KERNEL_ACCOUNT | __GFP_ZERO);
	grant->ones = alloc_page(GFP_KERNEL_ACCOUNT);
	grant->inode = new_inode_of_ours();
	if (!grant->state || !grant->ones || IS_ERR(grant->inode)) {
		grant_free(grant);
		return ERR_PTR(-ENOMEM);
	}
	grant->pages = args->length >> PAGE_SHIFT;
	grant->write = args->flags & CM_WINDOW_WRITE;
	memset(page_address(grant->ones), 0xff, PAGE_SIZE);
	state = page_address(grant->state);
	state->flags = args->flags;
	state->length = args->length;
	return grant;
}

static struct cm_window *find_locked(u64 address, u64 length)
{
	struct cm_window *window;

	list_for_each_entry(window, &windows, siblings) {
		u64 offset = address - window->config.address;

		if (address >= window->config.address && offset < window->config.length &&
		    length <= window->config.length - offset)
			return window;
	}
	return NULL;
}

static int lend_locked(struct cm_window_file *self, struct cm_grant *grant, u64 address, u64 length)
{
	struct cm_window *window = find_locked(address, length);

	if (!window)
		return -ENXIO;
	if (window->config.refusal)
		return window->config.refusal;
	if (window->shut || asleep)
		return -EAGAIN;
	if (self->count >= CM_GRANTS_MAX || self->last == U32_MAX)
		return -ENOSPC;
	kref_get(&window->ref);
	grant->window = window;
	grant->first = (address - window->config.address) >> PAGE_SHIFT;
	grant->file = self;
	grant->id = ++self->last;
	self->count++;
	list_add_tail(&grant->of_window, &window->grants);
	list_add_tail(&grant->of_file, &self->grants);
	return 0;
}

static void take_out_locked(struct cm_window_file *self, struct cm_grant *grant)
{
	list_del_init(&grant->of_file);
	grant->file = NULL;
	self->count--;
}

/* it was in no process's hands yet */
static void withdraw(struct cm_window_file *self, struct cm_grant *grant)
{
	down_write(&windows_lock);
	list_del_init(&grant->of_window);
	take_out_locked(self, grant);
	up_write(&windows_lock);
	grant_free(grant);
}

static struct file *grant_open(struct cm_grant *grant)
{
	struct file *file = anon_inode_getfile("[cm_window]", &grant_fops, grant,
					       grant->write ? O_RDWR : O_RDONLY);

	if (!IS_ERR(file)) {
		file->f_mapping = grant->inode->i_mapping;
		atomic_inc(&lent);
	}
	return file;
}

static int lend(struct cm_window_file *self, struct cm_window_grant *args, void __user *to)
{
	struct cm_grant *grant = grant_new(args);
	struct file *file;
	int ret, fd;

	if (IS_ERR(grant))
		return PTR_ERR(grant);
	down_write(&windows_lock);
	ret = lend_locked(self, grant, args->address, args->length);
	up_write(&windows_lock);
	if (ret) {
		grant_free(grant);
		return ret;
	}
	args->id = grant->id;
	file = grant_open(grant);
	if (IS_ERR(file)) {
		withdraw(self, grant);
		return PTR_ERR(file);
	}
	/* from here on it ends as any other does */
	fd = get_unused_fd_flags(O_CLOEXEC);
	if (fd < 0) {
		fput(file);
		return fd;
	}
	args->fd = fd;
	ret = cm_args_put(to, args, sizeof(*args));
	if (ret) {
		put_unused_fd(fd);
		fput(file);
		return ret;
	}
	fd_install(fd, file);
	return 0;
}

static long ioctl_grant(struct cm_window_file *self, void __user *arg)
{
	struct cm_window_grant args;
	int ret = cm_args_get(&args, sizeof(args), CM_WINDOW_GRANT_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (args.flags & ~CM_WINDOW_WRITE || !args.length ||
	    (args.address | args.length) & ~PAGE_MASK || args.address + args.length < args.address)
		return -EINVAL;
	return lend(self, &args, arg);
}

static int revoke_one_locked(struct cm_window_file *self, u32 id, u32 *count)
{
	struct cm_grant *grant;

	list_for_each_entry(grant, &self->grants, of_file) {
		if (grant->id != id)
			continue;
		*count = !grant->revoked;
		revoke_locked(grant, CM_WINDOW_REVOKED_CALL);
		return 0;
	}
	return -ENOENT;
}

static u32 revoke_range_locked(u64 address, u64 end)
{
	struct cm_window *window;
	u32 count = 0;

	list_for_each_entry(window, &windows, siblings) {
		u64 from = max(address, window->config.address);
		u64 to = min(end, window->config.address + window->config.length);

		if (from >= to)
			continue;
		count += revoke_window_locked(window, (from - window->config.address) >> PAGE_SHIFT,
					      (to - 1 - window->config.address) / PAGE_SIZE + 1,
					      CM_WINDOW_REVOKED_CALL);
	}
	return count;
}

static long ioctl_revoke(struct cm_window_file *self, void __user *arg)
{
	struct cm_window_revoke args;
	int ret = cm_args_get(&args, sizeof(args), CM_WINDOW_REVOKE_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (args.flags || (args.id && (args.address || args.length)) ||
	    (!args.id && !args.length) || args.address + args.length < args.address)
		return -EINVAL;
	down_write(&windows_lock);
	if (args.id)
		ret = revoke_one_locked(self, args.id, &args.count);
	else
		args.count = revoke_range_locked(args.address, args.address + args.length);
	up_write(&windows_lock);
	return ret ?: cm_args_put(arg, &args, sizeof(args));
}

static long cm_window_ioctl(struct file *file, unsigned int command, unsigned long value)
{
	struct cm_window_file *self = file->private_data;
	void __user *arg = (void __user *)value;

	if (_IOC_TYPE(command) != CM_IOC_MAGIC)
		return -ENOTTY;
	/* the number alone: the size of a structure may grow */
	switch (_IOC_NR(command)) {
	case _IOC_NR(CM_WINDOW_IOC_GRANT):
		return ioctl_grant(self, arg);
	case _IOC_NR(CM_WINDOW_IOC_REVOKE):
		return ioctl_revoke(self, arg);
	default:
		return -ENOTTY;
	}
}

static bool told(const struct cm_grant *grant)
{
	return !grant->untold && !grant->released;
}

/* the end first, then the release, after which the grant is forgotten */
static bool take_event(struct cm_window_file *self, struct cm_window_event *event)
{
	struct cm_grant *grant, *over = NULL;
	bool found = false;

	down_write(&windows_lock);
	list_for_each_entry(grant, &self->grants, of_file) {
		if (told(grant))
			continue;
		found = true;
		event->id = grant->id;
		event->reason = grant->untold ? grant->revoked : CM_WINDOW_RELEASED;
		if (!grant->untold) {
			take_out_locked(self, grant);
			over = grant;
		}
		grant->untold = false;
		WRITE_ONCE(self->events, self->events - 1);
		break;
	}
	up_write(&windows_lock);
	if (over)
		grant_free(over);
	return found;
}

static ssize_t cm_window_read(struct file *file, char __user *to, size_t count, loff_t *position)
{
	struct cm_window_file *self = file->private_data;
	struct cm_window_event event;
	size_t done = 0;
	int ret;

	if (count < sizeof(event))
		return -EINVAL;
	ret = mutex_lock_interruptible(&self->read_lock);
	if (ret)
		return ret;
	for (;;) {
		while (!ret && done + sizeof(event) <= count && take_event(self, &event)) {
			/* an event that could not be handed over is lost with its reader */
			if (copy_to_user(to + done, &event, sizeof(event)))
				ret = -EFAULT;
			else
				done += sizeof(event);
		}
		if (done || ret)
			break;
		if (file->f_flags & O_NONBLOCK)
			ret = -EAGAIN;
		else
			ret = wait_event_interruptible(self->waiting, READ_ONCE(self->events));
		if (ret)
			break;
	}
	mutex_unlock(&self->read_lock);
	return done ?: ret;
}

static __poll_t cm_window_poll(struct file *file, poll_table *wait)
{
	struct cm_window_file *self = file->private_data;

	poll_wait(file, &self->waiting, wait);
	return READ_ONCE(self->events) ? EPOLLIN | EPOLLRDNORM : 0;
}

static int cm_window_open(struct inode *inode, struct file *file)
{
	struct cm_window_file *self = kzalloc(sizeof(*self), GFP_KERNEL);

	if (!self)
		return -ENOMEM;
	INIT_LIST_HEAD(&self->grants);
	init_waitqueue_head(&self->waiting);
	mutex_init(&self->read_lock);
	file->private_data = self;
	return stream_open(inode, file);
}

/* who lent is gone, and nobody else would know when to take them back */
static int cm_window_release(struct inode *inode, struct file *file)
{
	struct cm_window_file *self = file->private_data;
	struct cm_grant *grant, *next;
	LIST_HEAD(over);

	down_write(&windows_lock);
	list_for_each_entry_safe(grant, next, &self->grants, of_file) {
		revoke_locked(grant, CM_WINDOW_REVOKED_OWNER);
		take_out_locked(self, grant);
		if (over_locked(grant))
			list_add(&grant->of_file, &over);
	}
	up_write(&windows_lock);
	list_for_each_entry_safe(grant, next, &over, of_file)
		grant_free(grant);
	mutex_destroy(&self->read_lock);
	kfree(self);
	return 0;
}

static const struct file_operations cm_window_fops = {
	.owner = THIS_MODULE,
	.open = cm_window_open,
	.release = cm_window_release,
	.read = cm_window_read,
	.poll = cm_window_poll,
	.unlocked_ioctl = cm_window_ioctl,
	.compat_ioctl = compat_ptr_ioctl,
};

static struct miscdevice window_node = {
	.minor = MISC_DYNAMIC_MINOR,
	.name = "cm_window",
	.fops = &cm_window_fops,
	.mode = 0600,
};

/**
 * cm_window_register() - offer a window's pages
 * @config: copied
 *
 * Return: a window for cm_window_unregister(), or an ERR_PTR: -EEXIST where it
 * overlaps another.
 */
struct cm_window *cm_window_register(const struct cm_window_config *config)
{
	struct cm_window *window = kzalloc(sizeof(*window), GFP_KERNEL);
	struct cm_window *other;
	int ret = 0;

	if (!window)
		return ERR_PTR(-ENOMEM);
	kref_init(&window->ref);
	INIT_LIST_HEAD(&window->grants);
	window->config = *config;
	if (!config->refusal && (config->address | config->length) & ~PAGE_MASK)
		window->config.refusal = -EINVAL;
	down_write(&windows_lock);
	list_for_each_entry(other, &windows, siblings) {
		if (config->address < other->config.address + other->config.length &&
		    other->config.address < config->address + config->length)
			ret = -EEXIST;
	}
	if (!ret)
		list_add_tail(&window->siblings, &windows);
	up_write(&windows_lock);
	if (ret) {
		kfree(window);
		return ERR_PTR(ret);
	}
	return window;
}
EXPORT_SYMBOL_CM(cm_window_register);

/**
 * cm_window_unregister() - take all pages back, and lend none any more
 * @window: window
 */
void cm_window_unregister(struct cm_window *window)
{
	down_write(&windows_lock);
	revoke_window_locked(window, 0, ULONG_MAX, CM_WINDOW_REVOKED_GONE);
	list_del(&window->siblings);
	up_write(&windows_lock);
	kref_put(&window->ref, window_free);
}
EXPORT_SYMBOL_CM(cm_window_unregister);

/**
 * cm_window_shut() - take all pages back, and lend none until cm_window_admit()
 * @window: window
 * @reason: CM_WINDOW_REVOKED_*
 */
void cm_window_shut(struct cm_window *window, u32 reason)
{
	down_write(&windows_lock);
	window->shut = true;
	revoke_window_locked(window, 0, ULONG_MAX, reason);
	up_write(&windows_lock);
}

/**
 * cm_window_admit() - pages may be lent
 * @window: window
 */
void cm_window_admit(struct cm_window *window)
{
	down_write(&windows_lock);
	window->shut = false;
	up_write(&windows_lock);
}

/* what is behind the pages may lose its power and its circuit; who had them asks again */
static int sleep_or_wake(struct notifier_block *block, unsigned long action, void *data)
{
	struct cm_window *window;

	down_write(&windows_lock);
	asleep = action == PM_SUSPEND_PREPARE || action == PM_HIBERNATION_PREPARE;
	list_for_each_entry(window, &windows, siblings) {
		if (asleep)
			revoke_window_locked(window, 0, ULONG_MAX, CM_WINDOW_REVOKED_SLEEP);
	}
	up_write(&windows_lock);
	return NOTIFY_DONE;
}

static struct notifier_block window_sleep = {
	.notifier_call = sleep_or_wake,
};

/**
 * cm_windows_init() - at the module's start
 *
 * Return: 0 or a negative errno.
 */
int cm_windows_init(void)
{
	int ret = register_pm_notifier(&window_sleep);

	if (ret)
		return ret;
	ret = misc_register(&window_node);
	if (ret) {
		unregister_pm_notifier(&window_sleep);
		return ret;
	}
	window_debugfs = debugfs_create_dir("cm_window", NULL);
	debugfs_create_atomic_t("lent", 0444, window_debugfs, &lent);
	cm_window_bridges_show(window_debugfs);
	return 0;
}

/**
 * cm_windows_exit() - at the module's end
 */
void cm_windows_exit(void)
{
	debugfs_remove_recursive(window_debugfs);
	misc_deregister(&window_node);
	unregister_pm_notifier(&window_sleep);
}
