/* SPDX-License-Identifier: GPL-2.0-only */
/* Completions waiting to be read; no locks, no allocation after the start. */
#ifndef _CM_QUEUE_H
#define _CM_QUEUE_H

#include <linux/types.h>

#include "cm_dma.h"

/**
 * struct cm_queue - completions between the engine and read()
 * @ring: @size entries
 * @size: one more than the transfers that may be outstanding, for the end of
 *        a cyclic transfer
 * @reserved: transfers under way that will need an entry
 * @head: entries ever put in
 * @tail: entries ever taken out or lost
 * @sequence: number of the next completion, lost ones included
 */
struct cm_queue {
	struct cm_dma_completion *ring;
	u32 size;
	u32 reserved;
	u64 head;
	u64 tail;
	u64 sequence;
};

void cm_queue_init(struct cm_queue *queue, struct cm_dma_completion *ring, u32 size);
u32 cm_queue_count(const struct cm_queue *queue);
int cm_queue_reserve(struct cm_queue *queue);
void cm_queue_unreserve(struct cm_queue *queue);
void cm_queue_push(struct cm_queue *queue, const struct cm_dma_completion *completion);
void cm_queue_push_cyclic(struct cm_queue *queue, const struct cm_dma_completion *completion,
			  u32 limit);
bool cm_queue_peek(const struct cm_queue *queue, u64 *index, struct cm_dma_completion *completion);
void cm_queue_drop(struct cm_queue *queue, u64 index);

#endif /* _CM_QUEUE_H */
