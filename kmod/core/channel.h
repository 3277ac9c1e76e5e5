/* SPDX-License-Identifier: GPL-2.0-only */
/* What the parts of a channel know of each other. */
#ifndef _CM_CHANNEL_H
#define _CM_CHANNEL_H

#include "cm_core.h"
#include "engine.h"

/**
 * struct cm_active - a request under way
 * @node: in the channel's list
 * @channel: channel
 * @request: as given; its buffer is referenced
 * @address: of the first byte, for the device
 * @readable: for its results
 * @fed: transfers of it that the engine was given
 * @done: those of them that ended
 * @length: of a frame that is over
 * @status: of a frame that is over
 */
struct cm_active {
	struct list_head node;
	struct cm_channel *channel;
	struct cm_request request;
	dma_addr_t address;
	u32 readable;
	u64 fed;
	u64 done;
	u64 length;
	int status;
};

/* buffer.c: for what may sleep, or take long */
extern struct workqueue_struct *cm_dma_workqueue;

/* transfer.c */
int cm_channel_feed(struct cm_channel *channel, struct cm_active *own);
void cm_active_free(struct cm_active *active);
void cm_active_finish(struct cm_active *active, u64 length, int status);

/* stop.c */
void cm_channel_stop(struct cm_channel *channel);
void cm_channel_settle(struct work_struct *work);
void cm_channel_watch(struct work_struct *work);
void cm_channel_look(struct cm_channel *channel, unsigned long delay);

#endif /* _CM_CHANNEL_H */
