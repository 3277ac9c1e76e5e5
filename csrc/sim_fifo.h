/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The simulated board's fast path: two DMA channels joined by a small FIFO.
 *
 * A thread answers plain submits on the connections of a memory-to-stream and a
 * stream-to-memory channel, moves the bytes and sends the completions, as the
 * board itself does in Python (cm/simulation/software/hardware/links.py) and with the same effect.  It
 * is lent both channels, and parks as soon as something comes that is not a
 * plain submit, which it leaves where it is: the board then has both channels
 * back and goes on.
 *
 * A frame goes through the FIFO piece by piece, so that its bytes are read from
 * memory once and written once; only the FIFO itself stays in the cache.
 */
#ifndef CM_SIM_FIFO_H
#define CM_SIM_FIFO_H

#include <stdbool.h>
#include <stdint.h>

#include "cm_dma.h"

#define CM_SIM_QUEUE 64 /* transfers of a channel under way, as the board's */

struct cm_sim_buffer {
	uint8_t *memory;
	uint64_t length;
	uint32_t handle;
	uint32_t reserved;
};

struct cm_sim_transfer {
	uint64_t offset;
	uint64_t length;
	uint64_t cookie;
	uint32_t handle;
	uint32_t reserved;
};

/* A channel as it is lent and given back. */
struct cm_sim_channel {
	int32_t request_fd;		     /* our end of the connection; stays the board's */
	int32_t event_fd;		     /* our end of its event socket; stays the board's */
	const struct cm_sim_buffer *buffers; /* those that the channel may use */
	uint32_t buffer_count;
	uint32_t packet_cost; /* of a completion in a socket's send queue, bytes */
	uint64_t sent;	      /* completions */
	uint64_t read;	      /* of them, known to be read by the client */
	uint64_t sequence;
	uint64_t moved; /* bytes */
	uint32_t first; /* of the ring of transfers */
	uint32_t count;
	struct cm_sim_transfer queue[CM_SIM_QUEUE];
	bool owed; /* the last submit was taken, its reply was not: the client's queue is full */
	struct cm_dma_submit owed_submit;
};

struct cm_sim_fifo;

/* Make one and start its thread, parked. */
struct cm_sim_fifo *cm_sim_fifo_new(void);

/* Park, end the thread, free; NULL is fine. */
void cm_sim_fifo_close(struct cm_sim_fifo *fifo);

/* Descriptor that polls readable once the thread has parked by itself; the FIFO's. */
int cm_sim_fifo_event_fd(struct cm_sim_fifo *fifo);

/*
 * Lend both channels, with all that they refer to, until cm_sim_fifo_park().
 * EBUSY: it runs already.
 */
int cm_sim_fifo_run(struct cm_sim_fifo *fifo, struct cm_sim_channel *source,
		    struct cm_sim_channel *sink);

/* Take them back, after the frame that is being moved; harmless if they are back already. */
void cm_sim_fifo_park(struct cm_sim_fifo *fifo);

#endif /* CM_SIM_FIFO_H */
