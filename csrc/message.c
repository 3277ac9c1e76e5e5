// SPDX-License-Identifier: Apache-2.0
#include "message.h"

#include <errno.h>
#include <stdbool.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <unistd.h>

#include "cm_node.h"

/* Descriptors a packet has room for: one is meant, more are closed and refused. */
#define FDS_MAX 4

union fd_control {
	struct cmsghdr align;
	char bytes[CMSG_SPACE(FDS_MAX * sizeof(int))];
};

/* The death of the other end looks like an unplugged device. */
static int gone(int error)
{
	if (error == EAGAIN || error == EWOULDBLOCK)
		return ETIMEDOUT; /* the connection has a limit */
	return error == EPIPE || error == ECONNRESET || error == ENOTCONN ? ENODEV : error;
}

static void attach_fd(struct msghdr *msg, union fd_control *control, int fd)
{
	struct cmsghdr *cmsg;

	memset(control, 0, sizeof(*control));
	msg->msg_control = control->bytes;
	msg->msg_controllen = CMSG_SPACE(sizeof(int));
	cmsg = CMSG_FIRSTHDR(msg);
	cmsg->cmsg_level = SOL_SOCKET;
	cmsg->cmsg_type = SCM_RIGHTS;
	cmsg->cmsg_len = CMSG_LEN(sizeof(int));
	memcpy(CMSG_DATA(cmsg), &fd, sizeof(int));
}

int cm_message_send(int sock, uint32_t op, const void *payload, size_t length, int fd)
{
	struct cm_node_request header = { .op = op, .length = (uint32_t)length };
	struct iovec parts[2] = {
		{ .iov_base = &header, .iov_len = sizeof(header) },
		{ .iov_base = (void *)(uintptr_t)payload, .iov_len = length },
	};
	struct msghdr msg = { .msg_iov = parts, .msg_iovlen = length ? 2 : 1 };
	union fd_control control;
	ssize_t sent;

	if (length > CM_NODE_PAYLOAD_MAX) {
		errno = EMSGSIZE;
		return -1;
	}
	if (fd >= 0)
		attach_fd(&msg, &control, fd);
	do {
		sent = sendmsg(sock, &msg, MSG_NOSIGNAL);
	} while (sent < 0 && errno == EINTR);
	if (sent < 0) {
		errno = gone(errno);
		return -1;
	}
	return 0;
}

/* Move the first descriptor of @msg to @fd and close all others; returns how many there were. */
static size_t detach_fds(struct msghdr *msg, int *fd)
{
	struct cmsghdr *cmsg;
	size_t found = 0;

	*fd = -1;
	for (cmsg = CMSG_FIRSTHDR(msg); cmsg; cmsg = CMSG_NXTHDR(msg, cmsg)) {
		size_t count, i;

		if (cmsg->cmsg_level != SOL_SOCKET || cmsg->cmsg_type != SCM_RIGHTS)
			continue;
		count = (cmsg->cmsg_len - CMSG_LEN(0)) / sizeof(int);
		for (i = 0; i < count; i++, found++) {
			int one;

			memcpy(&one, CMSG_DATA(cmsg) + i * sizeof(int), sizeof(int));
			if (found == 0)
				*fd = one;
			else
				close(one);
		}
	}
	return found;
}

static bool well_formed(const struct cm_node_reply *reply, const struct msghdr *msg, size_t got,
			uint32_t op)
{
	return !(msg->msg_flags & (MSG_TRUNC | MSG_CTRUNC)) && got >= sizeof(*reply) &&
	       reply->op == op && reply->error >= 0 && reply->length == got - sizeof(*reply);
}

/* Receive one packet; bytes received, 0 at the connection's end (or for an empty packet). */
static ssize_t receive_packet(int sock, struct msghdr *msg)
{
	ssize_t got;

	do {
		got = recvmsg(sock, msg, MSG_CMSG_CLOEXEC);
	} while (got < 0 && errno == EINTR);
	if (got < 0)
		errno = gone(errno);
	return got;
}

static ssize_t receive(int sock, uint32_t op, void *payload, size_t size, int *fd, int *broken,
		       struct cm_node_reply *reply)
{
	struct iovec parts[2] = {
		{ .iov_base = reply, .iov_len = sizeof(*reply) },
		{ .iov_base = payload, .iov_len = size },
	};
	union fd_control control;
	struct msghdr msg = {
		.msg_iov = parts,
		.msg_iovlen = size ? 2 : 1,
		.msg_control = control.bytes,
		.msg_controllen = sizeof(control.bytes),
	};
	int passed = -1;
	size_t fds;
	ssize_t got = receive_packet(sock, &msg);

	if (got < 0) {
		*broken = errno;
		return -1;
	}
	fds = detach_fds(&msg, &passed); /* an empty packet may bring some, too */
	if (got == 0)
		*broken = errno = ENODEV;
	else if (!well_formed(reply, &msg, (size_t)got, op) || fds > (fd ? 1 : 0))
		*broken = errno = EPROTO;
	else if (reply->error)
		errno = reply->error;
	else {
		if (fd)
			*fd = passed;
		return got - (ssize_t)sizeof(*reply);
	}
	if (passed >= 0) {
		int error = errno;

		close(passed);
		errno = error;
	}
	return -1;
}

ssize_t cm_message_receive(int sock, uint32_t op, void *payload, size_t size, int *fd, int *broken)
{
	struct cm_node_reply reply = { 0 };

	return receive(sock, op, payload, size, fd, broken, &reply);
}

int cm_message_drop_late(int sock)
{
	struct cm_node_reply reply;
	struct iovec part = { .iov_base = &reply, .iov_len = sizeof(reply) };
	union fd_control control;
	struct msghdr msg = {
		.msg_iov = &part,
		.msg_iovlen = 1,
		.msg_control = control.bytes,
		.msg_controllen = sizeof(control.bytes),
	};
	ssize_t got = recvmsg(sock, &msg, MSG_CMSG_CLOEXEC | MSG_DONTWAIT);
	int passed;

	if (got > 0) {
		detach_fds(&msg, &passed);
		if (passed >= 0)
			close(passed);
		return 0;
	}
	errno = got ? gone(errno) : ENODEV;
	return -1;
}

int cm_message_greeting(int sock, int *event_fd, uint32_t *offers)
{
	struct cm_node_reply reply = { 0 };
	int broken;

	if (receive(sock, CM_NODE_OP_OPEN, NULL, 0, event_fd, &broken, &reply) < 0)
		return -1;
	*offers = reply.flags;
	return 0;
}
