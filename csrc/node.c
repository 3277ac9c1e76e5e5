// SPDX-License-Identifier: Apache-2.0
#include "node.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clock.h"
#include "cm_node.h"
#include "message.h"
#include "path.h"

/* How long close() waits for a simulated node to let go, as a driver's release() would. */
#define RELEASE_TIMEOUT_MS 5000

struct cm_node {
	int fd;	      /* the device, or the connection */
	int event_fd; /* the same device, or the event socket */
	int wake_fd;  /* eventfd: readable once cm_node_wake() was called */
	int broken;   /* errno of all further requests, or 0; under @lock */
	bool simulated;
	pthread_mutex_t lock; /* one request at a time on a connection */
};

static int greet(struct cm_node *node)
{
	int broken;

	if (cm_message_receive(node->fd, CM_NODE_OP_OPEN, NULL, 0, &node->event_fd, &broken) < 0)
		return -1;
	if (node->event_fd < 0) {
		errno = EPROTO;
		return -1;
	}
	return 0;
}

static int open_kind(struct cm_node *node, int path_fd)
{
	struct stat st;

	if (fstat(path_fd, &st))
		return -1;
	if (S_ISCHR(st.st_mode)) {
		node->fd = cm_path_reopen(path_fd, O_RDWR | O_NONBLOCK);
		node->event_fd = node->fd;
		return node->fd < 0 ? -1 : 0;
	}
	if (S_ISSOCK(st.st_mode)) {
		node->simulated = true;
		node->fd = cm_path_connect(path_fd);
		return node->fd < 0 ? -1 : greet(node);
	}
	errno = ENXIO;
	return -1;
}

static int open_under(struct cm_node *node, const char *root, const char *path)
{
	int path_fd = cm_path_open(root, path, O_PATH);
	int result, error;

	if (path_fd < 0)
		return -1;
	result = open_kind(node, path_fd);
	error = errno;
	close(path_fd);
	errno = error;
	return result;
}

struct cm_node *cm_node_open(const char *root, const char *path)
{
	struct cm_node *node = calloc(1, sizeof(*node));

	if (!node)
		return NULL;
	node->fd = node->event_fd = -1;
	pthread_mutex_init(&node->lock, NULL);
	node->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	if (node->wake_fd < 0 || open_under(node, root, path)) {
		cm_node_close(node);
		return NULL;
	}
	return node;
}

/* Wait for the server to close its end too: then its release() is done. */
static void await_release(int fd)
{
	struct pollfd end = { .fd = fd, .events = POLLIN };
	int64_t deadline = cm_clock_ns() + RELEASE_TIMEOUT_MS * INT64_C(1000000);
	char rest[64];

	if (shutdown(fd, SHUT_WR))
		return;
	for (;;) {
		int64_t left = (deadline - cm_clock_ns()) / 1000000;
		int ready = left > 0 ? poll(&end, 1, (int)left) : 0;

		if (ready < 0 && errno == EINTR)
			continue;
		if (ready <= 0 || recv(fd, rest, sizeof(rest), MSG_DONTWAIT) <= 0)
			return;
	}
}

void cm_node_close(struct cm_node *node)
{
	int error = errno;

	if (!node)
		return;
	if (node->simulated && node->event_fd >= 0) {
		await_release(node->fd);
		close(node->event_fd);
	}
	if (node->fd >= 0)
		close(node->fd);
	if (node->wake_fd >= 0)
		close(node->wake_fd);
	pthread_mutex_destroy(&node->lock);
	free(node);
	errno = error;
}

bool cm_node_simulated(const struct cm_node *node)
{
	return node->simulated;
}

int cm_node_event_fd(const struct cm_node *node)
{
	return node->event_fd;
}

/*
 * A reply to an ioctl that only writes (_IOW) may leave the structure out;
 * every other brings it whole.
 */
static bool expected_length(uint32_t op, size_t length, size_t size)
{
	bool optional =
		op == CM_NODE_OP_REG_WRITE || (_IOC_TYPE(op) && !(_IOC_DIR(op) & _IOC_READ));

	return length == size || (optional && length == 0);
}

