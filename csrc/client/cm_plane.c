// SPDX-License-Identifier: Apache-2.0
#include "cm_plane.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/dma-buf.h>
#include <poll.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

/* The slots of one geometry; stays until its last frame is released. */
struct cm_memory {
	struct cm_memory *next;
	struct cm_plane_geometry geometry;
	uint8_t epoch;
	uint32_t slots;
	uint32_t held;
	void *map[CM_PLANE_SLOTS_MAX];
	int fd[CM_PLANE_SLOTS_MAX];	/* kept where the memory needs synchronising, else -1 */
	bool taken[CM_PLANE_SLOTS_MAX]; /* by the caller */
};

struct cm_reader {
	int fd;
	struct cm_memory *memories; /* the first is that of what comes now, if @running */
	bool running;
	bool numbered;
	uint64_t expected;
	uint64_t lost;
	char mode[256];
	char error[CM_PLANE_PACKET_MAX + 16];
};

struct packet {
	union {
		struct cm_plane_descriptor head;
		char bytes[CM_PLANE_PACKET_MAX + 1];
	};
	size_t size;
	int fds[CM_PLANE_FDS_MAX];
	uint32_t fd_count;
};

/* By way of the folder's descriptor: the name of a socket holds 107 bytes. */
static int connect_in(int sock, const char *folder)
{
	struct sockaddr_un address = { .sun_family = AF_UNIX };
	int place = open(folder, O_PATH | O_DIRECTORY | O_CLOEXEC);
	int result, error;

	if (place < 0)
		return -1;
	snprintf(address.sun_path, sizeof(address.sun_path), "/proc/self/fd/%d/data", place);
	result = connect(sock, (struct sockaddr *)&address, sizeof(address));
	error = errno;
	close(place);
	errno = error;
	return result;
}

static int ask(int sock, const char *stream, unsigned int depth)
{
	char packet[sizeof(struct cm_plane_descriptor) + 256];
	struct cm_plane_descriptor head = { .kind = CM_PLANE_OPEN, .slot = (uint16_t)depth };
	size_t length = strlen(stream);

	if (length > sizeof(packet) - sizeof(head) || depth > CM_PLANE_SLOTS_MAX) {
		errno = length > 256 ? ENAMETOOLONG : EINVAL;
		return -1;
	}
	memcpy(packet, &head, sizeof(head));
	memcpy(packet + sizeof(head), stream, length);
	return send(sock, packet, sizeof(head) + length, MSG_NOSIGNAL) < 0 ? -1 : 0;
}

struct cm_reader *cm_reader_open(const char *runtime_dir, const char *stream, unsigned int depth)
{
	struct cm_reader *reader = calloc(1, sizeof(*reader));

	if (!reader)
		return NULL;
	reader->fd = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
	if (reader->fd < 0 || connect_in(reader->fd, runtime_dir) ||
	    ask(reader->fd, stream, depth)) {
		int error = errno;

		cm_reader_close(reader);
		errno = error;
		return NULL;
	}
	return reader;
}

static int sync_slot(const struct cm_memory *memory, uint32_t slot, uint64_t when)
{
	struct dma_buf_sync sync = { .flags = DMA_BUF_SYNC_READ | when };
	int result;

	if (memory->fd[slot] < 0)
		return 0;
	do {
		result = ioctl(memory->fd[slot], DMA_BUF_IOCTL_SYNC, &sync);
	} while (result && (errno == EINTR || errno == EAGAIN));
	return result && errno == ENOTTY ? 0 : result; /* ordinary memory */
}

static void free_memory(struct cm_memory *memory)
{
	for (uint32_t i = 0; i < memory->slots; i++) {
		if (memory->taken[i])
			sync_slot(memory, i, DMA_BUF_SYNC_END);
		munmap(memory->map[i], memory->geometry.slot_length);
		if (memory->fd[i] >= 0)
			close(memory->fd[i]);
	}
	free(memory);
}

/* Drop memory that nothing comes into any more, and of which nothing is held. */
static void sweep(struct cm_reader *reader)
{
	struct cm_memory **link = &reader->memories;

	if (reader->running)
		link = &reader->memories->next;
	while (*link) {
		struct cm_memory *memory = *link;

		if (memory->held) {
			link = &memory->next;
			continue;
		}
		*link = memory->next;
		free_memory(memory);
	}
}

