// SPDX-License-Identifier: Apache-2.0
#include "buffer.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/dma-buf.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include "cm_buffer.h"

int cm_buffer_alloc(struct cm_node *node, uint32_t op, uint64_t length, struct cm_buffer *buffer)
{
	struct cm_buffer_alloc arg = { .size = sizeof(arg), .length = length, .fd = -1 };

	if (cm_node_request(node, op, &arg, sizeof(arg), &arg.fd, CM_NODE_FD_RECEIVE))
		return -1;
	buffer->fd = arg.fd;
	buffer->handle = arg.handle;
	buffer->coherent = arg.coherent != 0;
	buffer->length = arg.length;
	buffer->address = arg.address;
	return 0;
}

int cm_buffer_import(struct cm_node *node, uint32_t op, int fd, struct cm_buffer *buffer)
{
	struct cm_buffer_import arg = { .size = sizeof(arg), .fd = fd };
	int own = fcntl(fd, F_DUPFD_CLOEXEC, 3);

	if (own < 0)
		return -1;
	if (cm_node_request(node, op, &arg, sizeof(arg), &arg.fd, CM_NODE_FD_SEND)) {
		int error = errno;

		close(own);
		errno = error;
		return -1;
	}
	buffer->fd = own;
	buffer->handle = arg.handle;
	buffer->coherent = false; /* only the exporter knows; a needless sync is harmless */
	buffer->length = arg.length;
	buffer->address = 0;
	return 0;
}

int cm_buffer_free(struct cm_node *node, uint32_t op, uint32_t handle)
{
	struct cm_buffer_free arg = { .size = sizeof(arg), .handle = handle };

	return cm_node_request(node, op, &arg, sizeof(arg), NULL, CM_NODE_FD_NONE);
}

void *cm_buffer_map(const struct cm_buffer *buffer, bool writable)
{
	int protection = writable ? PROT_READ | PROT_WRITE : PROT_READ;
	off_t there = lseek(buffer->fd, 0, SEEK_END);
	void *memory;

	if (there < 0)
		return NULL;
	if ((uint64_t)there < buffer->length) {
		errno = EPROTO;
		return NULL;
	}
	memory = mmap(NULL, (size_t)buffer->length, protection, MAP_SHARED, buffer->fd, 0);
	return memory == MAP_FAILED ? NULL : memory;
}

int cm_buffer_unmap(void *memory, uint64_t length)
{
	return munmap(memory, (size_t)length);
}

int cm_buffer_sync(const struct cm_buffer *buffer, bool begin, bool write)
{
	struct dma_buf_sync sync = {
		.flags = (begin ? DMA_BUF_SYNC_START : DMA_BUF_SYNC_END) |
			 (write ? DMA_BUF_SYNC_RW : DMA_BUF_SYNC_READ),
	};
	int result;

	if (buffer->coherent)
		return 0;
	do {
		result = ioctl(buffer->fd, DMA_BUF_IOCTL_SYNC, &sync);
	} while (result && (errno == EINTR || errno == EAGAIN));
	/* A memfd does not support the call: it is ordinary memory. */
	return result && errno == ENOTTY ? 0 : result;
}

void cm_buffer_close(struct cm_buffer *buffer)
{
	int error = errno;

	if (buffer->fd >= 0)
		close(buffer->fd);
	buffer->fd = -1;
	errno = error;
}
