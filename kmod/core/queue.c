// SPDX-License-Identifier: GPL-2.0-only
/* Completions waiting to be read.  The callers hold a lock. */
#include <linux/errno.h>
#include <linux/kernel.h>
#include <linux/math64.h>
#include <linux/string.h>

#include "queue.h"

static struct cm_dma_completion *entry(const struct cm_queue *queue, u64 index)
{
	u32 slot;

	div_u64_rem(index, queue->size, &slot);
	return &queue->ring[slot];
}

/**
 * cm_queue_init() - an empty queue
 * @queue: queue
 * @ring: memory for @size entries
 * @size: most outstanding transfers, plus one
 */
void cm_queue_init(struct cm_queue *queue, struct cm_dma_completion *ring, u32 size)
{
	memset(queue, 0, sizeof(*queue));
	queue->ring = ring;
	queue->size = size;
}

/**
 * cm_queue_count() - completions that wait
 * @queue: queue
 *
 * Return: the number.
 */
u32 cm_queue_count(const struct cm_queue *queue)
{
	return queue->head - queue->tail;
}

/**
 * cm_queue_reserve() - keep an entry for a transfer about to start
 * @queue: queue
 *
 * Return: 0, or -EBUSY when all are taken.
 */
int cm_queue_reserve(struct cm_queue *queue)
{
	if (cm_queue_count(queue) + queue->reserved >= queue->size - 1)
		return -EBUSY;
	queue->reserved++;
	return 0;
}

/**
 * cm_queue_unreserve() - the transfer did not start
 * @queue: queue
 */
void cm_queue_unreserve(struct cm_queue *queue)
{
	queue->reserved--;
}

static void lose_oldest(struct cm_queue *queue)
{
	queue->tail++;
	if (cm_queue_count(queue))
		entry(queue, queue->tail)->flags |= CM_DMA_COMPLETION_OVERRUN;
}

static void put(struct cm_queue *queue, const struct cm_dma_completion *completion)
{
	struct cm_dma_completion *slot = entry(queue, queue->head);

	*slot = *completion;
	slot->sequence = queue->sequence++;
	queue->head++;
}

/**
 * cm_queue_push() - the last completion of a transfer
 * @queue: queue; an entry was reserved
 * @completion: its sequence is filled in
 */
void cm_queue_push(struct cm_queue *queue, const struct cm_dma_completion *completion)
{
	struct cm_dma_completion last = *completion;

	queue->reserved--;
	if (cm_queue_count(queue) == queue->size) {
		lose_oldest(queue);
		if (!cm_queue_count(queue))
			last.flags |= CM_DMA_COMPLETION_OVERRUN;
	}
	put(queue, &last);
}

/**
 * cm_queue_push_cyclic() - one period of a cyclic transfer
 * @queue: queue
 * @completion: its sequence is filled in
 * @limit: most completions whose data the hardware has not overwritten yet
 *
 * Where more wait, the oldest is lost, and the next one says so.
 */
void cm_queue_push_cyclic(struct cm_queue *queue, const struct cm_dma_completion *completion,
			  u32 limit)
{
	struct cm_dma_completion period = *completion;
	bool lost = false;

	limit = clamp(limit, 1U, queue->size - 1);
	while (cm_queue_count(queue) >= limit) {
		lose_oldest(queue);
		lost = true;
	}
	if (lost && !cm_queue_count(queue))
		period.flags |= CM_DMA_COMPLETION_OVERRUN;
	put(queue, &period);
}

/**
 * cm_queue_peek() - look at the oldest completion
 * @queue: queue
 * @index: filled in, for cm_queue_drop()
 * @completion: filled in
 *
 * Return: false if there is none.
 */
bool cm_queue_peek(const struct cm_queue *queue, u64 *index, struct cm_dma_completion *completion)
{
	if (!cm_queue_count(queue))
		return false;
	*index = queue->tail;
	*completion = *entry(queue, queue->tail);
	return true;
}

/**
 * cm_queue_drop() - a completion was read
 * @queue: queue
 * @index: from cm_queue_peek(); nothing happens if it was lost meanwhile
 */
void cm_queue_drop(struct cm_queue *queue, u64 index)
{
	if (queue->tail == index)
		queue->tail++;
}
