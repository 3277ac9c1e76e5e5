// SPDX-License-Identifier: Apache-2.0
/* Writers. */
#include <errno.h>
#include <stdlib.h>
#include <sys/socket.h>

#include "cm_plane.h"
#include "cm_private.h"

struct cm_writer {
	struct connection connection;
	struct cm_plane_descriptor free[CM_PLANE_SLOTS_MAX]; /* ours, to fill */
	uint32_t free_count;
	uint32_t under_way;
	uint64_t next;
	int failed; /* errno of a frame that was not taken, until it is reported */
};

struct cm_writer *cm_writer_open(const char *runtime_dir, const char *stream, unsigned int depth,
				 const char *lease)
{
	struct cm_plane_descriptor wanted = {
		.kind = CM_PLANE_OPEN,
		.flags = CM_PLANE_OPEN_WRITE,
		.slot = (uint16_t)depth,
	};
	struct cm_writer *writer;

	if (depth > CM_PLANE_SLOTS_MAX) {
		errno = EINVAL;
		return NULL;
	}
	writer = calloc(1, sizeof(*writer));
	if (writer && connection_open(&writer->connection, runtime_dir, stream, &wanted, lease)) {
		int error = errno;

		free(writer);
		writer = NULL;
		errno = error;
	}
	return writer;
}

void cm_writer_close(struct cm_writer *writer)
{
	if (writer)
		connection_close(&writer->connection);
	free(writer);
}

int cm_writer_fd(const struct cm_writer *writer)
{
	return writer->connection.fd;
}

static void keep(struct cm_writer *writer, const struct cm_plane_descriptor *slot)
{
	const struct cm_memory *memory = connection_memory(&writer->connection);

	if (memory && slot->flags == memory->epoch && slot->slot < memory->slots &&
	    writer->free_count < CM_PLANE_SLOTS_MAX)
		writer->free[writer->free_count++] = *slot;
}

/* A slot is ours again when its frame was taken, unless the hardware repeats it. */
static void done(struct cm_writer *writer, const struct cm_plane_descriptor *head)
{
	const struct cm_memory *memory = connection_memory(&writer->connection);
	bool repeats = memory && (memory->geometry.flags & CM_PLANE_CYCLIC);

	if (writer->under_way)
		writer->under_way--;
	if (head->offset && !writer->failed)
		writer->failed = (int)head->offset;
	if (head->offset || !repeats)
		keep(writer, head);
}

static int take(struct cm_writer *writer, const struct packet *packet)
{
	switch (packet->head.kind) {
	case CM_PLANE_GRANT:
		keep(writer, &packet->head);
		return 0;
	case CM_PLANE_DONE:
		done(writer, &packet->head);
		return 0;
	case CM_PLANE_STOPPED:
	case CM_PLANE_GEOMETRY:
		writer->free_count = 0;
		break;
	default:
		break;
	}
	return connection_take(&writer->connection, packet);
}

/* Take all waiting packets. */
static int drain(struct cm_writer *writer)
{
	struct packet packet;

	while (!connection_receive(&writer->connection, &packet))
		if (take(writer, &packet))
			return -1;
	return errno == EAGAIN ? 0 : -1;
}

static bool has_slot(const struct cm_writer *writer)
{
	return writer->free_count > 0;
}

static bool is_idle(const struct cm_writer *writer)
{
	return !writer->under_way;
}

/* Wait until @ready: 1, 0 when the time is over, -1 also, once, for a frame that failed. */
static int wait_until(struct cm_writer *writer, bool (*ready)(const struct cm_writer *),
		      int timeout_ms)
{
	int64_t begun = connection_now_ms();

	for (;;) {
		int result;

		if (drain(writer))
			return -1;
		if (writer->failed) {
			errno = writer->failed;
			writer->failed = 0;
			return -1;
		}
		if (ready(writer))
			return 1;
		result = connection_wait(&writer->connection, timeout_ms, begun);
		if (result <= 0)
			return result;
	}
}

int cm_writer_slot(struct cm_writer *writer, int timeout_ms, struct cm_slot *slot)
{
	int result = wait_until(writer, has_slot, timeout_ms);
	const struct cm_plane_descriptor *granted;
	struct cm_memory *memory;

	if (result <= 0)
		return result;
	memory = connection_memory(&writer->connection);
	granted = &writer->free[writer->free_count - 1];
	if (memory_begin(memory, granted->slot))
		return -1;
	writer->free_count--;
	*slot = (struct cm_slot){
		.data = memory->map[granted->slot],
		.length = memory->geometry.slot_length,
		.memory = memory,
		.descriptor = *granted,
	};
	return 1;
}

/* Take a slot from the caller; returns whether it belongs to the stream as it runs now. */
static int hand_over(struct cm_writer *writer, struct cm_slot *slot)
{
	struct cm_memory *memory = slot->memory;
	int result;

	if (!memory) {
		errno = EINVAL;
		return -1;
	}
	slot->memory = NULL;
	slot->data = NULL;
	result = memory_end(memory, slot->descriptor.slot);
	if (!result && memory != connection_memory(&writer->connection)) {
		errno = ECANCELED;
		result = -1;
	}
	connection_sweep(&writer->connection);
	return result;
}

static size_t whole(const struct cm_plane_geometry *geometry)
{
	return geometry->frame_length ? geometry->frame_length : geometry->slot_length;
}

int cm_writer_submit(struct cm_writer *writer, struct cm_slot *slot, size_t length)
{
	struct cm_plane_descriptor packet = slot->descriptor;

	if (hand_over(writer, slot))
		return -1;
	packet.kind = CM_PLANE_SUBMIT;
	packet.offset = 0;
	packet.length = length ? length : whole(&writer->connection.memories->geometry);
	packet.sequence = writer->next++;
	if (send(writer->connection.fd, &packet, sizeof(packet), MSG_NOSIGNAL) < 0)
		return -1;
	writer->under_way++;
	return 0;
}

int cm_writer_put_back(struct cm_writer *writer, struct cm_slot *slot)
{
	struct cm_plane_descriptor granted = slot->descriptor;

	if (hand_over(writer, slot))
		return errno == ECANCELED ? 0 : -1;
	keep(writer, &granted);
	return 0;
}

int cm_writer_flush(struct cm_writer *writer, int timeout_ms)
{
	return wait_until(writer, is_idle, timeout_ms);
}

const struct cm_plane_geometry *cm_writer_geometry(const struct cm_writer *writer)
{
	const struct cm_memory *memory = connection_memory(&writer->connection);

	return memory ? &memory->geometry : NULL;
}

const char *cm_writer_error(const struct cm_writer *writer)
{
	return writer->connection.error;
}
