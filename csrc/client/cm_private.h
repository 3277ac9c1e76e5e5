/* SPDX-License-Identifier: Apache-2.0 */
/* Inside of the library: what readers, writers and windows have in common. */
#ifndef CM_PLANE_PRIVATE_H
#define CM_PLANE_PRIVATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "cm_plane_wire.h"

#pragma GCC visibility push(hidden)

/* The slots of one geometry; stays until the caller has given back the last of them. */
struct cm_memory {
	struct cm_memory *next;
	struct cm_plane_geometry geometry;
	uint8_t epoch;
	uint32_t slots;
	uint32_t held; /* by the caller */
	void *map[CM_PLANE_SLOTS_MAX];
	int fd[CM_PLANE_SLOTS_MAX]; /* kept where the memory needs synchronising, else -1 */
	bool taken[CM_PLANE_SLOTS_MAX];
};

struct connection {
	int fd;
	struct cm_memory *memories; /* the first is that of what comes now, if @running */
	bool running;
	uint64_t generation; /* of the frame that came last */
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

/* Connect and say what is wanted; on an error nothing is left open. */
int connection_open(struct connection *connection, const char *folder, const char *stream,
		    const struct cm_plane_descriptor *wanted, const char *lease);
void connection_close(struct connection *connection);

/* Take a waiting packet: EAGAIN if there is none, ECONNRESET at the connection's end. */
int connection_receive(const struct connection *connection, struct packet *packet);

/* Close what came with a packet. */
void packet_close(const struct packet *packet);

/* Handle geometry, slots, names, stops and refusals; ignore all else. */
int connection_take(struct connection *connection, const struct packet *packet);

/* Wait for a packet: 1, or 0 when @timeout_ms, counted from @begun, are over. */
int connection_wait(const struct connection *connection, int timeout_ms, int64_t begun);

int64_t connection_now_ms(void);

/* Memory of present frames; NULL while the stream is stopped. */
struct cm_memory *connection_memory(const struct connection *connection);

/* Unmap memory that is no longer in use by the stream, and of which nothing is held. */
void connection_sweep(struct connection *connection);

/* The caller gets a slot, or gives it up: synchronise the processor's cache. */
int memory_begin(struct cm_memory *memory, uint32_t slot);
int memory_end(struct cm_memory *memory, uint32_t slot);

struct cm_register;

/* A register, or a field of one, in a Config message, its @offset from address 0.  Errors: ENOENT, EPROTO. */
int table_find(const char *table, size_t size, const char *name, struct cm_register *found);

#pragma GCC visibility pop

#endif /* CM_PLANE_PRIVATE_H */
