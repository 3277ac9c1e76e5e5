/* SPDX-License-Identifier: Apache-2.0 */
/* Inside of a node: shared by node.c, request.c and event.c only. */
#ifndef CM_SHIM_NODE_PRIVATE_H
#define CM_SHIM_NODE_PRIVATE_H

#include <pthread.h>
#include <stdatomic.h>

#include "node.h"

struct cm_node {
	int fd;		 /* the device, or the connection; -1 once released */
	int event_fd;	 /* the same device, or the event socket */
	int wake_fd;	 /* eventfd: readable once the node is being released */
	int broken;	 /* errno of all further requests, or 0; under @lock */
	pid_t owner;	 /* who opened it: a child after fork() must not hang up for its parent */
	uint32_t offers; /* CM_NODE_OFFERS_* of a simulated node */
	bool simulated;
	atomic_bool released;
	pthread_rwlock_t users; /* read: in a call; write: releases */
	pthread_mutex_t lock;	/* one request at a time on a connection */
};

/* To callers, the end of a connection means that the device was unplugged. */
static inline int cm_node_errno(int error)
{
	bool gone = error == EPIPE || error == ECONNRESET || error == ENOTCONN;

	return gone ? ENODEV : error;
}

#endif /* CM_SHIM_NODE_PRIVATE_H */
