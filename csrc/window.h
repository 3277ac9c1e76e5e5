/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Register pages on loan (kmod/uapi/cm_window.h): who lends them, and who has them.
 *
 * Errors, threads and simulated nodes: see node.h.  Nothing here locks on the
 * way to a register: cm_grant_read() is a load, and another of the flag.
 */
#ifndef CM_SHIM_WINDOW_H
#define CM_SHIM_WINDOW_H

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "cm_window.h"

struct cm_windows;
struct cm_grant;

/**
 * cm_windows_open() - open /dev/cm_window
 *
 * The caller owns the result and closes it; its grants end with it.  Errors:
 * those of cm_node_open(); ENOENT where the kernel module is not loaded.
 */
struct cm_windows *cm_windows_open(const char *root);

/* Close and free; @windows may be NULL. */
void cm_windows_close(struct cm_windows *windows);

/* See cm_node_event_fd(): polls readable when an event waits. */
int cm_windows_event_fd(struct cm_windows *windows);

/* Close the node, free nothing; see cm_node_release(). */
void cm_windows_release(struct cm_windows *windows);

/**
 * cm_windows_grant() - lend @length bytes at physical @address
 * @flags: CM_WINDOW_WRITE or 0
 * @id: set to the grant's number
 *
 * Returns a descriptor, the caller's to give away and to close.  On a simulated
 * board it is a connection, which can be mapped once.
 *
 * Errors: see struct cm_window_grant.
 */
int cm_windows_grant(struct cm_windows *windows, uint64_t address, uint64_t length, uint32_t flags,
		     uint32_t *id);

/**
 * cm_windows_revoke() - take back every grant that touches a range
 *
 * Returns how many were taken.  No process reaches the range by one of them any more.
 */
int cm_windows_revoke(struct cm_windows *windows, uint64_t address, uint64_t length);

/* Take one grant of this node's back.  Returns 1, or 0 where it had been; ENOENT where it is released. */
int cm_windows_revoke_one(struct cm_windows *windows, uint32_t id);

/* Take events that are there, never blocks.  Returns how many were taken. */
ssize_t cm_windows_take(struct cm_windows *windows, struct cm_window_event *events, size_t count);

/**
 * cm_grant_map() - map what a descriptor of a grant stands for
 * @fd: stays the caller's
 *
 * The caller owns the result and unmaps it.  Errors: EINVAL or ENODEV for a
 * descriptor of something else; those of mmap().
 */
struct cm_grant *cm_grant_map(int fd);

/* Unmap and free; @grant may be NULL.  Nobody may be in a call. */
void cm_grant_unmap(struct cm_grant *grant);

/* Give the pages back, free nothing: later calls, and those of other threads, end with EBADF.  Twice is fine. */
void cm_grant_release(struct cm_grant *grant);

/* Bytes of the registers, and whether they may be written. */
uint64_t cm_grant_length(const struct cm_grant *grant);
int cm_grant_writable(const struct cm_grant *grant);

/* 0, or why the pages were taken back (CM_WINDOW_REVOKED_*); -1 with EBADF once it was released. */
int cm_grant_revoked(const struct cm_grant *grant);

/**
 * cm_grant_read() / cm_grant_write() - one access to a register
 * @offset: bytes from the grant's start, multiple of the width
 * @width: 8, 16, 32 or 64 bits
 *
 * ESTALE once the pages were taken back: what was read is not the register's,
 * and what was written may not have reached it.  EACCES for a write to a grant for
 * reading, EINVAL for a range or width that is not there, ERANGE for a value
 * wider than @width.
 */
int cm_grant_read(struct cm_grant *grant, uint64_t offset, unsigned int width, uint64_t *value);
int cm_grant_write(struct cm_grant *grant, uint64_t offset, unsigned int width, uint64_t value);

/* cm_grant_read() of at most 32 bits, which returns the value, or -1. */
int64_t cm_grant_read32(struct cm_grant *grant, uint64_t offset, unsigned int width);

/* Several words, each one access of 32 bits, in ascending order; @offset and @length are multiples of 4. */
int cm_grant_read_block(struct cm_grant *grant, uint64_t offset, void *data, size_t length);
int cm_grant_write_block(struct cm_grant *grant, uint64_t offset, const void *data, size_t length);

#endif /* CM_SHIM_WINDOW_H */
