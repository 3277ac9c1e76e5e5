// SPDX-License-Identifier: Apache-2.0
#include "fake_node.h"

#include <fcntl.h>
#include <ftw.h>
#include <poll.h>
#include <pthread.h>
#include <semaphore.h>
#include <signal.h>
#include <stdbool.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <sys/un.h>
#include <unistd.h>

#include "cm_dma.h"
#include "cm_icap.h"
#include "cm_node.h"
#include "test.h"

#define INTERRUPTS 40 /* of MANY_INTERRUPTS: more than the shim takes at once */

struct fake_node {
	pthread_t thread;
	int listener, stop_fd[2];
	enum misdeed misdeed;
	struct cm_dma_submit last;
	atomic_uint requests;
	sem_t speak;
	uint32_t words[FAKE_NODE_WORDS];
	uint32_t interrupts;
	uint64_t completions;
	char attribute[CM_NODE_PAYLOAD_MAX];
	size_t attribute_length;
};

struct packet {
	struct cm_node_request header;
	unsigned char payload[CM_NODE_PAYLOAD_MAX] __attribute__((aligned(8)));
};

struct answer {
	struct cm_node_reply header;
	unsigned char payload[CM_NODE_PAYLOAD_MAX + 16] __attribute__((aligned(8)));
	int fd;
};

static void send_packet(int sock, const void *data, size_t length, const int *fds, size_t count)
{
	struct iovec part = { .iov_base = (void *)(uintptr_t)data, .iov_len = length };
	char control[CMSG_SPACE(4 * sizeof(int))] = { 0 };
	struct msghdr msg = { .msg_iov = &part, .msg_iovlen = 1 };

	if (count) {
		struct cmsghdr *cmsg;

		msg.msg_control = control;
		msg.msg_controllen = CMSG_SPACE(count * sizeof(int));
		cmsg = CMSG_FIRSTHDR(&msg);
		cmsg->cmsg_level = SOL_SOCKET;
		cmsg->cmsg_type = SCM_RIGHTS;
		cmsg->cmsg_len = CMSG_LEN(count * sizeof(int));
		memcpy(CMSG_DATA(cmsg), fds, count * sizeof(int));
	}
	(void)!sendmsg(sock, &msg, MSG_NOSIGNAL);
}

static ssize_t receive_packet(int sock, struct packet *packet, int *fd)
{
	char control[CMSG_SPACE(sizeof(int))];
	struct iovec part = { .iov_base = packet, .iov_len = sizeof(*packet) };
	struct msghdr msg = { .msg_iov = &part,
			      .msg_iovlen = 1,
			      .msg_control = control,
			      .msg_controllen = sizeof(control) };
	ssize_t got = recvmsg(sock, &msg, MSG_CMSG_CLOEXEC);
	struct cmsghdr *cmsg = got > 0 ? CMSG_FIRSTHDR(&msg) : NULL;

	*fd = -1;
	if (cmsg)
		memcpy(fd, CMSG_DATA(cmsg), sizeof(int));
	return got;
}

static bool offers_blocks(enum misdeed misdeed)
{
	return misdeed == OFFER_BLOCKS || misdeed == OFFER_BLOCKS_AND_REFUSE ||
	       misdeed == OFFER_BLOCKS_AND_CUT_SHORT || misdeed == OFFER_BLOCKS_AND_ANSWER_LATE;
}

static bool greet(struct fake_node *fake, int sock, int *events)
{
	struct cm_node_reply reply = { .op = CM_NODE_OP_OPEN };
	int pair[2];
	size_t fds = 1;

	if (fake->misdeed == HANG_UP_AT_OPEN)
		return false;
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair));
	if (fake->misdeed == REFUSE_OPEN)
		reply.error = EBUSY;
	if (offers_blocks(fake->misdeed))
		reply.flags = CM_NODE_OFFERS_BLOCKS;
	if (fake->misdeed == GREET_WITH_WRONG_OP)
		reply.op = 99;
	if (fake->misdeed == GREET_WITHOUT_FD || fake->misdeed == REFUSE_OPEN)
		fds = 0;
	if (fake->misdeed == GREET_WITH_TWO_FDS)
		send_packet(sock, &reply, sizeof(reply), pair, 2);
	else
		send_packet(sock, &reply, sizeof(reply), pair, fds);
	close(pair[0]);
	*events = pair[1];
	return true;
}

static void answer_register(struct fake_node *fake, bool write, struct cm_node_reg *reg)
{
	CHECK(reg->offset / 4 < FAKE_NODE_WORDS && reg->width == 32);
	if (write)
		fake->words[reg->offset / 4] = (uint32_t)reg->value;
	else /* dirt above the width must not reach the caller */
		reg->value = 0xdead000000000000 | fake->words[reg->offset / 4];
}

