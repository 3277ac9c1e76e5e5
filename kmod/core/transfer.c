// SPDX-License-Identifier: GPL-2.0-only
/*
 * Requests as transfers of an engine: given to it as it can take them, and
 * told when they end.
 *
 * A request is one transfer.  A cyclic one is a transfer for each period where
 * the engine does not tell periods of a cyclic transfer of its own.
 */
#include <linux/ktime.h>
#include <linux/math64.h>
#include <linux/slab.h>

#include "channel.h"

static void active_done(void *param, const struct dmaengine_result *result);

static enum dma_transfer_direction engine_direction(const struct cm_channel *channel)
{
	return channel->info.direction == CM_DMA_MM2S ? DMA_MEM_TO_DEV : DMA_DEV_TO_MEM;
}

/* engines have no cyclic video transfer: the same frame again */
static bool repeats(const struct cm_active *active)
{
	return active->request.cyclic &&
	       (active->request.lines || !active->channel->traits->own_cyclic);
}

/**
 * cm_active_free() - a request is under way no more
 * @active: request, in no list
 */
void cm_active_free(struct cm_active *active)
{
	atomic_dec(&active->request.buffer->in_flight);
	cm_buffer_put_atomic(active->request.buffer);
	kfree(active);
}

static struct cm_result result_of(const struct cm_active *active, u64 length, int status, bool last)
{
	return (struct cm_result){
		.cookie = active->request.cookie,
		.length = length,
		.timestamp_ns = ktime_get_ns(),
		.status = status,
		.readable = active->readable,
		.last = last,
	};
}

/* what of the buffer the engine wrote, or may have written */
static void note_written(const struct cm_active *active, u64 offset, u64 length)
{
	if (active->channel->info.direction == CM_DMA_S2MM)
		cm_buffer_written(active->request.buffer, active->request.offset + offset, length);
}

/**
 * cm_active_finish() - tell the end of a request
 * @active: request, in no list; freed
 * @length: bytes moved
 * @status: 0 or a negative errno
 */
void cm_active_finish(struct cm_active *active, u64 length, int status)
{
	struct cm_result result = result_of(active, length, status, true);
	struct cm_request request = active->request;

	if (status || request.lines || request.cyclic)
		length = cm_request_footprint(&request);
	note_written(active, 0, length);
	/* in this order: a client told of the end may free the buffer at once */
	cm_active_free(active);
	request.done(request.context, &result);
}

static void active_period(struct cm_active *active, u64 length, int status)
{
	struct cm_result result = result_of(active, length, status, false);
	const struct cm_request *request = &active->request;
	u64 number;

	if (repeats(active) && !request->lines) {
		/* a period that has just ended */
		div64_u64_rem(active->done - 1, div64_u64(request->length, request->period),
			      &number);
		note_written(active, number * request->period, request->period);
	} else {
		note_written(active, 0, cm_request_footprint(request));
	}
	active->request.done(active->request.context, &result);
}

static struct dma_async_tx_descriptor *prepare_video(struct cm_channel *channel,
						     const struct cm_active *active)
{
	const struct cm_request *request = &active->request;
	struct dma_async_tx_descriptor *tx;
	struct dma_interleaved_template *template;
	bool to_device = channel->info.direction == CM_DMA_MM2S;

	template = kzalloc(struct_size(template, sgl, 1), GFP_ATOMIC);
	if (!template)
		return NULL;
	template->dir = engine_direction(channel);
	template->src_start = to_device ? active->address : 0;
	template->dst_start = to_device ? 0 : active->address;
	template->src_inc = to_device;
	template->src_sgl = to_device;
	template->dst_inc = !to_device;
	template->dst_sgl = !to_device;
	template->numf = request->lines;
	template->frame_size = 1;
	template->sgl[0].size = request->line_bytes;
	template->sgl[0].icg = request->stride - request->line_bytes;
	tx = dmaengine_prep_interleaved_dma(channel->chan, template,
					    DMA_PREP_INTERRUPT | DMA_CTRL_ACK);
	kfree(template);
	return tx;
}

static struct dma_async_tx_descriptor *prepare(struct cm_channel *channel,
					       const struct cm_active *active)
{
	const struct cm_request *request = &active->request;
	enum dma_transfer_direction direction = engine_direction(channel);
	unsigned long flags = DMA_PREP_INTERRUPT | DMA_CTRL_ACK;
	u64 periods, number;

	if (request->lines)
		return prepare_video(channel, active);
	if (!request->cyclic)
		return dmaengine_prep_slave_single(channel->chan, active->address,
						   request->length, direction, flags);
	if (channel->traits->own_cyclic)
		return dmaengine_prep_dma_cyclic(channel->chan, active->address, request->length,
						 request->period, direction, flags);
	periods = div64_u64(request->length, request->period);
	div64_u64_rem(active->fed, periods, &number);
	return dmaengine_prep_slave_single(channel->chan,
					   active->address + number * request->period,
					   request->period, direction, flags);
}