/* One request and its reply on the connection; @lock is held. */
static int exchange(struct cm_node *node, uint32_t op, void *arg, size_t size, int32_t *fd,
		    enum cm_node_fd mode)
{
	int received = -1;
	ssize_t length;

	if (cm_message_send(node->fd, op, arg, size, mode == CM_NODE_FD_SEND ? *fd : -1)) {
		node->broken = errno == ENODEV ? ENODEV : 0;
		return -1;
	}
	length = cm_message_receive(node->fd, op, arg, size,
				    mode == CM_NODE_FD_RECEIVE ? &received : NULL, &node->broken);
	if (length < 0)
		return -1;
	if (!expected_length(op, (size_t)length, size) ||
	    (mode == CM_NODE_FD_RECEIVE && received < 0)) {
		if (received >= 0)
			close(received);
		node->broken = errno = EPROTO;
		return -1;
	}
	if (mode == CM_NODE_FD_RECEIVE)
		*fd = received;
	return 0;
}

static int device_ioctl(int fd, uint32_t op, void *arg)
{
	int result;

	do {
		result = ioctl(fd, (unsigned long)op, arg);
	} while (result < 0 && errno == EINTR);
	return result < 0 ? -1 : 0;
}

int cm_node_request(struct cm_node *node, uint32_t op, void *arg, size_t size, int32_t *fd,
		    enum cm_node_fd mode)
{
	int result = -1, error;

	if (!node->simulated)
		return device_ioctl(node->fd, op, arg);
	pthread_mutex_lock(&node->lock);
	if (node->broken)
		errno = node->broken;
	else
		result = exchange(node, op, arg, size, fd, mode);
	error = errno;
	pthread_mutex_unlock(&node->lock);
	errno = error;
	return result;
}

/* A real device returns as many whole events as fit, a socket one a packet. */
static ssize_t take_some(struct cm_node *node, void *events, size_t size, size_t count)
{
	size_t room = node->simulated ? size : size * count;
	ssize_t got;

	do {
		got = node->simulated ? recv(node->event_fd, events, room, MSG_DONTWAIT | MSG_TRUNC)
				      : read(node->event_fd, events, room);
	} while (got < 0 && errno == EINTR);
	if (got < 0)
		return errno == EAGAIN ? 0 : -1;
	if (got == 0 || (size_t)got > room || (size_t)got % size) {
		errno = got == 0 ? ENODEV : EPROTO;
		return -1;
	}
	return got / (ssize_t)size;
}

ssize_t cm_node_take(struct cm_node *node, void *events, size_t size, size_t count)
{
	size_t taken = 0;

	while (taken < count) {
		ssize_t some = take_some(node, (char *)events + taken * size, size, count - taken);

		if (some < 0 && taken == 0) {
			if (errno == ECONNRESET)
				errno = ENODEV;
			return -1;
		}
		if (some <= 0 || !node->simulated)
			return (ssize_t)taken + (some > 0 ? some : 0);
		taken += (size_t)some;
	}
	return (ssize_t)taken;
}

int cm_node_wait(struct cm_node *node, int64_t timeout_ns)
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

int cm_node_write(struct cm_node *node, const void *data, size_t size)
{
	ssize_t done;

	do {
		done = node->simulated
			       ? send(node->event_fd, data, size, MSG_NOSIGNAL | MSG_DONTWAIT)
			       : write(node->event_fd, data, size);
	} while (done < 0 && errno == EINTR);
	if (done == (ssize_t)size)
		return 0;
	if (done >= 0)
		errno = EIO;
	else if (errno == EPIPE || errno == ECONNRESET || errno == ENOTCONN)
		errno = ENODEV;
	return -1;
}

void cm_node_wake(struct cm_node *node)
{
	int error = errno;

	/* It fails only when the counter is full: then it is readable already. */
	(void)!eventfd_write(node->wake_fd, 1);
	errno = error;
}

void *cm_node_mmap(struct cm_node *node, size_t length, off_t offset)
{
	if (node->simulated) {
		errno = ENOTSUP;
		return MAP_FAILED;
	}
	return mmap(NULL, length, PROT_READ | PROT_WRITE, MAP_SHARED, node->fd, offset);
}
