/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * /dev/cm_dma/<name>: one DMA channel, claimed by one open file at a time
 * (a second open fails with -EBUSY).
 *
 * Transfers are submitted by buffer handle and complete in order.  Completed
 * ones are taken with read(), which returns as many whole
 * struct cm_dma_completion as fit and are there; it blocks unless O_NONBLOCK
 * is set (-EAGAIN then).  poll() reports POLLIN when a completion waits.
 */
#ifndef _UAPI_CM_DMA_H
#define _UAPI_CM_DMA_H

#include "cm_buffer.h"

#define CM_DMA_INFO_SIZE_VER0 72
#define CM_DMA_SUBMIT_SIZE_VER0 48
#define CM_DMA_SUBMIT_VIDEO_SIZE_VER0 40
#define CM_DMA_CANCEL_SIZE_VER0 8

#define CM_DMA_NAME_MAX 32

/* direction of a channel, seen from memory as the AXI DMA's data sheet does */
#define CM_DMA_MM2S 1 /* memory to stream: the processor writes */
#define CM_DMA_S2MM 2 /* stream to memory: the processor reads */

/* kind of engine */
#define CM_DMA_TYPE_AXIDMA 1
#define CM_DMA_TYPE_VDMA 2

/* what the channel's driver can do */
#define CM_DMA_CAP_CYCLIC (1u << 0)
#define CM_DMA_CAP_VIDEO (1u << 1)   /* interleaved frames */
#define CM_DMA_CAP_RESIDUE (1u << 2) /* short packets report their length */
#define CM_DMA_CAP_SIMPLE (1u << 3)  /* no scatter/gather: one transfer runs at a time */

/**
 * struct cm_dma_info - what this channel is
 * @size: in: size of this structure in bytes
 * @flags: in: must be 0
 * @direction: CM_DMA_MM2S or CM_DMA_S2MM
 * @type: CM_DMA_TYPE_*
 * @caps: CM_DMA_CAP_* bits
 * @queue_depth: most transfers submitted and not yet read back
 * @max_length: most bytes of one transfer
 * @alignment: offsets and lengths must be multiples of this many bytes
 * @frame_length: usual bytes of one packet if the hardware fixes it, or 0
 * @name: NUL-terminated channel name
 */
struct cm_dma_info {
	__u32 size;
	__u32 flags;
	__u32 direction;
	__u32 type;
	__u32 caps;
	__u32 queue_depth;
	__u64 max_length;
	__u32 alignment;
	__u32 frame_length;
	__u8 name[CM_DMA_NAME_MAX];
};

#define CM_DMA_SUBMIT_CYCLIC (1u << 0) /* repeat until cancelled */

/**
 * struct cm_dma_submit - queue one transfer (one request is one descriptor)
 * @size: in: size of this structure in bytes
 * @flags: in: CM_DMA_SUBMIT_* bits
 * @handle: in: buffer
 * @reserved: must be 0
 * @offset: in: first byte in the buffer
 * @length: in: bytes; with S2MM the most that may arrive
 * @period: in: cyclic only: bytes per completion, divides @length; else 0
 * @cookie: in: returned in the completion, free for the caller's use
 *
 * -EBUSY when queue_depth transfers are under way, -ENOENT for an unknown
 * handle, -EINVAL for a range outside the buffer, -EMSGSIZE above max_length.
 */
struct cm_dma_submit {
	__u32 size;
	__u32 flags;
	__u32 handle;
	__u32 reserved;
	__u64 offset;
	__u64 length;
	__u64 period;
	__u64 cookie;
};

/**
 * struct cm_dma_submit_video - queue one video frame (interleaved transfer)
 * @size: in: size of this structure in bytes
 * @flags: in: CM_DMA_SUBMIT_* bits
 * @handle: in: buffer
 * @lines: in: lines in the frame
 * @offset: in: first byte in the buffer
 * @line_bytes: in: bytes moved per line
 * @stride: in: bytes from the start of a line to the start of the next
 * @cookie: in: returned in the completion
 *
 * -EMSGSIZE above max_length a line, or above what the engine's registers hold:
 * with CM_DMA_TYPE_VDMA lines of 13 and a stride of 16 bits.
 */
struct cm_dma_submit_video {
	__u32 size;
	__u32 flags;
	__u32 handle;
	__u32 lines;
	__u64 offset;
	__u32 line_bytes;
	__u32 stride;
	__u64 cookie;
};

/**
 * struct cm_dma_cancel - end all transfers of the channel
 * @size: in: size of this structure in bytes
 * @flags: in: must be 0
 *
 * When the call returns the hardware has stopped; every transfer that was
 * under way has a completion with status -ECANCELED.
 */
struct cm_dma_cancel {
	__u32 size;
	__u32 flags;
};

#define CM_DMA_COMPLETION_OVERRUN (1u << 0) /* cyclic periods were lost before this one */

/**
 * struct cm_dma_completion - one finished transfer, as read() returns it
 * @cookie: as submitted
 * @length: bytes moved; with S2MM the bytes that arrived, may be fewer; what
 *          was asked for where the channel lacks CM_DMA_CAP_RESIDUE
 * @timestamp_ns: CLOCK_MONOTONIC at the completion
 * @sequence: number of the completion on this file, from 0; lost ones of a
 *            cyclic transfer have numbers too, so a gap is how many were lost
 * @status: 0, or a negative errno (-EIO DMA error, -ECANCELED)
 * @flags: CM_DMA_COMPLETION_* bits
 */
struct cm_dma_completion {
	__u64 cookie;
	__u64 length;
	__u64 timestamp_ns;
	__u64 sequence;
	__s32 status;
	__u32 flags;
};

#define CM_DMA_IOC_INFO _IOWR(CM_IOC_MAGIC, 0x00, struct cm_dma_info)
#define CM_DMA_IOC_ALLOC _IOWR(CM_IOC_MAGIC, 0x01, struct cm_buffer_alloc)
#define CM_DMA_IOC_IMPORT _IOWR(CM_IOC_MAGIC, 0x02, struct cm_buffer_import)
#define CM_DMA_IOC_FREE _IOW(CM_IOC_MAGIC, 0x03, struct cm_buffer_free)
#define CM_DMA_IOC_SUBMIT _IOW(CM_IOC_MAGIC, 0x04, struct cm_dma_submit)
#define CM_DMA_IOC_SUBMIT_VIDEO _IOW(CM_IOC_MAGIC, 0x05, struct cm_dma_submit_video)
#define CM_DMA_IOC_CANCEL _IOW(CM_IOC_MAGIC, 0x06, struct cm_dma_cancel)

#endif /* _UAPI_CM_DMA_H */
