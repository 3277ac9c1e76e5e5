// SPDX-License-Identifier: Apache-2.0
#include "icap.h"

#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "node.h"

struct cm_icap {
	struct cm_node *node;
};

static struct cm_node *open_port(const char *root, const char *name)
{
	char path[sizeof("dev/") + NAME_MAX];
	int length = snprintf(path, sizeof(path), "dev/%s", name);

	if (!*name || strchr(name, '/') || (size_t)length >= sizeof(path)) {
		errno = EINVAL;
		return NULL;
	}
	return cm_node_open(root, path);
}

struct cm_icap *cm_icap_open(const char *root, const char *name)
{
	struct cm_icap *icap = calloc(1, sizeof(*icap));

	if (!icap)
		return NULL;
	icap->node = open_port(root, name);
	if (!icap->node) {
		cm_icap_close(icap);
		return NULL;
	}
	return icap;
}

void cm_icap_close(struct cm_icap *icap)
{
	int error = errno;

	if (!icap)
		return;
	cm_node_close(icap->node);
	free(icap);
	errno = error;
}

int cm_icap_event_fd(struct cm_icap *icap)
{
	return cm_node_event_fd(icap->node);
}

void cm_icap_release(struct cm_icap *icap)
{
	cm_node_release(icap->node);
}

int cm_icap_get_info(struct cm_icap *icap, struct cm_icap_info *info)
{
	memset(info, 0, sizeof(*info));
	info->size = sizeof(*info);
	return cm_node_request(icap->node, CM_ICAP_IOC_INFO, info, sizeof(*info), NULL,
			       CM_NODE_FD_NONE);
}

int cm_icap_get_status(struct cm_icap *icap, struct cm_icap_status *status)
{
	memset(status, 0, sizeof(*status));
	status->size = sizeof(*status);
	return cm_node_request(icap->node, CM_ICAP_IOC_STATUS, status, sizeof(*status), NULL,
			       CM_NODE_FD_NONE);
}

int cm_icap_alloc(struct cm_icap *icap, uint64_t length, struct cm_buffer *buffer)
{
	return cm_buffer_alloc(icap->node, CM_ICAP_IOC_ALLOC, length, buffer);
}

int cm_icap_import(struct cm_icap *icap, int fd, struct cm_buffer *buffer)
{
	return cm_buffer_import(icap->node, CM_ICAP_IOC_IMPORT, fd, buffer);
}

int cm_icap_free(struct cm_icap *icap, uint32_t handle)
{
	return cm_buffer_free(icap->node, CM_ICAP_IOC_FREE, handle);
}

int cm_icap_load(struct cm_icap *icap, uint32_t handle, uint64_t offset, uint64_t length,
		 uint64_t cookie, uint32_t flags)
{
	struct cm_icap_load arg = {
		.size = sizeof(arg),
		.flags = flags,
		.handle = handle,
		.offset = offset,
		.length = length,
		.cookie = cookie,
	};

	return cm_node_request(icap->node, CM_ICAP_IOC_LOAD, &arg, sizeof(arg), NULL,
			       CM_NODE_FD_NONE);
}

int cm_icap_read_back(struct cm_icap *icap, uint32_t handle, const struct cm_icap_parts *parts,
		      uint64_t cookie)
{
	struct cm_icap_read arg = {
		.size = sizeof(arg),
		.handle = handle,
		.request_offset = parts->request_offset,
		.request_length = parts->request_length,
		.reply_offset = parts->reply_offset,
		.reply_length = parts->reply_length,
		.closing_offset = parts->closing_offset,
		.closing_length = parts->closing_length,
		.cookie = cookie,
	};

	return cm_node_request(icap->node, CM_ICAP_IOC_READ, &arg, sizeof(arg), NULL,
			       CM_NODE_FD_NONE);
}

int cm_icap_take(struct cm_icap *icap, struct cm_icap_completion *completion)
{
	return (int)cm_node_take(icap->node, completion, sizeof(*completion), 1);
}

int cm_icap_wait(struct cm_icap *icap, int64_t timeout_ns, struct cm_icap_completion *completion)
{
	return cm_node_wait(icap->node, timeout_ns, completion, sizeof(*completion));
}
