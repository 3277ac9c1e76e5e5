/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * Everything that differs between the kernels this source is built against
 * (5.15 and later).  No other file asks for the kernel's version.
 */
#ifndef _CM_COMPAT_H
#define _CM_COMPAT_H

#include <linux/dma-buf.h>
#include <linux/dma-mapping.h>
#include <linux/dmaengine.h>
#include <linux/hrtimer.h>
#include <linux/mm.h>
#include <linux/module.h>
#include <linux/version.h>

/* cm/_version.py; all modules of one state of this tree have one */
#define CM_VERSION "0.2.0"

/* 6.13: symbol namespaces are strings */
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 13, 0)
#define EXPORT_SYMBOL_CM(symbol) EXPORT_SYMBOL_NS_GPL(symbol, "CM_CORE")
#define CM_IMPORT_CORE MODULE_IMPORT_NS("CM_CORE")
#define CM_IMPORT_DMA_BUF MODULE_IMPORT_NS("DMA_BUF")
#else
#define EXPORT_SYMBOL_CM(symbol) EXPORT_SYMBOL_NS_GPL(symbol, CM_CORE)
#define CM_IMPORT_CORE MODULE_IMPORT_NS(CM_CORE)
#define CM_IMPORT_DMA_BUF MODULE_IMPORT_NS(DMA_BUF)
#endif

/* 6.2: the plain variants expect the caller to hold the reservation lock */
static inline struct sg_table *cm_map_attachment(struct dma_buf_attachment *attachment,
						 enum dma_data_direction dir)
{
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 2, 0)
	return dma_buf_map_attachment_unlocked(attachment, dir);
#else
	return dma_buf_map_attachment(attachment, dir);
#endif
}

static inline void cm_unmap_attachment(struct dma_buf_attachment *attachment,
				       struct sg_table *table, enum dma_data_direction dir)
{
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 2, 0)
	dma_buf_unmap_attachment_unlocked(attachment, table, dir);
#else
	dma_buf_unmap_attachment(attachment, table, dir);
#endif
}

/*
 * The memory of a simulated engine needs no cache maintenance.  The flag is a
 * member that only some architectures have; kernels with accessor functions
 * for a device's flags (seen in 7.2, not in 6.12) have no member.
 */
static inline void cm_set_coherent(struct device *dev)
{
#if defined(CONFIG_ARCH_HAS_SYNC_DMA_FOR_DEVICE) || defined(CONFIG_ARCH_HAS_SYNC_DMA_FOR_CPU) || \
	defined(CONFIG_ARCH_HAS_SYNC_DMA_FOR_CPU_ALL)
#if LINUX_VERSION_CODE >= KERNEL_VERSION(7, 1, 0)
	dev_set_dma_coherent(dev);
#else
	dev->dma_coherent = true;
#endif
#endif
}

/* UIO drivers prepare a mapping (seen in 7.2, not in 6.12) instead of making it */
#define CM_UIO_MMAP_PREPARE (LINUX_VERSION_CODE >= KERNEL_VERSION(7, 1, 0))

/* 6.3: vm_flags may only be changed through functions */
static inline void cm_vm_flags_set(struct vm_area_struct *vma, unsigned long flags)
{
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 3, 0)
	vm_flags_set(vma, flags);
#else
	vma->vm_flags |= flags;
#endif
}

static inline void cm_vm_flags_clear(struct vm_area_struct *vma, unsigned long flags)
{
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 3, 0)
	vm_flags_clear(vma, flags);
#else
	vma->vm_flags &= ~flags;
#endif
}

/* 6.13: a timer's function is given when it is initialised */
static inline void cm_hrtimer_setup(struct hrtimer *timer,
				    enum hrtimer_restart (*function)(struct hrtimer *),
				    clockid_t clock, enum hrtimer_mode mode)
{
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 13, 0)
	hrtimer_setup(timer, function, clock, mode);
#else
	hrtimer_init(timer, clock, mode);
	timer->function = function;
#endif
}

#endif /* _CM_COMPAT_H */
