// SPDX-License-Identifier: Apache-2.0
/* Readers. */
#include "cm_plane.h"

#include <errno.h>
#include <stdlib.h>
#include <sys/socket.h>

#include "cm_private.h"

struct cm_reader {
	struct connection connection;
	bool numbered;
	uint64_t expected;
	uint64_t lost;
};

struct cm_reader *cm_reader_open(const char *runtime_dir, const char *stream, unsigned int depth)
{
	return cm_reader_open_leased(runtime_dir, stream, depth, NULL);
}

struct cm_reader *cm_reader_open_leased(const char *runtime_dir, const char *stream,
					unsigned int depth, const char *lease)
{
	struct cm_plane_descriptor wanted = { .kind = CM_PLANE_OPEN, .slot = (uint16_t)depth };
	struct cm_reader *reader;

	if (depth > CM_PLANE_SLOTS_MAX) {
		errno = EINVAL;
		return NULL;
	}
	reader = calloc(1, sizeof(*reader));
	if (reader && connection_open(&reader->connection, runtime_dir, stream, &wanted, lease)) {
		int error = errno;

		free(reader);
		reader = NULL;
		errno = error;
	}
	return reader;
}

void cm_reader_close(struct cm_reader *reader)
{
	if (reader)
		connection_close(&reader->connection);
	free(reader);
}

int cm_reader_fd(const struct cm_reader *reader)
{
	return reader->connection.fd;
}

/* Tell the manager that a frame is not used any more. */
static int give_back(const struct cm_reader *reader, struct cm_plane_descriptor packet)
{
	packet.kind = CM_PLANE_RELEASE;
	return send(reader->connection.fd, &packet, sizeof(packet), MSG_NOSIGNAL) < 0 ? -1 : 0;
}

static int lend(struct cm_reader *reader, const struct cm_plane_descriptor *head,
		struct cm_frame *frame)
{
	struct cm_memory *memory = connection_memory(&reader->connection);
	uint64_t room = memory ? memory->geometry.slot_length : 0;

	if (!memory || head->slot >= memory->slots || head->offset > room ||
	    head->length > room - head->offset) {
		errno = EPROTO;
		return -1;
	}
	if (reader->numbered)
		reader->lost += head->sequence - reader->expected;
	reader->numbered = true;
	reader->expected = head->sequence + 1;
	if (memory_begin(memory, head->slot)) {
		int error = errno;

		give_back(reader, *head);
		errno = error;
		return -1;
	}
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

/* 1 for a frame, 0 for anything else. */
static int take(struct cm_reader *reader, const struct packet *packet, struct cm_frame *frame)
{
	if (packet->head.kind == CM_PLANE_FRAME)
		return lend(reader, &packet->head, frame);
	if (packet->head.kind == CM_PLANE_GEOMETRY)
		reader->numbered = false;
	return connection_take(&reader->connection, packet);
}

int cm_reader_next(struct cm_reader *reader, int timeout_ms, struct cm_frame *frame)
{
	int64_t begun = connection_now_ms();

	for (;;) {
		struct packet packet;
		int result = connection_wait(&reader->connection, timeout_ms, begun);

		if (result <= 0)
			return result;
		result = connection_receive(&reader->connection, &packet);
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
	int result;

	if (!memory) {
		errno = EINVAL;
		return -1;
	}
	frame->memory = NULL;
	frame->data = NULL;
	result = memory_end(memory, frame->descriptor.slot);
	if (memory == connection_memory(&reader->connection) &&
	    give_back(reader, frame->descriptor))
		result = -1;
	connection_sweep(&reader->connection);
	return result;
}

const struct cm_plane_geometry *cm_reader_geometry(const struct cm_reader *reader)
{
	const struct cm_memory *memory = connection_memory(&reader->connection);

	return memory ? &memory->geometry : NULL;
}

const char *cm_reader_mode(const struct cm_reader *reader)
{
	return reader->connection.mode;
}

uint64_t cm_reader_generation(const struct cm_reader *reader)
{
	return reader->connection.generation;
}

uint64_t cm_reader_lost(const struct cm_reader *reader)
{
	return reader->lost;
}

const char *cm_reader_error(const struct cm_reader *reader)
{
	return reader->connection.error;
}
