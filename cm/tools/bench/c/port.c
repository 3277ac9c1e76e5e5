// SPDX-License-Identifier: Apache-2.0
/*
 * port SOCKET: a configuration port that does nothing but take the time.
 *
 * It listens on a simulated node (kmod/uapi/cm_node.h) as an ICAP and stamps a
 * load with the moment at which its request arrives, as a driver would before
 * it starts its DMA. What lies between a caller's clock and this stamp is the
 * shim, the packet and the switch to this process; a driver has no such switch.
 */
#define _GNU_SOURCE
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include "cm_icap.h"
#include "cm_node.h"

struct packet {
	struct cm_node_request head;
	unsigned char body[256];
};

struct answer {
	struct cm_node_reply head;
	unsigned char body[256];
};

static void fail(const char *what)
{
	perror(what);
	exit(1);
}

static uint64_t now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static void reply(int sock, uint32_t op, const void *body, uint32_t length, int fd)
{
	union {
		struct cmsghdr align;
		char bytes[CMSG_SPACE(sizeof(int))];
	} control = { 0 };
	struct answer a = { .head = { .op = op, .length = length } };
	struct iovec part = { .iov_base = &a, .iov_len = sizeof(a.head) + length };
	struct msghdr msg = { .msg_iov = &part, .msg_iovlen = 1 };

	memcpy(a.body, body, length);
	if (fd >= 0) {
		struct cmsghdr *c = &control.align;

		c->cmsg_level = SOL_SOCKET;
		c->cmsg_type = SCM_RIGHTS;
		c->cmsg_len = CMSG_LEN(sizeof(int));
		memcpy(CMSG_DATA(c), &fd, sizeof(int));
		msg.msg_control = control.bytes;
		msg.msg_controllen = sizeof(control.bytes);
	}
	if (sendmsg(sock, &msg, MSG_NOSIGNAL) < 0)
		fail("sendmsg");
	if (fd >= 0)
		close(fd);
}

static void load(int sock, int events, const struct packet *p, uint64_t arrived)
{
	struct cm_icap_load arg;
	struct cm_icap_completion done = { .started_ns = arrived };

	memcpy(&arg, p->body, sizeof(arg));
	reply(sock, p->head.op, p->body, p->head.length, -1);
	done.cookie = arg.cookie;
	done.length = arg.length;
	done.finished_ns = now();
	if (send(events, &done, sizeof(done), MSG_NOSIGNAL) < 0)
		fail("event");
}

static void alloc(int sock, const struct packet *p)
{
	struct cm_buffer_alloc arg;
	int fd = memfd_create("port", MFD_CLOEXEC);

	memcpy(&arg, p->body, sizeof(arg));
	if (fd < 0 || ftruncate(fd, (off_t)arg.length))
		fail("memfd");
	arg.handle = 1;
	arg.coherent = 1;
	reply(sock, p->head.op, &arg, sizeof(arg), fd);
}

static void serve(int sock)
{
	struct packet p;
	int events[2];

	if (socketpair(AF_UNIX, SOCK_SEQPACKET, 0, events))
		fail("socketpair");
	reply(sock, CM_NODE_OP_OPEN, "", 0, events[1]);
	while (recv(sock, &p, sizeof(p), 0) > 0) {
		uint64_t arrived = now();

		if (p.head.op == CM_ICAP_IOC_LOAD)
			load(sock, events[0], &p, arrived);
		else if (p.head.op == CM_ICAP_IOC_ALLOC)
			alloc(sock, &p);
		else
			reply(sock, p.head.op, p.body, p.head.length, -1);
	}
}

int main(int argc, char **argv)
{
	struct sockaddr_un address = { .sun_family = AF_UNIX };
	int listener = socket(AF_UNIX, SOCK_SEQPACKET, 0), sock;

	if (argc != 2 || strlen(argv[1]) >= sizeof(address.sun_path)) {
		fprintf(stderr, "usage: port SOCKET\n");
		return 2;
	}
	prctl(PR_SET_PDEATHSIG, SIGKILL);
	strcpy(address.sun_path, argv[1]);
	if (listener < 0 || bind(listener, (struct sockaddr *)&address, sizeof(address)) ||
	    listen(listener, 1))
		fail("listen");
	puts("ready");
	fflush(stdout);
	sock = accept(listener, NULL, NULL);
	if (sock < 0)
		fail("accept");
	serve(sock);
	return 0;
}
