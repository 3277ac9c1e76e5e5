/* SPDX-License-Identifier: Apache-2.0 */
/*
 * DMA buffers: memory with a file descriptor (dma-buf, or memfd on a simulated
 * board) and a handle by which its device knows it.
 */
#ifndef CM_SHIM_BUFFER_H
#define CM_SHIM_BUFFER_H

#include <stdbool.h>
#include <stdint.h>

#include "node.h"

/**
 * struct cm_buffer - a buffer of one device
 * @fd: owned by the holder of the structure, closed by cm_buffer_close()
 * @handle: valid on the device it came from only
 * @coherent: CPU access needs no cm_buffer_sync()
 * @length: bytes
 * @address: where the device sees it; 0 where that is not told
 */
struct cm_buffer {
	int fd;
	uint32_t handle;
	bool coherent;
	uint64_t length;
	uint64_t address;
};

/* As the devices do it: @op is theirs.  See cm_dma_alloc() and its fellows. */
int cm_buffer_alloc(struct cm_node *node, uint32_t op, uint64_t length, struct cm_buffer *buffer);
int cm_buffer_import(struct cm_node *node, uint32_t op, int fd, struct cm_buffer *buffer);
int cm_buffer_free(struct cm_node *node, uint32_t op, uint32_t handle);

/**
 * cm_buffer_map() - map the whole buffer, shared
 *
 * NULL with errno; EPROTO if the memory behind the descriptor is shorter than
 * @buffer says (touching it would be SIGBUS).  The mapping keeps the memory after
 * cm_buffer_close(); cm_buffer_unmap() ends it.
 */
void *cm_buffer_map(const struct cm_buffer *buffer, bool writable);
int cm_buffer_unmap(void *memory, uint64_t length);

/**
 * cm_buffer_sync() - begin or end of CPU access (DMA_BUF_IOCTL_SYNC)
 * @write: the CPU writes; otherwise it reads only
 *
 * Does nothing on coherent memory and on a memfd.  May block while the device
 * uses the buffer.
 */
int cm_buffer_sync(const struct cm_buffer *buffer, bool begin, bool write);

/* Close the descriptor, if not closed yet. */
void cm_buffer_close(struct cm_buffer *buffer);

#endif /* CM_SHIM_BUFFER_H */
