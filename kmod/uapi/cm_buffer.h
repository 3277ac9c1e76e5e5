/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * DMA buffers of the configuration manager's devices.
 *
 * cm_dma and cm_icap hand out buffers by handle.  A buffer lives until it is
 * freed or its file is closed, and no transfer uses it any more, whichever
 * comes last; a mapping of it, or a dma-buf file descriptor, keeps the memory.
 *
 * Every structure begins with its own size as the caller knows it.  A kernel
 * that knows a shorter structure accepts a longer one if all bytes beyond its
 * own are zero (-E2BIG otherwise); one that knows a longer structure takes the
 * missing bytes as zero, and fills in what the caller has room for.  A size
 * below that of the structure's first form (*_SIZE_VER0) is -EINVAL, as
 * unknown flags and reserved fields other than zero are.
 */
#ifndef _UAPI_CM_BUFFER_H
#define _UAPI_CM_BUFFER_H

#include <linux/ioctl.h>
#include <linux/types.h>

/* of all calls of these modules: cm_dma from 0x00 on, cm_icap from 0x20, cm_window from 0x40 */
#define CM_IOC_MAGIC 0xC5

#define CM_BUFFER_ALLOC_SIZE_VER0 32
#define CM_BUFFER_ALLOC_SIZE_VER1 40 /* address */
#define CM_BUFFER_IMPORT_SIZE_VER0 24
#define CM_BUFFER_FREE_SIZE_VER0 16

/**
 * struct cm_buffer_alloc - allocate a buffer the device can reach
 * @size: in: size of this structure in bytes
 * @flags: in: must be 0
 * @length: in: bytes wanted, > 0; out: bytes allocated (whole pages)
 * @handle: out: the handle, > 0, valid on this file only
 * @fd: out: dma-buf file descriptor (O_CLOEXEC), mappable; the caller closes it
 * @coherent: out: 1 where CPU access needs no DMA_BUF_IOCTL_SYNC
 * @reserved: must be 0
 * @address: out: where it begins for the device, in one piece: what other masters of
 *           the bus reach it by too, unless an IOMMU lies between; 0: not told
 */
struct cm_buffer_alloc {
	__u32 size;
	__u32 flags;
	__u64 length;
	__u32 handle;
	__s32 fd;
	__u32 coherent;
	__u32 reserved;
	__u64 address;
};

/**
 * struct cm_buffer_import - attach somebody else's dma-buf
 * @size: in: size of this structure in bytes
 * @flags: in: must be 0
 * @fd: in: dma-buf file descriptor; the device takes its own reference
 * @handle: out: the handle, > 0, valid on this file only
 * @length: out: bytes in the buffer
 */
struct cm_buffer_import {
	__u32 size;
	__u32 flags;
	__s32 fd;
	__u32 handle;
	__u64 length;
};

/**
 * struct cm_buffer_free - give a handle back
 * @size: in: size of this structure in bytes
 * @flags: in: must be 0
 * @handle: in: from alloc or import; -ENOENT if unknown, -EBUSY in flight
 * @reserved: must be 0
 */
struct cm_buffer_free {
	__u32 size;
	__u32 flags;
	__u32 handle;
	__u32 reserved;
};

#endif /* _UAPI_CM_BUFFER_H */