static void answer_block(struct fake_node *fake, const struct packet *request,
			 struct answer *answer)
{
	bool write = request->header.op == CM_NODE_OP_BLOCK_WRITE;
	struct cm_node_block block;
	unsigned char *place;

	memcpy(&block, request->payload, sizeof(block));
	CHECK(offers_blocks(fake->misdeed) && block.map == 0);
	CHECK(block.length >= 4 && block.length <= CM_NODE_BLOCK_MAX && block.length % 4 == 0);
	CHECK(block.offset % 4 == 0 && block.offset + block.length <= sizeof(fake->words));
	CHECK(request->header.length == sizeof(block) + (write ? block.length : 0));
	place = (unsigned char *)fake->words + block.offset;
	if (write)
		memcpy(place, request->payload + sizeof(block), block.length);
	else
		memcpy(answer->payload, place, block.length);
	answer->header.length = write ? 0 : block.length;
	if (fake->misdeed == OFFER_BLOCKS_AND_CUT_SHORT && !write)
		answer->header.length -= 4;
	if (fake->misdeed == OFFER_BLOCKS_AND_REFUSE) {
		answer->header.error = EIO;
		answer->header.length = 0;
	}
}

static void answer_alloc(struct cm_buffer_alloc *alloc, struct answer *answer)
{
	CHECK(alloc->size == sizeof(*alloc) && alloc->flags == 0);
	alloc->handle = 7;
	alloc->coherent = 1;
	alloc->length = (alloc->length + 4095) & ~UINT64_C(4095);
	answer->fd = memfd_create("fake", MFD_CLOEXEC);
	CHECK(answer->fd >= 0 && !ftruncate(answer->fd, (off_t)alloc->length));
}

static void answer_import(struct cm_buffer_import *import, int fd, struct answer *answer)
{
	struct stat st;

	if (fd < 0 || fstat(fd, &st)) {
		answer->header.error = EBADF;
		return;
	}
	import->handle = 8;
	import->length = (uint64_t)st.st_size;
}

static void complete_dma(struct fake_node *fake, int events, const struct cm_dma_submit *submit)
{
	struct cm_dma_completion done[2] = { {
		.cookie = submit->cookie,
		.length = submit->length / 2,
		.timestamp_ns = 1,
		.sequence = fake->completions++,
	} };
	size_t length = sizeof(done[0]);

	if (fake->misdeed == SHORT_EVENT)
		length -= 4;
	if (fake->misdeed == LONG_EVENT)
		length += 4;
	send_packet(events, done, length, NULL, 0);
}

static void complete_load(int events, const struct cm_icap_load *load)
{
	struct cm_icap_completion done = {
		.cookie = load->cookie,
		.length = load->length,
		.started_ns = 1,
		.finished_ns = 2,
		.status = load->length == 8 ? -EILSEQ : 0,
		.errors = load->length == 8 ? CM_ICAP_ERR_CRC : 0,
	};

	send_packet(events, &done, sizeof(done), NULL, 0);
}

static void complete_read(int events, const struct cm_icap_read *read)
{
	struct cm_icap_completion done = {
		.cookie = read->cookie,
		.length = read->reply_length,
		.status = read->closing_offset == read->reply_offset + read->reply_length
				  ? 0
				  : -ETIMEDOUT,
	};

	send_packet(events, &done, sizeof(done), NULL, 0);
}

static void answer_request(struct fake_node *fake, const struct packet *request, int fd, int events,
			   struct answer *answer)
{
	void *body = answer->payload;

	switch (request->header.op) {
	case CM_NODE_OP_REG_READ:
	case CM_NODE_OP_REG_WRITE:
		answer_register(fake, request->header.op == CM_NODE_OP_REG_WRITE, body);
		break;
	case CM_NODE_OP_BLOCK_READ:
	case CM_NODE_OP_BLOCK_WRITE:
		answer_block(fake, request, answer);
		break;
	case CM_NODE_OP_ATTR_WRITE:
		memcpy(fake->attribute, body, request->header.length);
		fake->attribute_length = request->header.length;
		answer->header.length = 0;
		break;
	case CM_NODE_OP_ATTR_READ:
		memcpy(body, fake->attribute, fake->attribute_length);
		answer->header.length = (uint32_t)fake->attribute_length;
		break;
	case CM_NODE_OP_MKDIR:
	case CM_NODE_OP_RMDIR:
		memcpy(fake->attribute, body, request->header.length);
		fake->attribute_length = request->header.length;
		answer->header.length = 0;
		break;
	case CM_DMA_IOC_INFO:
		((struct cm_dma_info *)body)->direction = CM_DMA_S2MM;
		memset(((struct cm_dma_info *)body)->name, 'x', CM_DMA_NAME_MAX);
		break;
	case CM_DMA_IOC_ALLOC:
	case CM_ICAP_IOC_ALLOC:
		answer_alloc(body, answer);
		break;
	case CM_DMA_IOC_IMPORT:
	case CM_ICAP_IOC_IMPORT:
		answer_import(body, fd, answer);
		break;
	case CM_DMA_IOC_SUBMIT:
		fake->last = *(const struct cm_dma_submit *)body;
		if (fake->misdeed != END_AT_CANCEL)
			complete_dma(fake, events, &fake->last);
		answer->header.length = 0; /* as _IOW may */
		break;
	case CM_DMA_IOC_CANCEL:
		if (fake->misdeed == END_AT_CANCEL)
			complete_dma(fake, events, &fake->last);
		break;
	case CM_ICAP_IOC_LOAD:
		complete_load(events, body);
		break;
	case CM_ICAP_IOC_READ:
		complete_read(events, body);
		break;
	case CM_ICAP_IOC_STATUS:
		((struct cm_icap_status *)body)->loads = 3;
		break;
	default:
		break;
	}
}

