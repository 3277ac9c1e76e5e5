// SPDX-License-Identifier: Apache-2.0
#include <errno.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "cm_node.h"
#include "message.h"
#include "node_private.h"

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

/* Take the reply that did not come in time: after that, the two ends agree again. */
static void recover(struct cm_node *node)
{
	if (node->broken == ETIMEDOUT)
		node->broken = cm_message_drop_late(node->fd) ? errno : 0;
}

static int exchange_locked(struct cm_node *node, uint32_t op, void *arg, size_t size, int32_t *fd,
			   enum cm_node_fd mode)
{
	int result = -1, error;

	pthread_mutex_lock(&node->lock);
	recover(node);
	if (node->broken)
		errno = node->broken;
	else
		result = exchange(node, op, arg, size, fd, mode);
	error = errno;
	pthread_mutex_unlock(&node->lock);
	errno = error;
	return result;
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
	int result;

	if (cm_node_enter(node))
		return -1;
	result = node->simulated ? exchange_locked(node, op, arg, size, fd, mode)
				 : device_ioctl(node->fd, op, arg);
	cm_node_leave(node);
	return result;
}

static int transfer(struct cm_node *node, uint32_t op, const void *out, size_t out_size, void *in,
		    size_t in_size)
{
	ssize_t length;

	recover(node);
	if (node->broken) {
		errno = node->broken;
		return -1;
	}
	if (cm_message_send(node->fd, op, out, out_size, -1)) {
		node->broken = errno == ENODEV ? ENODEV : 0;
		return -1;
	}
	length = cm_message_receive(node->fd, op, in, in_size, NULL, &node->broken);
	if (length < 0)
		return -1;
	if ((size_t)length != in_size) {
		node->broken = errno = EPROTO;
		return -1;
	}
	return 0;
}

int cm_node_exchange(struct cm_node *node, uint32_t op, const void *out, size_t out_size, void *in,
		     size_t in_size)
{
	int result, error;

	if (!node->simulated) {
		errno = ENOTSUP;
		return -1;
	}
	if (cm_node_enter(node))
		return -1;
	pthread_mutex_lock(&node->lock);
	result = transfer(node, op, out, out_size, in, in_size);
	error = errno;
	pthread_mutex_unlock(&node->lock);
	cm_node_leave(node);
	errno = error;
	return result;
}
