// SPDX-License-Identifier: GPL-2.0-only
/*
 * The end of what a channel has under way: asked for, or by an error.
 *
 * All of it with the engine's lock held, which keeps new requests out.
 */
#include <linux/slab.h>

#include "channel.h"
#include "cm_compat.h"

static bool set_stopping(struct cm_channel *channel, bool stopping)
{
	bool busy;

	spin_lock_bh(&channel->active_lock);
	channel->stopping = stopping;
	busy = channel->in_engine;
	spin_unlock_bh(&channel->active_lock);
	return busy;
}

/* what the engine had it has no more; it was stopped, so no callback runs beside this */
static void rewind(struct cm_channel *channel)
{
	struct cm_active *active;

	spin_lock_bh(&channel->active_lock);
	list_for_each_entry(active, &channel->active, node)
		active->fed = active->done;
	channel->in_engine = 0;
	spin_unlock_bh(&channel->active_lock);
	/* its registers are not read any more: the PL may be loaded next */
	cm_traits_tell(channel->traits, false);
}

/*
 * The reset of another channel has taken what this one had.  What had ended
 * before that is told; the rest is given to the engine again, from its start.
 */
static void rearm(struct cm_channel *channel)
{
	dmaengine_synchronize(channel->chan);
	if (set_stopping(channel, true)) {
		dmaengine_terminate_sync(channel->chan);
		rewind(channel);
		channel->stats.rearmed++;
	}
}

static void terminate(struct cm_channel *channel)
{
	struct cm_engine *engine = channel->engine;
	struct cm_channel *sibling;

	if (!engine->shared_reset) {
		dmaengine_terminate_sync(channel->chan);
		return;
	}
	list_for_each_entry(sibling, &engine->channels, siblings)
		set_stopping(sibling, true);
	dmaengine_terminate_sync(channel->chan);
	list_for_each_entry(sibling, &engine->channels, siblings) {
		if (sibling != channel)
			rearm(sibling);
	}
	list_for_each_entry(sibling, &engine->channels, siblings) {
		if (sibling == channel)
			continue;
		set_stopping(sibling, false);
		cm_channel_feed(sibling, NULL);
	}
}

/* afterwards the engine has nothing of the channel, and is given nothing */
static void quiesce(struct cm_channel *channel)
{
	if (set_stopping(channel, true))
		terminate(channel);
	else
		/* a reset for nothing would hit the sibling; a callback may run yet */
		dmaengine_synchronize(channel->chan);
	rewind(channel);
}

static struct cm_active *take_over(struct cm_channel *channel)
{
	struct cm_active *active;

	spin_lock_bh(&channel->active_lock);
	active = channel->over;
	channel->over = NULL;
	if (active)
		list_del(&active->node);
	spin_unlock_bh(&channel->active_lock);
	return active;
}

/* a frame that is repeated stays in the list, and its end is told as a period's */
static void tell_over(struct cm_channel *channel)
{
	struct cm_active *active = channel->over;
	struct cm_result result;

	if (!active->request.cyclic || active->status) {
		active = take_over(channel);
		cm_active_finish(active, active->length, active->status);
		return;
	}
	result = (struct cm_result){
		.cookie = active->request.cookie,
		.length = active->length,
		.timestamp_ns = ktime_get_ns(),
		.readable = active->readable,
	};
	cm_buffer_written(active->request.buffer, active->request.offset,
			  cm_request_footprint(&active->request));
	active->request.done(active->request.context, &result);
	spin_lock_bh(&channel->active_lock);
	channel->over = NULL;
	spin_unlock_bh(&channel->active_lock);
}

/**
 * cm_channel_stop() - end all requests of a channel
 * @channel: channel; its engine's lock is held
 */
void cm_channel_stop(struct cm_channel *channel)
{
	struct cm_active *active, *next;
	LIST_HEAD(cancelled);

	quiesce(channel);
	if (channel->over)
		tell_over(channel);
	spin_lock_bh(&channel->active_lock);
	list_splice_init(&channel->active, &cancelled);
	spin_unlock_bh(&channel->active_lock);
	list_for_each_entry_safe(active, next, &cancelled, node) {
		channel->stats.cancelled++;
		cm_active_finish(active, 0, -ECANCELED);
	}
	set_stopping(channel, false);
}

/**
 * cm_channel_settle() - a frame has ended, and the engine goes on with it
 * @work: of a channel
 *
 * Its end is told when nothing can be written to it any more.
 */
void cm_channel_settle(struct work_struct *work)
{
	struct cm_channel *channel = container_of(work, struct cm_channel, settle);

	mutex_lock(&channel->engine->lock);
	if (channel->chan && channel->over) {
		set_stopping(channel, true);
		terminate(channel);
		rewind(channel);
		tell_over(channel);
		set_stopping(channel, false);
		cm_channel_feed(channel, NULL);
	}
	mutex_unlock(&channel->engine->lock);
}

static struct cm_active *take_first(struct cm_channel *channel)
{
	struct cm_active *active;

	spin_lock_bh(&channel->active_lock);
	active = list_first_entry_or_null(&channel->active, struct cm_active, node);
	if (active) {
		list_del(&active->node);
		channel->stats.failed++;
	}
	spin_unlock_bh(&channel->active_lock);
	return active;
}

/* the first transfer has failed; those behind it are started again */
static void fail(struct cm_channel *channel)
{
	struct cm_active *active;

	set_stopping(channel, true);
	terminate(channel);
	rewind(channel);
	active = take_over(channel) ?: take_first(channel);
	if (active)
		cm_active_finish(active, 0, -EIO);
	set_stopping(channel, false);
	cm_channel_feed(channel, NULL);
}

/**
 * cm_channel_look() - look for an error that is not reported
 * @channel: channel
 * @delay: after this many jiffies; not later than asked for before
 *
 * Not while the system is suspended, when the engine's bus may not answer.
 */
void cm_channel_look(struct cm_channel *channel, unsigned long delay)
{
	if (!channel->traits->registers)
		return;
	if (delay)
		queue_delayed_work(system_freezable_wq, &channel->watch, delay);
	else
		mod_delayed_work(system_freezable_wq, &channel->watch, 0);
}

/**
 * cm_channel_watch() - end a transfer whose engine has stopped with an error
 * @work: of a channel
 */
void cm_channel_watch(struct work_struct *work)
{
	struct cm_channel *channel = container_of(to_delayed_work(work), struct cm_channel, watch);
	bool busy;

	mutex_lock(&channel->engine->lock);
	if (channel->chan) {
		spin_lock_bh(&channel->active_lock);
		busy = !list_empty(&channel->active);
		spin_unlock_bh(&channel->active_lock);
		/* not read at rest: the PL may be under a load, or without a clock */
		if (busy && cm_traits_failed(channel->traits))
			fail(channel);
		else if (busy)
			cm_channel_look(channel, HZ / 10);
	}
	mutex_unlock(&channel->engine->lock);
}
