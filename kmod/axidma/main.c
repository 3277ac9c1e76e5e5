// SPDX-License-Identifier: GPL-2.0-only
/*
 * cm_axidma_compat: /dev/axidma for programs built against libaxidma, on top
 * of cm_dma's channels.
 *
 * What the original did and this does not: kernel pointers do not go out,
 * memory is found in what this file mapped or registered and ranges are
 * checked, memory outlives transfers that use it, and the channels belong to
 * one open file at a time.
 */
#include <linux/fs.h>
#include <linux/miscdevice.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/signal.h>
#include <linux/slab.h>

#include "axidma.h"
#include "cm_compat.h"

static int axidma_open(struct inode *inode, struct file *file)
{
	struct axidma_file *self = kzalloc(sizeof(*self), GFP_KERNEL);
	int ret;

	if (!self)
		return -ENOMEM;
	mutex_init(&self->lock);
	INIT_LIST_HEAD(&self->regions);
	ret = axidma_channels_claim(self);
	if (ret) {
		kfree(self);
		return ret;
	}
	file->private_data = self;
	return 0;
}

static int axidma_release(struct inode *inode, struct file *file)
{
	struct axidma_file *self = file->private_data;

	axidma_channels_release(self);
	axidma_regions_destroy(self);
	mutex_destroy(&self->lock);
	kfree(self);
	return 0;
}

static int axidma_mmap(struct file *file, struct vm_area_struct *vma)
{
	return axidma_region_mmap(file->private_data, vma);
}

static long set_signal(struct axidma_file *self, unsigned long signal)
{
	/* SIGRTMIN of the C library lies above the kernel's */
	if (signal < SIGRTMIN || signal > SIGRTMAX)
		return -EINVAL;
	WRITE_ONCE(self->signal, signal);
	return 0;
}

static long axidma_ioctl(struct file *file, unsigned int command, unsigned long value)
{
	struct axidma_file *self = file->private_data;
	void __user *arg = (void __user *)value;

	switch (command) {
	case AXIDMA_ABI_GET_COUNTS:
		return axidma_get_counts(self, arg);
	case AXIDMA_ABI_GET_CHANNELS:
		return axidma_get_channels(self, arg);
	case AXIDMA_ABI_SET_SIGNAL:
		return set_signal(self, value);
	case AXIDMA_ABI_REGISTER:
		return axidma_region_register(self, arg);
	case AXIDMA_ABI_DMA_READ:
		return axidma_one_way(self, CM_DMA_S2MM, arg);
	case AXIDMA_ABI_DMA_WRITE:
		return axidma_one_way(self, CM_DMA_MM2S, arg);
	case AXIDMA_ABI_DMA_TWO_WAY:
		return axidma_two_way(self, arg);
	case AXIDMA_ABI_VIDEO_READ:
		return axidma_video_start(self, CM_DMA_S2MM, arg);
	case AXIDMA_ABI_VIDEO_WRITE:
		return axidma_video_start(self, CM_DMA_MM2S, arg);
	case AXIDMA_ABI_STOP:
		return axidma_stop(self, arg);
	case AXIDMA_ABI_UNREGISTER:
		return axidma_region_unregister(self, value);
	default:
		return -ENOTTY;
	}
}

static const struct file_operations axidma_fops = {
	.owner = THIS_MODULE,
	.open = axidma_open,
	.release = axidma_release,
	.mmap = axidma_mmap,
	.unlocked_ioctl = axidma_ioctl,
};

static struct miscdevice axidma_misc = {
	.minor = MISC_DYNAMIC_MINOR,
	.name = "axidma",
	.fops = &axidma_fops,
};

static int __init axidma_init(void)
{
	int ret = platform_driver_register(&axidma_driver);

	if (ret)
		return ret;
	ret = misc_register(&axidma_misc);
	if (ret)
		platform_driver_unregister(&axidma_driver);
	return ret;
}
module_init(axidma_init);

static void __exit axidma_exit(void)
{
	misc_deregister(&axidma_misc);
	platform_driver_unregister(&axidma_driver);
}
module_exit(axidma_exit);

MODULE_DESCRIPTION("/dev/axidma for programs built against libaxidma");
MODULE_VERSION(CM_VERSION);
MODULE_LICENSE("GPL");
CM_IMPORT_CORE;
