// SPDX-License-Identifier: Apache-2.0
#include <errno.h>
#include <fcntl.h>
#include <linux/dma-buf.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include "cm_private.h"

/* Through the folder's descriptor, because the name of a socket is limited to 107 bytes. */
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

/* The stream's name and, behind a NUL, the lease's id. */
static int ask(int sock, const char *stream, const struct cm_plane_descriptor *wanted,
	       const char *lease)
{
	char packet[sizeof(*wanted) + 512];
	size_t room = sizeof(packet) - sizeof(*wanted);
	int length = snprintf(packet + sizeof(*wanted), room, "%s%c%s", stream, 0, lease);

	if (length < 0 || (size_t)length >= room) {
		errno = ENAMETOOLONG;
		return -1;
	}
	memcpy(packet, wanted, sizeof(*wanted));
	if (!*lease)
		length--; /* the name alone, without the NUL */
	return send(sock, packet, sizeof(*wanted) + (size_t)length, MSG_NOSIGNAL) < 0 ? -1 : 0;
}

int connection_open(struct connection *connection, const char *folder, const char *stream,
		    const struct cm_plane_descriptor *wanted, const char *lease)
{
	connection->fd = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
	if (connection->fd >= 0 && !connect_in(connection->fd, folder) &&
	    !ask(connection->fd, stream, wanted, lease ? lease : ""))
		return 0;
	connection_close(connection);
	return -1;
}

static int sync_slot(const struct cm_memory *memory, uint32_t slot, uint64_t when)
{
	bool writes = memory->geometry.flags & CM_PLANE_WRITABLE;
	struct dma_buf_sync sync = { .flags = when |
					      (writes ? DMA_BUF_SYNC_RW : DMA_BUF_SYNC_READ) };
	int result;

	if (memory->fd[slot] < 0)
		return 0;
	do {
		result = ioctl(memory->fd[slot], DMA_BUF_IOCTL_SYNC, &sync);
	} while (result && (errno == EINTR || errno == EAGAIN));
	return result && errno == ENOTTY ? 0 : result; /* ordinary memory */
}

int memory_begin(struct cm_memory *memory, uint32_t slot)
{
	if (sync_slot(memory, slot, DMA_BUF_SYNC_START))
		return -1;
	memory->held++;
	memory->taken[slot] = true;
	return 0;
}

