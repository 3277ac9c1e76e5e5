/* SPDX-License-Identifier: Apache-2.0 */
/* Wait for one event of a node and take it. */
#ifndef CM_SHIM_EVENT_H
#define CM_SHIM_EVENT_H

#include <errno.h>

#include "clock.h"
#include "node.h"

/*
 * Looks first: what is there needs no poll.  Another thread may take the event
 * that woke this one; then it waits for the next with what is left of the time.
 * Returns 1; -1 with ETIMEDOUT or an errno of cm_node_wait() and cm_node_take().
 */
static inline int cm_event_wait(struct cm_node *node, int64_t timeout_ns, void *event, size_t size)
{
	int64_t deadline = cm_clock_deadline(timeout_ns);

	for (;;) {
		ssize_t taken = cm_node_take(node, event, size, 1);
		int ready;

		if (taken)
			return (int)taken;
		ready = cm_node_wait(node, cm_clock_left(deadline));
		if (ready < 0)
			return -1;
		if (!ready) {
			errno = ETIMEDOUT;
			return -1;
		}
	}
}

#endif /* CM_SHIM_EVENT_H */
