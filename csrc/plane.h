/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The local data plane: between the completions of DMA channels and the clients
 * on their sockets (client/cm_plane_wire.h).
 *
 * One thread does what each frame needs.  Who may connect, which streams there
 * are, and their memory, are the caller's affair.  Functions may be called from
 * any thread; they return -1 and set errno.  Streams and clients have numbers,
 * positive, not used again before 2^31 others; ENOENT for one that is gone.
 */
#ifndef CM_SHIM_PLANE_H
#define CM_SHIM_PLANE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "axidma.h"

struct cm_plane;

/* Make a plane and start its thread. */
struct cm_plane *cm_plane_new(void);

/* End the thread, disconnect all clients, stop all streams, and free; NULL is fine. */
void cm_plane_close(struct cm_plane *plane);

#define CM_PLANE_CLIENT_GONE 1	 /* it hung up, or broke the rules (error) */
#define CM_PLANE_STREAM_LOST 2	 /* its device failed (error); stop it */
#define CM_PLANE_CLIENT_LEAVES 3 /* it wants no more frames, but still holds some */

struct cm_plane_event {
	uint32_t kind;
	int32_t id;
	int32_t error;
};

/* Descriptor that polls readable when an event waits; owned by the plane. */
int cm_plane_event_fd(struct cm_plane *plane);

/* Take an event: 1, or 0 if there is none. */
int cm_plane_take(struct cm_plane *plane, struct cm_plane_event *event);

/**
 * struct cm_plane_setup - how a stream runs
 * @write: towards the hardware
 * @backpressure: readers lose nothing, the hardware waits for them
 * @cyclic: a written frame repeats until the next
 * @queue_depth: most transfers under way
 * @length: bytes of a slot, and of a transfer that is read
 * @lines, @line_bytes, @stride: a video frame instead, if @lines is not 0
 * @period_ns: frames that come sooner after each other are left out, 0: none
 * @lent: it has no memory, but so many transfers at most of its client's own bytes; with @write, whatever
 *        the channel's direction, and @length the most bytes of one
 * @address: without a channel: memory that its client's user may lend, as devices see it, 0: none
 */
struct cm_plane_setup {
	bool write;
	bool backpressure;
	bool cyclic;
	uint32_t queue_depth;
	uint64_t length;
	uint32_t lines;
	uint32_t line_bytes;
	uint32_t stride;
	uint64_t period_ns;
	uint32_t lent;
	uint64_t address;
};

/**
 * cm_plane_start() - a new stream
 * @dma: stays the caller's, who may close it after cm_plane_stop(); NULL: every
 *       written frame is done at once
 *
 * Returns its number.
 */
int cm_plane_start(struct cm_plane *plane, struct cm_dma *dma, const struct cm_plane_setup *setup);

/**
 * cm_plane_add_slot() - more memory for a stream
 * @fd: what clients get; stays the caller's, open until cm_plane_stop()
 * @handle: of the DMA channel
 *
 * Attached readers are told.  Returns the slot's number.  Errors: ENOSPC.
 */
int cm_plane_add_slot(struct cm_plane *plane, int stream, int fd, uint32_t handle);

/* Stop: no transfer is under way when it returns; clients are told, and stay connected. */
int cm_plane_stop(struct cm_plane *plane, int stream, int error);

/* Take over a connected socket as a client, of no stream yet.  Returns its number. */
int cm_plane_adopt(struct cm_plane *plane, int fd);

/**
 * cm_plane_attach() - a client is one of a stream's now
 * @depth: slots that a reader may hold, or that a writer gets
 * @packet: whole GEOMETRY packet, sent first
 *
 * Errors: EAGAIN where fewer than @depth slots are free for a writer.
 */
int cm_plane_attach(struct cm_plane *plane, int client, int stream, uint32_t depth,
		    const void *packet, size_t size);

/* Send a packet to all clients of a stream. */
int cm_plane_tell(struct cm_plane *plane, int stream, const void *packet, size_t size);

/**
 * cm_plane_settle() - take what clients have sent by now
 *
 * Who hung up before the call has gone when it returns; events tell, as ever.
 */
void cm_plane_settle(struct cm_plane *plane);

/**
 * cm_plane_wrote() - registers were written, and what was written is in effect
 * @generation: a number that grows; frames that begin from now on are of it
 *
 * Never waits for a device.
 */
void cm_plane_wrote(struct cm_plane *plane, uint64_t generation);

/* Hang up. */
int cm_plane_drop(struct cm_plane *plane, int client);

#define CM_PLANE_RECENT 64

/**
 * struct cm_plane_stats - what happened on a stream since its start
 * @frames: that came, or went, well
 * @dropped: frames × readers that did not get them
 * @errors: transfers that failed
 * @bytes: of the frames
 * @late: slots given back by a client that did not hold them
 * @held: slots that clients hold now
 * @queued: slots that the hardware has now
 * @idle: times that the hardware had no slot left after a frame
 * @error: errno of the last transfer that failed, 0: none has
 * @asked, @came: bytes that it was to move, and that the channel says it moved
 * @count: of the entries below that are valid, newest last
 * @at_ns: when recent frames came (CLOCK_MONOTONIC)
 * @latency_ns: from their completion until every client had them
 */
struct cm_plane_stats {
	uint64_t frames;
	uint64_t dropped;
	uint64_t errors;
	uint64_t bytes;
	uint64_t late;
	uint32_t held;
	uint32_t queued;
	uint32_t idle;
	int32_t error;
	uint32_t count;
	uint64_t asked;
	uint64_t came;
	uint64_t at_ns[CM_PLANE_RECENT];
	uint64_t latency_ns[CM_PLANE_RECENT];
};

int cm_plane_get_stats(struct cm_plane *plane, int stream, struct cm_plane_stats *stats);

/**
 * struct cm_plane_client_stats - one client, since it was attached to its stream
 * @frames: that it was lent, or that it sent and the hardware took
 * @dropped: that it did not get
 * @depth: slots that it may hold, or has to write to
 * @held: slots that it holds; of a writer, those that are under way
 */
struct cm_plane_client_stats {
	uint64_t frames;
	uint64_t dropped;
	uint32_t depth;
	uint32_t held;
};

int cm_plane_get_client_stats(struct cm_plane *plane, int client,
			      struct cm_plane_client_stats *stats);

#endif /* CM_SHIM_PLANE_H */