int memory_end(struct cm_memory *memory, uint32_t slot)
{
	memory->held--;
	memory->taken[slot] = false;
	return sync_slot(memory, slot, DMA_BUF_SYNC_END);
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

void connection_sweep(struct connection *connection)
{
	struct cm_memory **link = &connection->memories;

	if (connection->running)
		link = &connection->memories->next;
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

void connection_close(struct connection *connection)
{
	int error = errno;

	while (connection->memories) {
		struct cm_memory *memory = connection->memories;

		connection->memories = memory->next;
		free_memory(memory);
	}
	if (connection->fd >= 0)
		close(connection->fd);
	connection->fd = -1;
	errno = error;
}

void packet_close(const struct packet *packet)
{
	for (uint32_t i = 0; i < packet->fd_count; i++)
		close(packet->fds[i]);
}

int connection_receive(const struct connection *connection, struct packet *packet)
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
	ssize_t got = recvmsg(connection->fd, &message, MSG_CMSG_CLOEXEC | MSG_DONTWAIT);
	struct cmsghdr *header = got < 0 ? NULL : CMSG_FIRSTHDR(&message);

	packet->fd_count = 0;
	if (header && header->cmsg_level == SOL_SOCKET && header->cmsg_type == SCM_RIGHTS) {
		packet->fd_count = (uint32_t)((header->cmsg_len - CMSG_LEN(0)) / sizeof(int));
		memcpy(packet->fds, CMSG_DATA(header), packet->fd_count * sizeof(int));
	}
	if (got < 0)
		return -1;
	if (message.msg_flags & (MSG_CTRUNC | MSG_TRUNC)) {
		/* descriptors that this process has no room for are gone: its slots would not be those
		 * of the manager */
		packet_close(packet);
		errno = message.msg_flags & MSG_CTRUNC ? EMFILE : EPROTO;
		return -1;
	}
	packet->size = (size_t)got;
	packet->bytes[got] = '\0';
	if (packet->size >= sizeof(packet->head)) {
		if (packet->head.kind != CM_PLANE_SLOTS && packet->head.kind != CM_PLANE_WINDOW) {
			packet_close(packet); /* nobody would look for them there */
			packet->fd_count = 0;
		}
		return 0;
	}
	packet_close(packet);
	errno = got ? EPROTO : ECONNRESET;
	return -1;
}

static void read_mode(struct connection *connection, const char *names, const char *end)
{
	for (int skip = 0; skip < 2 && names < end; skip++)
		names += strlen(names) + 1;
	snprintf(connection->mode, sizeof(connection->mode), "%s", names < end ? names : "");
}

static int begin(struct connection *connection, const struct packet *packet)
{
	size_t fixed = sizeof(packet->head) + sizeof(struct cm_plane_geometry);
	struct cm_plane_geometry geometry = { .dimensions = UINT32_MAX };
	struct cm_memory *memory;

	if (packet->size >= fixed)
		memcpy(&geometry, packet->bytes + sizeof(packet->head), sizeof(geometry));
	if (geometry.dimensions > CM_PLANE_DIMENSIONS ||
	    !memchr(geometry.dtype, 0, sizeof(geometry.dtype))) {
		errno = EPROTO;
		return -1;
	}
	memory = calloc(1, sizeof(*memory));
	if (!memory)
		return -1;
	memory->geometry = geometry;
	memory->epoch = packet->head.flags;
	memory->next = connection->memories;
	connection->memories = memory;
	connection->running = true;
	connection->generation = 0;
	read_mode(connection, packet->bytes + fixed, packet->bytes + packet->size);
	connection_sweep(connection);
	return 0;
}

/* An access behind the end of what is mapped would end this process with SIGBUS. */
static void *map_whole(int fd, uint64_t length, int protection)
{
	off_t there = lseek(fd, 0, SEEK_END); /* fstat() says nothing of a DMA buffer */

	if (there < 0 || length > (uint64_t)there || length != (size_t)length) {
		errno = EPROTO;
		return MAP_FAILED;
	}
	return mmap(NULL, (size_t)length, protection, MAP_SHARED | MAP_POPULATE, fd, 0);
}

static int map_slot(struct cm_memory *memory, int fd)
{
	uint32_t number = memory->slots;
	bool writes = memory->geometry.flags & CM_PLANE_WRITABLE;
	void *map =
		map_whole(fd, memory->geometry.slot_length, PROT_READ | (writes ? PROT_WRITE : 0));

	if (map == MAP_FAILED) {
		int error = errno;

		close(fd);
		errno = error;
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

static int add_slots(struct connection *connection, const struct packet *packet)
{
	struct cm_memory *memory = connection->memories;
	uint32_t i;

	if (!connection->running) {
		packet_close(packet);
		return 0;
	}
	/* frames refer to slots by number: with one missing, every later number would be wrong */
	if (packet->head.slot != memory->slots || packet->head.offset != packet->fd_count ||
	    packet->fd_count > CM_PLANE_SLOTS_MAX - memory->slots) {
		packet_close(packet);
		errno = EPROTO;
		return -1;
	}
	for (i = 0; i < packet->fd_count && !map_slot(memory, packet->fds[i]); i++)
		;
	if (i == packet->fd_count)
		return 0;
	while (++i < packet->fd_count)
		close(packet->fds[i]);
	return -1;
}

static int refused(struct connection *connection, const struct packet *packet)
{
	const char *code = packet->bytes + sizeof(packet->head);
	const char *end = packet->bytes + packet->size;
	const char *text = code + strlen(code) + 1;

	snprintf(connection->error, sizeof(connection->error), "%s: %s", code,
		 text < end ? text : "");
	errno = EACCES;
	return -1;
}

static void stop(struct connection *connection)
{
	connection->running = false;
	connection_sweep(connection);
}

int connection_take(struct connection *connection, const struct packet *packet)
{
	switch (packet->head.kind) {
	case CM_PLANE_GEOMETRY:
		return begin(connection, packet);
	case CM_PLANE_SLOTS:
		return add_slots(connection, packet);
	case CM_PLANE_LABEL:
		read_mode(connection, packet->bytes + sizeof(packet->head),
			  packet->bytes + packet->size);
		return 0;
	case CM_PLANE_GENERATION:
		connection->generation = packet->head.sequence;
		return 0;
	case CM_PLANE_STOPPED:
		stop(connection);
		return 0;
	case CM_PLANE_REFUSED:
		return refused(connection, packet);
	default:
		packet_close(packet); /* of a newer manager */
		return 0;
	}
}

int64_t connection_now_ms(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* The rest of @timeout_ms, counted from @begun; packets that are not frames do not prolong it. */
static int left_ms(int timeout_ms, int64_t begun)
{
	int64_t gone = timeout_ms > 0 ? connection_now_ms() - begun : 0;

	return gone < timeout_ms ? timeout_ms - (int)gone : timeout_ms < 0 ? -1 : 0;
}

int connection_wait(const struct connection *connection, int timeout_ms, int64_t begun)
{
	struct pollfd ready = { .fd = connection->fd, .events = POLLIN };

	return poll(&ready, 1, left_ms(timeout_ms, begun));
}

struct cm_memory *connection_memory(const struct connection *connection)
{
	return connection->running ? connection->memories : NULL;
}
