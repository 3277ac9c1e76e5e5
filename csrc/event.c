// SPDX-License-Identifier: Apache-2.0
#include <errno.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "clock.h"
#include "node_private.h"

/* A real device returns as many whole events as fit, a socket one a packet. */
static ssize_t take_some(struct cm_node *node, void *events, size_t size, size_t count)
{
	size_t room = node->simulated ? size : size * count;
	ssize_t got;

	do {
		got = node->simulated ? recv(node->event_fd, events, room, MSG_DONTWAIT | MSG_TRUNC)
				      : read(node->event_fd, events, room);
	} while (got < 0 && errno == EINTR);
	if (got < 0 && errno == EAGAIN)
		return 0;
	if (got < 0)
		errno = cm_node_errno(errno);
	else if (got == 0)
		errno = ENODEV;
	else if ((size_t)got > room || (size_t)got % size)
		errno = EPROTO;
	else
		return got / (ssize_t)size;
	return -1;
}

/* An error after some events is left for the next call, which meets it again. */
static ssize_t take(struct cm_node *node, char *events, size_t size, size_t count)
{
	size_t taken = 0;

	while (taken < count) {
		ssize_t some = take_some(node, events + taken * size, size, count - taken);

		if (some < 0 && taken == 0)
			return -1;
		if (some <= 0)
			break;
		taken += (size_t)some;
		if (!node->simulated)
			break;
	}
	return (ssize_t)taken;
}

ssize_t cm_node_take(struct cm_node *node, void *events, size_t size, size_t count)
{
	ssize_t taken;

	if (cm_node_enter(node))
		return -1;
	taken = take(node, events, size, count);
	cm_node_leave(node);
	return taken;
}

static int poll_events(struct cm_node *node, int64_t timeout_ns)
{
	struct pollfd fds[2] = {
		{ .fd = node->event_fd, .events = POLLIN },
		{ .fd = node->wake_fd, .events = POLLIN },
	};
	struct timespec limit = cm_clock_timespec(timeout_ns);
	int ready = ppoll(fds, 2, timeout_ns == CM_WAIT_FOREVER ? NULL : &limit, NULL);

	if (ready > 0 && fds[1].revents) {
		errno = ECANCELED;
		return -1;
	}
	return ready < 0 ? -1 : ready > 0;
}

int cm_node_wait(struct cm_node *node, int64_t timeout_ns, void *event, size_t size)
{
	int64_t deadline = cm_clock_deadline(timeout_ns);
	ssize_t result;

	if (cm_node_enter(node))
		return -1;
	for (;;) {
		result = take(node, event, size, 1);
		if (result)
			break;
		result = poll_events(node, cm_clock_left(deadline));
		if (result < 0)
			break;
		if (!result) {
			errno = ETIMEDOUT;
			result = -1;
			break;
		}
	}
	cm_node_leave(node);
	return (int)result;
}

int cm_node_write(struct cm_node *node, const void *data, size_t size)
{
	ssize_t done;

	if (cm_node_enter(node))
		return -1;
	do {
		done = node->simulated
			       ? send(node->event_fd, data, size, MSG_NOSIGNAL | MSG_DONTWAIT)
			       : write(node->event_fd, data, size);
	} while (done < 0 && errno == EINTR);
	errno = done < 0 ? cm_node_errno(errno) : EIO;
	cm_node_leave(node);
	return done == (ssize_t)size ? 0 : -1;
}
