/* SPDX-License-Identifier: Apache-2.0 */
/*
 * One channel of an AXI DMA or VDMA (kmod/uapi/cm_dma.h).
 *
 * Errors, threads and simulated nodes: see node.h.
 */
#ifndef CM_SHIM_AXIDMA_H
#define CM_SHIM_AXIDMA_H

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "buffer.h"
#include "cm_dma.h"

struct cm_dma;

/**
 * cm_dma_open() - claim the channel dev/cm_dma/@name
 *
 * Errors: EBUSY while another file holds it, EINVAL for a name with a slash,
 * those of cm_node_open().  The caller owns the result and closes it.
 */
struct cm_dma *cm_dma_open(const char *root, const char *name);

/* Stop all transfers, release handles, close and free; @dma may be NULL. */
void cm_dma_close(struct cm_dma *dma);

/* Close the device, free nothing; see cm_node_release(). */
void cm_dma_release(struct cm_dma *dma);

/* See cm_node_event_fd(). */
int cm_dma_event_fd(struct cm_dma *dma);

int cm_dma_get_info(struct cm_dma *dma, struct cm_dma_info *info);

/**
 * cm_dma_alloc() / cm_dma_import() - a buffer that the channel can reach
 * @buffer: filled in; the caller owns its fd (see cm_buffer_close()) and gives the
 *          handle back with cm_dma_free(), in any order
 *
 * alloc: ENOMEM.  import: EBADF, EINVAL if @fd is no such memory; @fd stays the
 * caller's, @buffer gets a duplicate.
 */
int cm_dma_alloc(struct cm_dma *dma, uint64_t length, struct cm_buffer *buffer);
int cm_dma_import(struct cm_dma *dma, int fd, struct cm_buffer *buffer);

/* Give a handle back.  EBUSY while a transfer uses it, ENOENT if unknown. */
int cm_dma_free(struct cm_dma *dma, uint32_t handle);

/**
 * cm_dma_submit() - queue a transfer, does not wait for it
 * @flags: CM_DMA_SUBMIT_*
 * @period: bytes per completion if cyclic, else 0
 *
 * Errors: see struct cm_dma_submit.
 */
int cm_dma_submit(struct cm_dma *dma, uint32_t handle, uint64_t offset, uint64_t length,
		  uint64_t cookie, uint32_t flags, uint64_t period);

/* The same for a frame of @lines lines; see struct cm_dma_submit_video. */
int cm_dma_submit_video(struct cm_dma *dma, uint32_t handle, uint64_t offset, uint32_t lines,
			uint32_t line_bytes, uint32_t stride, uint64_t cookie, uint32_t flags);

/* End all transfers; returns when the hardware has stopped. */
int cm_dma_cancel(struct cm_dma *dma);

/* Take up to @count waiting completions; returns how many, 0 if none.  See cm_node_take(). */
ssize_t cm_dma_take(struct cm_dma *dma, struct cm_dma_completion *completions, size_t count);

/**
 * cm_dma_wait() - wait for the next completion and take it
 * @timeout_ns: see cm_node_wait()
 *
 * Returns 1.  Errors: ETIMEDOUT, those of cm_node_wait() and cm_node_take().  A
 * transfer that failed is not an error of this call: see the completion's status.
 */
int cm_dma_wait(struct cm_dma *dma, int64_t timeout_ns, struct cm_dma_completion *completion);

#endif /* CM_SHIM_AXIDMA_H */
