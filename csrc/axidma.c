// SPDX-License-Identifier: Apache-2.0
#include "axidma.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "node.h"

struct cm_dma {
	struct cm_node *node;
};

#define PATH_SIZE (sizeof("dev/cm_dma/") + CM_DMA_NAME_MAX)

static int channel_path(char *path, const char *name)
{
	int length = snprintf(path, PATH_SIZE, "dev/cm_dma/%s", name);

	if (*name && !strchr(name, '/') && (size_t)length < PATH_SIZE)
		return 0;
	errno = EINVAL;
	return -1;
}

static struct cm_node *open_channel(const char *root, const char *name)
{
	char path[PATH_SIZE];

	return channel_path(path, name) ? NULL : cm_node_open(root, path);
}

struct cm_dma *cm_dma_open(const char *root, const char *name)
{
	struct cm_dma *dma = calloc(1, sizeof(*dma));

	if (!dma)
		return NULL;
	dma->node = open_channel(root, name);
	if (!dma->node) {
		cm_dma_close(dma);
		return NULL;
	}
	return dma;
}

void cm_dma_close(struct cm_dma *dma)
{
	int error = errno;

	if (!dma)
		return;
	cm_node_close(dma->node);
	free(dma);
	errno = error;
}

int cm_dma_event_fd(struct cm_dma *dma)
{
	return cm_node_event_fd(dma->node);
}

void cm_dma_release(struct cm_dma *dma)
{
	cm_node_release(dma->node);
}

int cm_dma_get_info(struct cm_dma *dma, struct cm_dma_info *info)
{
	memset(info, 0, sizeof(*info));
	info->size = sizeof(*info);
	if (cm_node_request(dma->node, CM_DMA_IOC_INFO, info, sizeof(*info), NULL, CM_NODE_FD_NONE))
		return -1;
	info->name[sizeof(info->name) - 1] = '\0';
	return 0;
}

int cm_dma_alloc(struct cm_dma *dma, uint64_t length, struct cm_buffer *buffer)
{
	return cm_buffer_alloc(dma->node, CM_DMA_IOC_ALLOC, length, buffer);
}

int cm_dma_import(struct cm_dma *dma, int fd, struct cm_buffer *buffer)
{
	return cm_buffer_import(dma->node, CM_DMA_IOC_IMPORT, fd, buffer);
}

int cm_dma_free(struct cm_dma *dma, uint32_t handle)
{
	return cm_buffer_free(dma->node, CM_DMA_IOC_FREE, handle);
}

int cm_dma_submit(struct cm_dma *dma, uint32_t handle, uint64_t offset, uint64_t length,
		  uint64_t cookie, uint32_t flags, uint64_t period)
{
	struct cm_dma_submit arg = {
		.size = sizeof(arg),
		.flags = flags,
		.handle = handle,
		.offset = offset,
		.length = length,
		.period = period,
		.cookie = cookie,
	};

	return cm_node_request(dma->node, CM_DMA_IOC_SUBMIT, &arg, sizeof(arg), NULL,
			       CM_NODE_FD_NONE);
}

int cm_dma_submit_video(struct cm_dma *dma, uint32_t handle, uint64_t offset, uint32_t lines,
			uint32_t line_bytes, uint32_t stride, uint64_t cookie, uint32_t flags)
{
	struct cm_dma_submit_video arg = {
		.size = sizeof(arg),
		.flags = flags,
		.handle = handle,
		.lines = lines,
		.offset = offset,
		.line_bytes = line_bytes,
		.stride = stride,
		.cookie = cookie,
	};

	return cm_node_request(dma->node, CM_DMA_IOC_SUBMIT_VIDEO, &arg, sizeof(arg), NULL,
			       CM_NODE_FD_NONE);
}

int cm_dma_cancel(struct cm_dma *dma)
{
	struct cm_dma_cancel arg = { .size = sizeof(arg) };

	return cm_node_request(dma->node, CM_DMA_IOC_CANCEL, &arg, sizeof(arg), NULL,
			       CM_NODE_FD_NONE);
}

ssize_t cm_dma_take(struct cm_dma *dma, struct cm_dma_completion *completions, size_t count)
{
	return cm_node_take(dma->node, completions, sizeof(*completions), count);
}

int cm_dma_wait(struct cm_dma *dma, int64_t timeout_ns, struct cm_dma_completion *completion)
{
	return cm_node_wait(dma->node, timeout_ns, completion, sizeof(*completion));
}