/* Put into @answer what is wrong about it; bytes to send, 0 to hang up. */
static size_t spoil(enum misdeed misdeed, struct answer *answer)
{
	struct cm_node_reply *header = &answer->header;
	size_t whole;

	if (misdeed == REFUSE) {
		header->error = EIO;
		header->length = 0;
	}
	if (misdeed == WRONG_OP)
		header->op++;
	if (misdeed == NEGATIVE_ERROR)
		header->error = -5;
	if (misdeed == SHORT_PAYLOAD)
		header->length = header->length > 4 ? header->length - 4 : 4;
	if (misdeed == LONG_PAYLOAD)
		header->length += 8;
	whole = sizeof(*header) + header->length;
	if (misdeed == WRONG_LENGTH)
		header->length += 4;
	return misdeed == HANG_UP ? 0 : misdeed == SHORT_HEADER ? 8 : whole;
}

static bool send_answer(enum misdeed misdeed, int sock, struct answer *answer, int any_fd)
{
	size_t length = spoil(misdeed, answer);
	bool pass = misdeed != NO_FD && answer->fd >= 0;

	if (length && misdeed == UNASKED_FD)
		send_packet(sock, answer, length, &any_fd, 1);
	else if (length)
		send_packet(sock, answer, length, &answer->fd, pass);
	if (answer->fd >= 0)
		close(answer->fd);
	return length > 0;
}

static bool serve_request(struct fake_node *fake, int sock, int events)
{
	static _Thread_local struct packet request;
	static _Thread_local struct answer answer;
	int fd;
	ssize_t got = receive_packet(sock, &request, &fd);

	if (got < (ssize_t)sizeof(request.header))
		return false;
	CHECK((size_t)got == sizeof(request.header) + request.header.length);
	memset(&answer.header, 0, sizeof(answer.header));
	memcpy(answer.payload, request.payload, request.header.length);
	answer.header.op = request.header.op;
	answer.header.length = request.header.length;
	answer.fd = -1;
	if ((fake->misdeed == ANSWER_LATE || fake->misdeed == OFFER_BLOCKS_AND_ANSWER_LATE) &&
	    !fake_node_requests(fake))
		sem_wait(&fake->speak);
	if (fake->misdeed == ANSWER_CANCEL_LATE && request.header.op == CM_DMA_IOC_CANCEL)
		sem_wait(&fake->speak);
	answer_request(fake, &request, fd, events, &answer);
	if (fd >= 0)
		close(fd);
	atomic_fetch_add(&fake->requests, 1);
	return send_answer(fake->misdeed, sock, &answer, events);
}

static void serve_event(struct fake_node *fake, int events)
{
	uint32_t on;
	int i, count = fake->misdeed == MANY_INTERRUPTS ? INTERRUPTS : 1;

	if (recv(events, &on, sizeof(on), MSG_DONTWAIT) != sizeof(on) || on != 1)
		return;
	if (fake->misdeed == HANG_UP_EVENTS) {
		shutdown(events, SHUT_RDWR);
		return;
	}
	for (i = 0; i < count; i++) {
		fake->interrupts++;
		send_packet(events, &fake->interrupts, sizeof(fake->interrupts), NULL, 0);
	}
}

static void serve(struct fake_node *fake, int sock)
{
	int events = -1;
	bool keep = greet(fake, sock, &events);
	struct pollfd fds[3] = {
		{ .fd = sock, .events = POLLIN },
		{ .fd = events, .events = POLLIN },
		{ .fd = fake->stop_fd[0], .events = POLLIN },
	};

	while (keep && poll(fds, 3, -1) >= 0 && !fds[2].revents) {
		if (fds[1].revents & POLLIN)
			serve_event(fake, events);
		if (fds[1].revents & POLLHUP)
			fds[1].fd = -1;
		if (fds[0].revents)
			keep = serve_request(fake, sock, events);
	}
	if (events >= 0)
		close(events);
	close(sock);
}