static int start_locked(struct cm_channel *channel, struct cm_active *active)
{
	struct dma_async_tx_descriptor *tx = prepare(channel, active);

	if (!tx)
		return -ENOMEM;
	tx->callback_result = active_done;
	tx->callback_param = active;
	if (dma_submit_error(dmaengine_submit(tx)))
		return -EIO;
	active->fed++;
	channel->in_engine++;
	dma_async_issue_pending(channel->chan);
	cm_traits_tell(channel->traits, true);
	return 0;
}

/* the first request of which the engine may be given something */
static struct cm_active *next_locked(struct cm_channel *channel)
{
	struct cm_active *active;

	if (channel->stopping || channel->over || channel->in_engine >= channel->traits->ahead)
		return NULL;
	list_for_each_entry(active, &channel->active, node) {
		if (!active->fed)
			return active;
		/* one frame of video at a time: it is the same memory */
		if (repeats(active) && active->fed - active->done < (active->request.lines ? 1 : 2))
			return active;
	}
	return NULL;
}

/*
 * What could not be started goes to @failed.  An engine that has stopped gets
 * nothing: its driver would count the transfer that failed as done.
 */
static void feed_locked(struct cm_channel *channel, struct list_head *failed)
{
	struct cm_active *active;
	unsigned long wait = HZ / 10;
	int ret;

	while ((active = next_locked(channel))) {
		if (cm_traits_failed(channel->traits)) {
			wait = 0;
			break;
		}
		ret = start_locked(channel, active);
		if (!ret)
			continue;
		/* the end of what the engine has of it tries again */
		if (active->fed != active->done)
			break;
		active->status = ret;
		list_move_tail(&active->node, failed);
	}
	if (channel->in_engine || !wait)
		cm_channel_look(channel, wait);
}

/**
 * cm_channel_feed() - give the engine what it can take
 * @channel: channel
 * @own: request that the caller has just added, or NULL
 *
 * Return: 0, or why @own could not be started; it is in no list then, and
 * nobody is told.
 */
int cm_channel_feed(struct cm_channel *channel, struct cm_active *own)
{
	struct cm_active *active, *next;
	LIST_HEAD(failed);
	int ret = 0;

	spin_lock_bh(&channel->active_lock);
	feed_locked(channel, &failed);
	spin_unlock_bh(&channel->active_lock);
	list_for_each_entry_safe(active, next, &failed, node) {
		list_del(&active->node);
		if (active == own)
			ret = active->status;
		else
			cm_active_finish(active, 0, active->status);
	}
	return ret;
}

static u64 moved_bytes(const struct cm_active *active, const struct dmaengine_result *result)
{
	const struct cm_request *request = &active->request;
	const struct cm_traits *traits = active->channel->traits;
	u64 whole = request->cyclic ? request->period : request->length;
	u64 length = whole;

	if (request->lines)
		return (u64)request->lines * request->line_bytes;
	if (traits->length_register)
		length = readl(traits->registers + CM_DMA_LENGTH);
	else if (traits->residue && result && !(request->cyclic && traits->own_cyclic))
		length = result->residue <= whole ? whole - result->residue : whole;
	return min(length, whole);
}

static void account_locked(struct cm_channel *channel, const struct cm_active *active, u64 length,
			   int status)
{
	if (status)
		channel->stats.failed++;
	else
		channel->stats.completed++;
	channel->stats.bytes += length;
	if (!status && !active->request.lines && !active->request.cyclic &&
	    length < active->request.length)
		channel->stats.short_packets++;
}

/* the engine goes on with the frame that it has told the end of */
static bool must_stop(const struct cm_active *active)
{
	const struct cm_channel *channel = active->channel;

	return channel->traits->stop_after &&
	       (channel->info.direction == CM_DMA_S2MM || !repeats(active));
}

enum after_end {
	AFTER_LAST,
	AFTER_PERIOD,
	AFTER_STOP,
};

static enum after_end end_locked(struct cm_channel *channel, struct cm_active *active, u64 length,
				 int status)
{
	account_locked(channel, active, length, status);
	active->done++;
	/* a cyclic transfer of the engine's own stays there */
	if (!active->request.cyclic || repeats(active))
		channel->in_engine--;
	if (must_stop(active)) {
		active->length = length;
		active->status = status;
		channel->over = active;
		return AFTER_STOP;
	}
	if (active->request.cyclic)
		return AFTER_PERIOD;
	list_del(&active->node);
	return AFTER_LAST;
}

/* softirq context; a running terminate waits for it */
static void active_done(void *param, const struct dmaengine_result *result)
{
	struct cm_active *active = param;
	struct cm_channel *channel = active->channel;
	int status = result && result->result != DMA_TRANS_NOERROR ? -EIO : 0;
	u64 length = status ? 0 : moved_bytes(active, result);
	enum after_end after;

	if (channel->traits->moves && !length)
		status = -EIO;
	spin_lock_bh(&channel->active_lock);
	after = end_locked(channel, active, length, status);
	spin_unlock_bh(&channel->active_lock);
	switch (after) {
	case AFTER_STOP:
		queue_work(cm_dma_workqueue, &channel->settle);
		return;
	case AFTER_PERIOD:
		active_period(active, length, status);
		break;
	case AFTER_LAST:
		cm_active_finish(active, length, status);
		break;
	}
	cm_channel_feed(channel, NULL);
}
