/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Streams of the configuration manager in C, without copies.
 *
 *	struct cm_reader *reader = cm_reader_open("/run/cm", "camera", 0);
 *	struct cm_frame frame;
 *
 *	while (cm_reader_next(reader, 1000, &frame) > 0) {
 *		... frame.data, frame.length ...
 *		cm_reader_release(reader, &frame);
 *	}
 *	cm_reader_close(reader);
 *
 *	struct cm_writer *writer = cm_writer_open("/run/cm", "to_pl", 0, NULL);
 *	struct cm_slot slot;
 *
 *	while (cm_writer_slot(writer, 1000, &slot) > 0) {
 *		... fill slot.data ...
 *		cm_writer_submit(writer, &slot, 0);
 *	}
 *	cm_writer_flush(writer, 1000);
 *	cm_writer_close(writer);
 *
 * One thread at a time for each reader or writer.  Functions return -1 or NULL and set errno.
 */
#ifndef CM_PLANE_H
#define CM_PLANE_H

#include <stddef.h>
#include <stdint.h>

#include "cm_plane_wire.h"

#ifdef __cplusplus
extern "C" {
#endif

struct cm_reader;
struct cm_writer;
struct cm_memory;

/**
 * struct cm_frame - a frame in DMA memory
 * @data: read only; valid until the frame is released or the reader closed
 * @length: bytes
 * @sequence: number in the stream: a gap is a loss
 * @timestamp_ns: CLOCK_MONOTONIC when the transfer had ended
 */
struct cm_frame {
	const void *data;
	size_t length;
	uint64_t sequence;
	uint64_t timestamp_ns;
	struct cm_memory *memory;	       /* the library's */
	struct cm_plane_descriptor descriptor; /* the library's */
};

/**
 * cm_reader_open() - connect to a stream
 * @runtime_dir: the manager's runtime folder
 * @depth: frames that may be held at a time, or 0 for the usual number
 *
 * Returns at once: a stream that is refused is told by cm_reader_next().
 * Errors: those of socket() and connect(), ENAMETOOLONG.
 */
struct cm_reader *cm_reader_open(const char *runtime_dir, const char *stream, unsigned int depth);

/**
 * cm_reader_open_leased() - the same with a lease
 * @lease: its id, where a client holds the stream's region and the stream has
 *         backpressure, so that its readers can hold the hardware up; or NULL
 */
struct cm_reader *cm_reader_open_leased(const char *runtime_dir, const char *stream,
					unsigned int depth, const char *lease);

/* Disconnect and unmap; frames that are held become invalid.  NULL is fine. */
void cm_reader_close(struct cm_reader *reader);

/* Descriptor that polls readable when cm_reader_next() has something to do; owned by the reader. */
int cm_reader_fd(const struct cm_reader *reader);

/**
 * cm_reader_next() - the next frame
 * @timeout_ms: to wait for a frame, 0: only look, -1: for ever
 *
 * Returns 1, or 0 if none came.  Errors: EACCES if the manager refused, see
 * cm_reader_error(); ECONNRESET if it has gone; EMFILE where this process has
 * no room for the slots' descriptors, and the reader is of no use then; EPROTO; EINTR.
 */
int cm_reader_next(struct cm_reader *reader, int timeout_ms, struct cm_frame *frame);

/* Give a frame back.  Errors: EINVAL if it was given back already, those of send(). */
int cm_reader_release(struct cm_reader *reader, struct cm_frame *frame);

/* Shape and type of present frames; NULL while the stream is stopped. */
const struct cm_plane_geometry *cm_reader_geometry(const struct cm_reader *reader);

/* Name of the mode of present frames. */
const char *cm_reader_mode(const struct cm_reader *reader);

/*
 * Generation of the registers under which the frame that cm_reader_next() gave last began, 0: not known.
 * One that is no smaller than that of a write (RegValues.generation in cm.proto) is a frame after it.
 */
uint64_t cm_reader_generation(const struct cm_reader *reader);

/* Frames missing between those that were read: the reader held as many as it may, or their transfer failed. */
uint64_t cm_reader_lost(const struct cm_reader *reader);

/* Why the manager refused: "code: sentence". */
const char *cm_reader_error(const struct cm_reader *reader);

/**
 * struct cm_slot - DMA memory to fill
 * @data: valid until the slot is submitted, put back, or the writer closed
 * @length: bytes that there are
 */
struct cm_slot {
	void *data;
	size_t length;
	struct cm_memory *memory;	       /* the library's */
	struct cm_plane_descriptor descriptor; /* the library's */
};

/**
 * cm_writer_open() - connect to a stream towards the hardware
 * @depth: slots that shall be the writer's own, or 0 for the usual number
 * @lease: id of one's own, where a client holds the stream's region; or NULL
 *
 * Returns at once: a stream that is refused is told by cm_writer_slot().
 * Errors: those of socket() and connect(), ENAMETOOLONG, EINVAL.
 */
struct cm_writer *cm_writer_open(const char *runtime_dir, const char *stream, unsigned int depth,
				 const char *lease);

/* Disconnect and unmap; frames already submitted are still sent.  NULL is fine. */
void cm_writer_close(struct cm_writer *writer);

/* Descriptor that polls readable when a slot may have become free; owned by the writer. */
int cm_writer_fd(const struct cm_writer *writer);

/**
 * cm_writer_slot() - a slot to fill
 * @timeout_ms: to wait for one, 0: only look, -1: for ever
 *
 * Returns 1, or 0 if none came free.  Errors: EACCES if the manager refused, see
 * cm_writer_error(); ECONNRESET if it has gone; EPROTO; EINTR; and, once, the
 * errno of an earlier frame that the hardware did not take (ECANCELED: the stream
 * was stopped before): call again.
 */
int cm_writer_slot(struct cm_writer *writer, int timeout_ms, struct cm_slot *slot);

/**
 * cm_writer_submit() - send a slot; it is the hardware's from here on
 * @length: bytes of it from its beginning on, or 0 for a whole frame
 *
 * On a stream with a stride only whole frames go, their lines @stride apart
 * (cm_writer_geometry()).  Errors: ECANCELED if the stream was stopped since
 * cm_writer_slot(), EINVAL for a slot that was given back already, those of send().
 */
int cm_writer_submit(struct cm_writer *writer, struct cm_slot *slot, size_t length);

/* Give a slot back unsent.  Errors: EINVAL if it was given back already. */
int cm_writer_put_back(struct cm_writer *writer, struct cm_slot *slot);

/* Wait until the hardware has taken all frames: 1, or 0 after @timeout_ms.  Errors: as cm_writer_slot(). */
int cm_writer_flush(struct cm_writer *writer, int timeout_ms);

/* Shape and type of frames to send; NULL before the first slot, and while the stream is stopped. */
const struct cm_plane_geometry *cm_writer_geometry(const struct cm_writer *writer);

/* Why the manager refused: "code: sentence". */
const char *cm_writer_error(const struct cm_writer *writer);

#ifdef __cplusplus
}
#endif

#endif /* CM_PLANE_H */