void cm_reader_close(struct cm_reader *reader)
{
	if (!reader)
		return;
	while (reader->memories) {
		struct cm_memory *memory = reader->memories;

		reader->memories = memory->next;
		free_memory(memory);
	}
	if (reader->fd >= 0)
		close(reader->fd);
	free(reader);
}

int cm_reader_fd(const struct cm_reader *reader)
{
	return reader->fd;
}

static int receive(const struct cm_reader *reader, struct packet *packet)
{
	union {
		char bytes[CMSG_SPACE(CM_PLANE_FDS_MAX * sizeof(int))];
		struct cmsghdr align;
	} control;
	struct iovec part = { .iov_base = packet->bytes, .iov_len = CM_PLANE_PACKET_MAX };
	struct msghdr message = {
		.msg_iov = &part,
		.msg_iovlen = 1,
		.msg_control = control.bytes,
		.msg_controllen = sizeof(control.bytes),
	};
	ssize_t got = recvmsg(reader->fd, &message, MSG_CMSG_CLOEXEC | MSG_DONTWAIT);
	struct cmsghdr *header = got < 0 ? NULL : CMSG_FIRSTHDR(&message);

	packet->fd_count = 0;
	if (header && header->cmsg_level == SOL_SOCKET && header->cmsg_type == SCM_RIGHTS) {
		packet->fd_count = (uint32_t)((header->cmsg_len - CMSG_LEN(0)) / sizeof(int));
		memcpy(packet->fds, CMSG_DATA(header), packet->fd_count * sizeof(int));
	}
	if (got < 0)
		return -1;
	packet->size = (size_t)got;
	packet->bytes[got] = '\0';
	if (packet->size >= sizeof(packet->head))
		return 0;
	errno = got ? EPROTO : ECONNRESET;
	return -1;
}

static void read_mode(struct cm_reader *reader, const char *names, const char *end)
{
	for (int skip = 0; skip < 2 && names < end; skip++)
		names += strlen(names) + 1;
	snprintf(reader->mode, sizeof(reader->mode), "%s", names < end ? names : "");
}

static int begin(struct cm_reader *reader, const struct packet *packet)
{
	size_t fixed = sizeof(packet->head) + sizeof(struct cm_plane_geometry);
	struct cm_memory *memory = packet->size < fixed ? NULL : calloc(1, sizeof(*memory));

	if (!memory) {
		errno = packet->size < fixed ? EPROTO : ENOMEM;
		return -1;
	}
	memcpy(&memory->geometry, packet->bytes + sizeof(packet->head), sizeof(memory->geometry));
	memory->epoch = packet->head.flags;
	memory->next = reader->memories;
	reader->memories = memory;
	reader->running = true;
	reader->numbered = false;
	read_mode(reader, packet->bytes + fixed, packet->bytes + packet->size);
	sweep(reader);
	return 0;
}

static int map_slot(struct cm_memory *memory, int fd)
{
	uint32_t number = memory->slots;
	void *map = MAP_FAILED;

	if (number < CM_PLANE_SLOTS_MAX)
		map = mmap(NULL, memory->geometry.slot_length, PROT_READ, MAP_SHARED | MAP_POPULATE,
			   fd, 0);
	if (map == MAP_FAILED) {
		close(fd);
		return -1;
	}
	memory->map[number] = map;
	memory->fd[number] = fd;
	if (memory->geometry.flags & CM_PLANE_COHERENT) {
		close(fd);
		memory->fd[number] = -1;
	}
	memory->slots++;
	return 0;
}

static int add_slots(struct cm_reader *reader, const struct packet *packet)
{
	int result = 0;

	for (uint32_t i = 0; i < packet->fd_count; i++) {
		if (reader->running)
			result |= map_slot(reader->memories, packet->fds[i]);
		else
			close(packet->fds[i]);
	}
	return result;
}

/* Tell the manager that a frame is not used any more. */
static int give_back(const struct cm_reader *reader, struct cm_plane_descriptor packet)
{
	packet.kind = CM_PLANE_RELEASE;
	return send(reader->fd, &packet, sizeof(packet), MSG_NOSIGNAL) < 0 ? -1 : 0;
}

