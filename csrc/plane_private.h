/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Inside of the data plane: shared by plane.c, plane_stream.c and plane_client.c only. The three call each
 * other on purpose: a slot that a client gives back goes to its stream's hardware, a frame of a stream goes
 * to its clients, and both tell the plane. They are one state under one lock, cut by size, not by layer.
 */
#ifndef CM_SHIM_PLANE_PRIVATE_H
#define CM_SHIM_PLANE_PRIVATE_H

#include <pthread.h>
#include <stdatomic.h>

#include "client/cm_plane_wire.h"
#include "plane.h"

struct slot {
	int fd;		 /* what clients get */
	uint32_t handle; /* of the channel */
	uint32_t holders;
	bool queued;	  /* at the hardware, or waits for it */
	uint32_t outcome; /* of what is queued, if its stream ends now: 0, or errno */
	uint64_t ended_ns;
	uint64_t moved;			  /* bytes, by then */
	struct client *owner;		  /* a writer's */
	struct cm_plane_descriptor frame; /* what it holds, or carries */
	uint64_t generation;		  /* of the registers when that began */
};

#define IMPORTS_MAX 64 /* as many pieces of memory as a user may have */

/* Memory of a client, which the channel knows by a handle. */
struct import {
	int memory; /* the stream that has it */
	uint32_t handle;
};

struct stream {
	struct stream *next;
	struct cm_plane *plane;
	int id;
	uint8_t epoch;
	bool lost;   /* its device failed: nothing is queued any more */
	bool ending; /* nothing goes back to the hardware */
	struct cm_dma *dma;
	int event_fd;
	struct cm_plane_setup setup;
	uint32_t slots;
	struct slot slot[CM_PLANE_SLOTS_MAX];
	uint16_t waiting[CM_PLANE_SLOTS_MAX]; /* ring of slots that the hardware gets next */
	uint32_t first, count;
	uint32_t under_way;
	struct import import[IMPORTS_MAX];
	uint32_t imports;
	int cycling;	/* slot that repeats, or -1 */
	bool replacing; /* that slot is being cancelled, in another thread, for the next */
	bool aside;	/* there is a thread for it, to be joined */
	pthread_t replacer;
	bool announced; /* its writer knows that it does */
	uint64_t sequence;
	uint64_t generation; /* of the frame that comes next; 0: not known */
	uint64_t due_ns;
	uint64_t recent; /* entries ever written to the statistics */
	struct cm_plane_stats stats;
};

struct client {
	struct client *next;
	int id;
	int fd;
	struct stream *stream; /* or NULL */
	uid_t user;
	uint32_t depth;
	uint32_t held_count;
	uint64_t frames;     /* handed to it, or taken from it, well; since it was attached */
	uint64_t dropped;    /* that it did not get */
	uint64_t generation; /* that it was told last */
	uint64_t failed;     /* transfers of its stream, likewise */
	bool leaving;	     /* wants no more frames */
	bool broken;	     /* to be dropped */
	int error;
	bool held[CM_PLANE_SLOTS_MAX];
};

struct event {
	struct event *next;
	struct cm_plane_event event;
};

#define GENERATIONS_KEPT 256

/* A generation of the registers, and when what made it had been written. */
struct generation {
	uint64_t number;
	uint64_t done_ns;
};

struct generations {
	pthread_mutex_t
		lock; /* a separate one, so that a register write does not wait for a device */
	uint64_t latest;
	uint64_t count; /* entries ever made */
	struct generation recent[GENERATIONS_KEPT];
};

struct cm_plane {
	pthread_t thread;
	struct generations generations;
	pthread_mutex_t lock; /* of everything below */
	atomic_int callers;   /* that wait for the lock */
	int epoll_fd;
	int wake_fd; /* ends the thread */
	int event_fd;
	bool stopping;
	int last_id;
	uint8_t last_epoch;
	struct stream *streams;
	struct client *clients;
	struct event *events, **events_end;
};

/* All of these under the lock. */

int plane_thread(pthread_t *thread, void *(*start)(void *), void *argument);
void plane_report(struct cm_plane *plane, uint32_t kind, int id, int error);

void stream_completed(struct cm_plane *plane, struct stream *stream);
void stream_queue(struct cm_plane *plane, struct stream *stream, uint32_t number);

/*
 * The end of a stream, in this order: nothing is given to the hardware any more; what it has is
 * cancelled, without the lock; who uses the stream is told, and it is freed.
 */
void stream_stop_queueing(struct stream *stream);
void stream_cancel(struct stream *stream);
void stream_end(struct cm_plane *plane, struct stream *stream, int error);
struct stream *stream_find(struct cm_plane *plane, int id);

/* The channel's handle for @memory; -1 with errno. */
int stream_import(struct stream *stream, const struct stream *memory, uint32_t *handle);

/* Under its own lock: the latest generation that was there at @at_ns; @before if none newer is known. */
uint64_t generation_at(struct cm_plane *plane, uint64_t at_ns, uint64_t before);

/* Handle one packet; whether there may be more. */
bool client_readable(struct cm_plane *plane, struct client *client);
int client_send(struct client *client, const void *packet, size_t size);
int client_offer(struct client *client, const struct stream *stream, uint32_t number);
void client_grant(struct client *client, const struct stream *stream, const struct slot *slot);
int client_send_slots(struct client *client, const struct stream *stream, uint32_t first);
void client_detach(struct cm_plane *plane, struct client *client);
void client_break_off(struct client *client, int error);
void clients_reap(struct cm_plane *plane);
struct client *client_find(struct cm_plane *plane, int id);

#endif /* CM_SHIM_PLANE_PRIVATE_H */
