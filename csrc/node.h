/* SPDX-License-Identifier: Apache-2.0 */
/*
 * One open device: a character device of the kernel, or a node of a simulated
 * board (kmod/uapi/cm_node.h).  What is above this file cannot tell which.
 *
 * Functions return -1 or NULL and set errno.  Nothing prints or exits.
 *
 * Threads may share a node: requests are serialised, waits are not.  One may
 * release it while others are in a call.  cm_node_close() frees the memory and
 * must be the last call.  A child after fork() may close a node of its parent's,
 * which leaves it open there, and nothing else.
 */
#ifndef CM_SHIM_NODE_H
#define CM_SHIM_NODE_H

#include <limits.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

/*
 * How long a simulated node may take to answer; one that is stopped (SIGSTOP) does not.
 * The environment's CM_SIM_TIMEOUT says otherwise, in whole seconds.
 */
#define CM_NODE_TIMEOUT_MS 3000
#define CM_NODE_TIMEOUT_MAX_S 3600

struct cm_node;

/* Wait without end. */
#define CM_WAIT_FOREVER INT64_MAX

/* Whether a request's structure carries a file descriptor, and which way. */
enum cm_node_fd {
	CM_NODE_FD_NONE,
	CM_NODE_FD_SEND,    /* the node gets its own reference; the caller keeps his */
	CM_NODE_FD_RECEIVE, /* a new descriptor, O_CLOEXEC, the caller's to close */
};

/**
 * cm_node_open() - open the device at @path under @root
 * @root: folder in front of every path, "/" (or NULL) on a real board
 * @path: relative to it, e.g. "dev/cm_icap0"
 *
 * May block as long as the driver's open() takes.  The caller owns the node
 * and closes it.
 *
 * Errors: those of open(); ENODEV if the simulated node is not served, ENXIO if
 * @path is neither a character device nor a socket, EPROTO if what serves it
 * does not keep to cm_node.h.
 */
struct cm_node *cm_node_open(const char *root, const char *path);

/**
 * cm_node_adopt() - a node of a descriptor that a request of another brought
 * @fd: such as a line of a GPIO chip; the node's from now on, also where this fails
 *
 * On a simulated board it is a connection, whose first packet is its greeting.
 */
struct cm_node *cm_node_adopt(int fd);

/**
 * cm_node_release() - close the device; @node stays valid
 *
 * Waits of other threads end with ECANCELED, every later call fails with EBADF.
 * Blocks until no other thread is in a call and the driver has released the
 * device, so that it can be opened again at once.  Twice is fine.
 */
void cm_node_release(struct cm_node *node);

/* Release and free @node, which may be NULL.  Leaves errno as it is. */
void cm_node_close(struct cm_node *node);

/*
 * Between these two the device stays open, for users of cm_node_mmap(): -1 with
 * EBADF once it was released.  cm_node_leave() leaves errno as it is.
 */
int cm_node_enter(struct cm_node *node);
void cm_node_leave(struct cm_node *node);

/* True where the node is a simulated one. */
bool cm_node_simulated(const struct cm_node *node);

/**
 * cm_node_request() - one ioctl, or one message and its reply
 * @op: ioctl number or CM_NODE_OP_*
 * @arg: the structure, filled in on return
 * @size: bytes of it
 * @fd: field of the structure that carries a descriptor, or NULL
 * @mode: which way @fd goes
 *
 * Blocks as long as the driver takes, on a simulated node at most
 * CM_NODE_TIMEOUT_MS (or CM_SIM_TIMEOUT), counted anew after a signal.  A signal does not end it.
 *
 * Errors: what the driver says; ENODEV if the node is gone; EPROTO if the
 * reply does not keep to cm_node.h, after which every request fails with it;
 * ETIMEDOUT if there is none (the request may be done yet), after which every
 * request fails with it at once until the reply has come.
 */
int cm_node_request(struct cm_node *node, uint32_t op, void *arg, size_t size, int32_t *fd,
		    enum cm_node_fd mode);

/**
 * cm_node_exchange() - one message to a simulated node, and a reply of another length
 * @in: room for the reply's @in_size bytes; a reply of another length is EPROTO
 *
 * Otherwise as cm_node_request(); ENOTSUP on a real node.
 */
int cm_node_exchange(struct cm_node *node, uint32_t op, const void *out, size_t out_size, void *in,
		     size_t in_size);

/**
 * cm_node_event_fd() - descriptor that polls readable when an event waits
 *
 * Owned by the node: poll it, but neither read nor close it.  EBADF once released.
 */
int cm_node_event_fd(struct cm_node *node);

/**
 * cm_node_take() - take events that are there, never blocks
 * @events: room for @count events of @size bytes each
 *
 * Returns how many were taken, 0 if none waits.
 * Errors: ENODEV if the node is gone, EPROTO for an event of another size.
 */
ssize_t cm_node_take(struct cm_node *node, void *events, size_t size, size_t count);

/**
 * cm_node_wait() - wait for one event of @size bytes and take it
 * @timeout_ns: CLOCK_MONOTONIC nanoseconds, or CM_WAIT_FOREVER; <= 0 only looks
 *
 * What is there needs no poll.  Where another thread takes the event that woke
 * this one, it waits for the next with what is left of the time.
 *
 * Returns 1.  Errors: ETIMEDOUT; EINTR when a signal came (call again with what
 * is left of the time); ECANCELED when the node is released meanwhile; those of
 * cm_node_take().
 */
int cm_node_wait(struct cm_node *node, int64_t timeout_ns, void *event, size_t size);

/* Write @size bytes to the device file.  Never blocks. */
int cm_node_write(struct cm_node *node, const void *data, size_t size);

/* Whether a simulated node offers all of these CM_NODE_OFFERS_*; a real one offers none. */
bool cm_node_offers(const struct cm_node *node, uint32_t offers);

/* False once the other end of a simulated node has gone; true for a real one. */
bool cm_node_connected(const struct cm_node *node);

/* Device memory of a real node, as mmap(); MAP_FAILED, ENOTSUP on a simulated one. */
void *cm_node_mmap(struct cm_node *node, size_t length, off_t offset);

#endif /* CM_SHIM_NODE_H */