static int lend(struct cm_reader *reader, const struct packet *packet, struct cm_frame *frame)
{
	const struct cm_plane_descriptor *head = &packet->head;
	struct cm_memory *memory = reader->memories;
	uint64_t room = reader->running ? memory->geometry.slot_length : 0;

	if (!reader->running || head->slot >= memory->slots || head->offset > room ||
	    head->length > room - head->offset) {
		errno = EPROTO;
		return -1;
	}
	if (reader->numbered)
		reader->lost += head->sequence - reader->expected;
	reader->numbered = true;
	reader->expected = head->sequence + 1;
	if (sync_slot(memory, head->slot, DMA_BUF_SYNC_START)) {
		int error = errno;

		give_back(reader, *head);
		errno = error;
		return -1;
	}
	memory->held++;
	memory->taken[head->slot] = true;
	*frame = (struct cm_frame){
		.data = (const char *)memory->map[head->slot] + head->offset,
		.length = head->length,
		.sequence = head->sequence,
		.timestamp_ns = head->timestamp_ns,
		.memory = memory,
		.descriptor = *head,
	};
	return 1;
}

static int refused(struct cm_reader *reader, const struct packet *packet)
{
	const char *code = packet->bytes + sizeof(packet->head);
	const char *end = packet->bytes + packet->size;
	const char *text = code + strlen(code) + 1;

	snprintf(reader->error, sizeof(reader->error), "%s: %s", code, text < end ? text : "");
	errno = EACCES;
	return -1;
}

/* 1 for a frame, 0 for anything else. */
static int take(struct cm_reader *reader, const struct packet *packet, struct cm_frame *frame)
{
	switch (packet->head.kind) {
	case CM_PLANE_FRAME:
		return lend(reader, packet, frame);
	case CM_PLANE_GEOMETRY:
		return begin(reader, packet);
	case CM_PLANE_SLOTS:
		return add_slots(reader, packet);
	case CM_PLANE_LABEL:
		read_mode(reader, packet->bytes + sizeof(packet->head),
			  packet->bytes + packet->size);
		return 0;
	case CM_PLANE_STOPPED:
		reader->running = false;
		sweep(reader);
		return 0;
	case CM_PLANE_REFUSED:
		return refused(reader, packet);
	default:
		return 0; /* of a newer manager */
	}
}

static int64_t now_ms(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* What is left of @timeout_ms, which began at @begun; packets that are no frames do not prolong it. */
static int left_ms(int timeout_ms, int64_t begun)
{
	int64_t gone = timeout_ms > 0 ? now_ms() - begun : 0;

	return gone < timeout_ms ? timeout_ms - (int)gone : timeout_ms < 0 ? -1 : 0;
}

int cm_reader_next(struct cm_reader *reader, int timeout_ms, struct cm_frame *frame)
{
	int64_t begun = now_ms();

	for (;;) {
		struct pollfd ready = { .fd = reader->fd, .events = POLLIN };
		struct packet packet;
		int result = poll(&ready, 1, left_ms(timeout_ms, begun));

		if (result <= 0)
			return result;
		result = receive(reader, &packet);
		if (!result)
			result = take(reader, &packet, frame);
		else if (errno == EAGAIN)
			result = 0;
		if (result)
			return result;
	}
}

int cm_reader_release(struct cm_reader *reader, struct cm_frame *frame)
{
	struct cm_memory *memory = frame->memory;
	struct cm_plane_descriptor packet = frame->descriptor;
	bool current = reader->running && memory == reader->memories;
	int result;

	if (!memory) {
		errno = EINVAL;
		return -1;
	}
	frame->memory = NULL;
	frame->data = NULL;
	result = sync_slot(memory, packet.slot, DMA_BUF_SYNC_END);
	memory->held--;
	memory->taken[packet.slot] = false;
	if (current && give_back(reader, packet))
		result = -1;
	sweep(reader);
	return result;
}

const struct cm_plane_geometry *cm_reader_geometry(const struct cm_reader *reader)
{
	return reader->running ? &reader->memories->geometry : NULL;
}

const char *cm_reader_mode(const struct cm_reader *reader)
{
	return reader->mode;
}

uint64_t cm_reader_lost(const struct cm_reader *reader)
{
	return reader->lost;
}

const char *cm_reader_error(const struct cm_reader *reader)
{
	return reader->error;
}