static void *run(void *arg)
{
	struct fake_node *fake = arg;

	for (;;) {
		struct pollfd fds[2] = {
			{ .fd = fake->listener, .events = POLLIN },
			{ .fd = fake->stop_fd[0], .events = POLLIN },
		};

		if (poll(fds, 2, -1) < 0)
			continue;
		if (fds[1].revents)
			return NULL;
		if (fds[0].revents)
			serve(fake, accept4(fake->listener, NULL, NULL, SOCK_CLOEXEC));
	}
}

static void make_folders(const char *root, const char *path)
{
	char whole[4096], *slash;

	snprintf(whole, sizeof(whole), "%s/%s", root, path);
	for (slash = whole + strlen(root) + 1; (slash = strchr(slash, '/')); slash++) {
		*slash = '\0';
		CHECK(!mkdir(whole, 0755) || errno == EEXIST);
		*slash = '/';
	}
}

static int listen_at(const char *root, const char *path)
{
	int sock = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0), folder;
	struct sockaddr_un address = { .sun_family = AF_UNIX };
	char whole[4096], *leaf;

	make_folders(root, path);
	snprintf(whole, sizeof(whole), "%s/%s", root, path);
	leaf = strrchr(whole, '/');
	*leaf++ = '\0';
	folder = open(whole, O_PATH | O_DIRECTORY | O_CLOEXEC);
	CHECK(folder >= 0);
	snprintf(address.sun_path, sizeof(address.sun_path), "/proc/self/fd/%d/%.40s", folder,
		 leaf);
	CHECK(!bind(sock, (struct sockaddr *)&address, sizeof(address)) && !listen(sock, 16));
	close(folder);
	return sock;
}

struct fake_node *fake_node_start(const char *root, const char *path, enum misdeed misdeed)
{
	struct fake_node *fake = calloc(1, sizeof(*fake));
	sigset_t all, before;

	CHECK(fake);
	/* a busy machine may keep an answer waiting; one that is to come late is missed soon */
	if (misdeed == ANSWER_LATE || misdeed == OFFER_BLOCKS_AND_ANSWER_LATE)
		CHECK(!unsetenv("CM_SIM_TIMEOUT"));
	else
		CHECK(!setenv("CM_SIM_TIMEOUT", "60", 1));
	fake->misdeed = misdeed;
	fake->listener = listen_at(root, path);
	CHECK(!sem_init(&fake->speak, 0, 0));
	CHECK(!pipe2(fake->stop_fd, O_CLOEXEC));
	/* signals of the tests are for the tests' own thread */
	sigfillset(&all);
	CHECK(!pthread_sigmask(SIG_SETMASK, &all, &before));
	CHECK(!pthread_create(&fake->thread, NULL, run, fake));
	CHECK(!pthread_sigmask(SIG_SETMASK, &before, NULL));
	return fake;
}

void fake_node_stop(struct fake_node *fake)
{
	close(fake->stop_fd[1]);
	pthread_join(fake->thread, NULL);
	close(fake->stop_fd[0]);
	close(fake->listener);
	sem_destroy(&fake->speak);
	free(fake);
}

void fake_node_speak(struct fake_node *fake)
{
	sem_post(&fake->speak);
}

unsigned int fake_node_requests(struct fake_node *fake)
{
	return atomic_load(&fake->requests);
}

static const char *scratch(void)
{
	const char *given = getenv("TMPDIR");

	return given && *given ? given : "/tmp";
}

char *fake_root_make(void)
{
	char *root;

	CHECK(asprintf(&root, "%s/cm-csrc-XXXXXX", scratch()) > 0 && mkdtemp(root));
	return root;
}

char *fake_root_make_long(void)
{
	char *root = fake_root_make(), *longer;

	CHECK(asprintf(&longer, "%s/%0200d", root, 0) > 0);
	CHECK(!mkdir(longer, 0755));
	free(root);
	return longer;
}

static int remove_one(const char *path, const struct stat *st, int kind, struct FTW *ftw)
{
	(void)st, (void)kind, (void)ftw;
	return remove(path);
}

void fake_root_remove(char *root)
{
	char *end = strchr(root + strlen(scratch()) + 1, '/');

	if (end)
		*end = '\0';
	CHECK(!nftw(root, remove_one, 16, FTW_DEPTH | FTW_PHYS));
	free(root);
}

void fake_file(const char *root, const char *path, const char *text)
{
	char whole[4096];
	FILE *file;

	make_folders(root, path);
	snprintf(whole, sizeof(whole), "%s/%s", root, path);
	file = fopen(whole, "w");
	CHECK(file && fputs(text, file) >= 0 && !fclose(file));
}
