/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A configuration port fed by DMA (kmod/uapi/cm_icap.h).
 *
 * Errors, threads and simulated nodes: see node.h.
 */
#ifndef CM_SHIM_ICAP_H
#define CM_SHIM_ICAP_H

#include <stdint.h>

#include "buffer.h"
#include "cm_icap.h"

struct cm_icap;

/* Open dev/@name, e.g. "cm_icap0".  EINVAL for a name with a slash; see cm_node_open(). */
struct cm_icap *cm_icap_open(const char *root, const char *name);

/* Close and free; waits for the end of a load of this file.  @icap may be NULL. */
void cm_icap_close(struct cm_icap *icap);

/* Close the device, free nothing; see cm_node_release(). */
void cm_icap_release(struct cm_icap *icap);

/* See cm_node_event_fd(). */
int cm_icap_event_fd(struct cm_icap *icap);

int cm_icap_get_info(struct cm_icap *icap, struct cm_icap_info *info);
int cm_icap_get_status(struct cm_icap *icap, struct cm_icap_status *status);

/* As cm_dma_alloc(), cm_dma_import() and cm_dma_free(). */
int cm_icap_alloc(struct cm_icap *icap, uint64_t length, struct cm_buffer *buffer);
int cm_icap_import(struct cm_icap *icap, int fd, struct cm_buffer *buffer);
int cm_icap_free(struct cm_icap *icap, uint32_t handle);

/**
 * cm_icap_load() - start a load; its end is an event
 * @flags: CM_ICAP_LOAD_*
 *
 * One system call on a real port, nothing is allocated or copied.  Errors: EBUSY
 * while any file loads, ENOENT for an unknown handle, EINVAL for a range that is
 * not in the buffer or not whole words, EMSGSIZE above max_length.
 */
int cm_icap_load(struct cm_icap *icap, uint32_t handle, uint64_t offset, uint64_t length,
		 uint64_t cookie, uint32_t flags);

/* Where the parts of a read lie in its buffer, in bytes: see struct cm_icap_read. */
struct cm_icap_parts {
	uint64_t request_offset;
	uint64_t request_length;
	uint64_t reply_offset;
	uint64_t reply_length;
	uint64_t closing_offset;
	uint64_t closing_length;
};

/**
 * cm_icap_read_back() - start a read; its end is an event, as that of a load
 *
 * Errors: as cm_icap_load(); EINVAL for parts that overlap, EOPNOTSUPP where the
 * port has no way back (CM_ICAP_CAP_READ).
 */
int cm_icap_read_back(struct cm_icap *icap, uint32_t handle, const struct cm_icap_parts *parts,
		      uint64_t cookie);

/* Take the end of a load or read if it came: 1, or 0.  See cm_node_take(). */
int cm_icap_take(struct cm_icap *icap, struct cm_icap_completion *completion);

/* The same, but wait for it; as cm_dma_wait(). */
int cm_icap_wait(struct cm_icap *icap, int64_t timeout_ns, struct cm_icap_completion *completion);

#endif /* CM_SHIM_ICAP_H */
