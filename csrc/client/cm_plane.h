/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reading streams of the configuration manager in C, without copies.
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
 * One thread at a time for each reader.  Functions return -1 or NULL and set errno.
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

/* Disconnect and unmap; frames that are held become invalid.  NULL is fine. */
void cm_reader_close(struct cm_reader *reader);

/* Descriptor that polls readable when cm_reader_next() has something to do; the reader's. */
int cm_reader_fd(const struct cm_reader *reader);

/**
 * cm_reader_next() - the next frame
 * @timeout_ms: to wait for a frame, 0: only look, -1: for ever
 *
 * Returns 1, or 0 if none came.  Errors: EACCES if the manager refused, see
 * cm_reader_error(); ECONNRESET if it has gone; EPROTO; EINTR.
 */
int cm_reader_next(struct cm_reader *reader, int timeout_ms, struct cm_frame *frame);

/* Give a frame back.  Errors: EINVAL if it was given back already, those of send(). */
int cm_reader_release(struct cm_reader *reader, struct cm_frame *frame);

/* Shape and type of what comes now; NULL while the stream is stopped. */
const struct cm_plane_geometry *cm_reader_geometry(const struct cm_reader *reader);

/* Name of the mode that frames are of now. */
const char *cm_reader_mode(const struct cm_reader *reader);

/* Frames that came while all that may be held were. */
uint64_t cm_reader_lost(const struct cm_reader *reader);

/* Why the manager refused: "code: sentence". */
const char *cm_reader_error(const struct cm_reader *reader);

#ifdef __cplusplus
}
#endif

#endif /* CM_PLANE_H */
