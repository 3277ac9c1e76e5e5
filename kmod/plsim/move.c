// SPDX-License-Identifier: GPL-2.0-only
/* Data between memory and what is behind the channels. */
#include <linux/bottom_half.h>
#include <linux/crc32.h>
#include <linux/delay.h>
#include <linux/dma-direct.h>
#include <linux/io.h>
#include <linux/slab.h>

#include "cm_compat.h"
#include "cm_dma.h"
#include "plsim.h"

#define CYCLIC_INTERVAL_US 1000
#define SHORT_WAIT_US 20000

/* bytes that one completion of the transfer stands for */
static size_t desc_length(const struct plsim_desc *desc)
{
	return desc->period ?: desc->lines * desc->line_bytes;
}

/**
 * plsim_kick() - something changed for a channel
 * @chan: channel
 */
void plsim_kick(struct plsim_chan *chan)
{
	mod_delayed_work(chan->dma->queue, &chan->work, 0);
}

/**
 * plsim_drop_packets() - forget data on its way to an S2MM channel
 * @chan: channel
 */
void plsim_drop_packets(struct plsim_chan *chan)
{
	struct plsim_packet *packet, *next;
	unsigned long flags;
	LIST_HEAD(gone);

	spin_lock_irqsave(&chan->lock, flags);
	list_splice_init(&chan->packets, &gone);
	chan->packet_bytes = 0;
	spin_unlock_irqrestore(&chan->lock, flags);
	list_for_each_entry_safe(packet, next, &gone, node)
		kvfree(packet);
}

/* one piece of memory, in either direction */
static int copy_piece(struct plsim_chan *chan, dma_addr_t address, u8 *data, size_t length)
{
	void *memory = memremap(dma_to_phys(chan->dma->dev, address), length, MEMREMAP_WB);

	if (!memory)
		return -EFAULT;
	if (chan->direction == CM_DMA_MM2S)
		memcpy(data, memory, length);
	else
		memcpy(memory, data, length);
	memunmap(memory);
	return 0;
}

/* the transfer's next bytes */
static int copy_next(struct plsim_chan *chan, struct plsim_desc *desc, u8 *data, size_t length)
{
	while (length) {
		size_t at = desc->position + desc->done;
		size_t line = desc->lines > 1 ? at / desc->line_bytes : 0;
		size_t column = at - line * desc->line_bytes;
		size_t piece = min(length, desc->line_bytes - column);

		if (copy_piece(chan, desc->address + line * desc->stride + column, data, piece))
			return -EFAULT;
		desc->done += piece;
		data += piece;
		length -= piece;
	}
	return 0;
}

/**
 * struct plsim_run - what the work has in hand
 * @desc: transfer; NULL once it ended
 * @stopped: the channel's count when it was taken
 */
struct plsim_run {
	struct plsim_desc *desc;
	u32 stopped;
};

static bool take(struct plsim_chan *chan, struct plsim_run *run)
{
	unsigned long flags;

	spin_lock_irqsave(&chan->lock, flags);
	run->desc = chan->current_desc;
	chan->current_desc = NULL;
	if (!run->desc) {
		run->desc = list_first_entry_or_null(&chan->issued, struct plsim_desc, node);
		if (run->desc)
			list_del_init(&run->desc->node);
	}
	run->stopped = chan->stopped;
	spin_unlock_irqrestore(&chan->lock, flags);
	return run->desc;
}

static void put_back(struct plsim_chan *chan, struct plsim_run *run)
{
	struct plsim_desc *gone = run->desc;
	unsigned long flags;

	spin_lock_irqsave(&chan->lock, flags);
	if (run->desc && chan->stopped == run->stopped) {
		chan->current_desc = run->desc;
		gone = NULL;
	}
	spin_unlock_irqrestore(&chan->lock, flags);
	kfree(gone);
}

static void call_back(const struct dma_async_tx_descriptor *tx,
		      const struct dmaengine_result *result)
{
	local_bh_disable();
	if (tx->callback_result)
		tx->callback_result(tx->callback_param, result);
	else if (tx->callback)
		tx->callback(tx->callback_param);
	local_bh_enable();
}

static void advance(struct plsim_desc *desc)
{
	desc->position += desc->period;
	if (desc->position >= desc->line_bytes)
		desc->position = 0;
	desc->done = 0;
}

static bool still_ours(struct plsim_chan *chan, const struct plsim_run *run)
{
	unsigned long flags;
	bool ours;

	spin_lock_irqsave(&chan->lock, flags);
	ours = chan->stopped == run->stopped;
	spin_unlock_irqrestore(&chan->lock, flags);
	return ours;
}

/* a transfer or a period ends; false: it was terminated meanwhile */
static bool finish(struct plsim_chan *chan, struct plsim_run *run, bool failed)
{
	struct dmaengine_result result = { .result = DMA_TRANS_NOERROR };
	struct dma_async_tx_descriptor tx = run->desc->tx;
	unsigned long flags;
	bool ours;

	if (failed)
		result.result = chan->direction == CM_DMA_MM2S ? DMA_TRANS_READ_FAILED :
								 DMA_TRANS_WRITE_FAILED;
	result.residue = desc_length(run->desc) - run->desc->done;
	spin_lock_irqsave(&chan->lock, flags);
	ours = chan->stopped == run->stopped;
	chan->bytes += run->desc->done;
	if (ours && !run->desc->period)
		chan->chan.completed_cookie = tx.cookie;
	spin_unlock_irqrestore(&chan->lock, flags);
	if (!ours)
		return false;
	if (run->desc->period) {
		advance(run->desc);
	} else {
		kfree(run->desc);
		run->desc = NULL;
	}
	call_back(&tx, &result);
	return true;
}

static bool take_count(u32 *count)
{
	u32 value = READ_ONCE(*count);

	if (!value)
		return false;
	WRITE_ONCE(*count, value - 1);
	return true;
}

static bool peer_has_room(struct plsim_chan *peer, size_t length)
{
	unsigned long flags;
	bool room;

	spin_lock_irqsave(&peer->lock, flags);
	room = list_empty(&peer->packets) || peer->packet_bytes + length <= peer->fifo;
	spin_unlock_irqrestore(&peer->lock, flags);
	return room;
}

/**
 * plsim_give() - data on its way to an S2MM channel
 * @peer: channel
 * @packet: becomes the channel's
 */
void plsim_give(struct plsim_chan *peer, struct plsim_packet *packet)
{
	u32 limit = xchg(&peer->faults.short_next, 0);
	unsigned long flags;

	if (limit && limit < packet->length)
		packet->length = limit;
	spin_lock_irqsave(&peer->lock, flags);
	list_add_tail(&packet->node, &peer->packets);
	peer->packet_bytes += packet->length;
	spin_unlock_irqrestore(&peer->lock, flags);
	plsim_kick(peer);
}

static void consume(struct plsim_chan *chan, struct plsim_packet *packet)
{
	switch (chan->kind) {
	case PLSIM_LOOPBACK:
		plsim_give(chan->peer, packet);
		return;
	case PLSIM_ICAP:
		plsim_icap_take(chan, packet->data, packet->length);
		fallthrough;
	default:
		chan->crc32 = crc32_le(~0, packet->data, packet->length) ^ ~0;
		kvfree(packet);
	}
}

/* true: a transfer or period ended, look for more */
static bool send(struct plsim_chan *chan, struct plsim_run *run)
{
	size_t length = desc_length(run->desc);
	struct plsim_packet *packet;

	if (take_count(&chan->faults.fail_next))
		return finish(chan, run, true);
	if (chan->kind == PLSIM_LOOPBACK && !peer_has_room(chan->peer, length))
		return false;
	packet = plsim_packet_new(length);
	if (!packet || copy_next(chan, run->desc, packet->data, length) || !still_ours(chan, run)) {
		kvfree(packet);
		return finish(chan, run, true);
	}
	consume(chan, packet);
	return finish(chan, run, false);
}

static struct plsim_packet *first_packet(struct plsim_chan *chan)
{
	struct plsim_packet *packet;
	unsigned long flags;

	spin_lock_irqsave(&chan->lock, flags);
	packet = list_first_entry_or_null(&chan->packets, struct plsim_packet, node);
	spin_unlock_irqrestore(&chan->lock, flags);
	if (packet || chan->kind != PLSIM_SOURCE)
		return packet;
	packet = plsim_source_frame(chan);
	if (packet)
		plsim_give(chan, packet);
	return packet;
}

static void drop_packet(struct plsim_chan *chan, struct plsim_packet *packet)
{
	unsigned long flags;

	spin_lock_irqsave(&chan->lock, flags);
	list_del(&packet->node);
	chan->packet_bytes -= packet->length;
	spin_unlock_irqrestore(&chan->lock, flags);
	kvfree(packet);
	if (chan->kind == PLSIM_LOOPBACK)
		plsim_kick(chan->peer);
}

/*
 * A packet's end ends the transfer (TLAST); one longer than the transfer goes
 * on in the next, as AXI DMA does it.
 */
static bool receive(struct plsim_chan *chan, struct plsim_run *run)
{
	struct plsim_desc *desc = run->desc;
	struct plsim_packet *packet;
	size_t length;
	int ret;

	if (take_count(&chan->faults.fail_next))
		return finish(chan, run, true);
	packet = first_packet(chan);
	if (!packet)
		return false;
	length = min(desc_length(desc) - desc->done, packet->length - packet->taken);
	ret = copy_next(chan, desc, packet->data + packet->taken, length);
	packet->taken += length;
	if (ret || packet->taken == packet->length)
		drop_packet(chan, packet);
	return finish(chan, run, ret);
}

/* how long a cyclic or paced channel waits; 0 where something else wakes it */
static u64 pace_us(const struct plsim_chan *chan, bool cyclic)
{
	u64 now = ktime_get_ns();

	if (chan->kind == PLSIM_SOURCE && chan->interval_us)
		return chan->next_frame > now ? div_u64(chan->next_frame - now, 1000) + 1 : 1;
	if (cyclic && chan->kind != PLSIM_LOOPBACK)
		return chan->interval_us ?: CYCLIC_INTERVAL_US;
	return 0;
}

/* jiffies are too coarse for short waits; a terminate waits for these */
static bool wait_pace(struct plsim_chan *chan, u64 pace)
{
	if (pace < SHORT_WAIT_US) {
		fsleep(pace);
		return true;
	}
	queue_delayed_work(chan->dma->queue, &chan->work,
			   usecs_to_jiffies(min_t(u64, pace, USEC_PER_SEC)));
	return false;
}

static bool run_once(struct plsim_chan *chan, struct plsim_run *run)
{
	u32 delay = READ_ONCE(chan->faults.delay_us);

	if (READ_ONCE(chan->faults.hang))
		return false;
	if (delay)
		fsleep(min_t(u32, delay, USEC_PER_SEC));
	if (!still_ours(chan, run))
		return false;
	return plsim_receives(chan) ? receive(chan, run) : send(chan, run);
}

/* true: look for more at once */
static bool step(struct plsim_chan *chan)
{
	struct plsim_run run;
	bool cyclic, more;
	u64 pace;

	if (!take(chan, &run))
		return false;
	cyclic = run.desc->period;
	more = run_once(chan, &run);
	put_back(chan, &run);
	if (READ_ONCE(chan->faults.hang))
		return false;
	pace = pace_us(chan, cyclic);
	return pace ? wait_pace(chan, pace) : more;
}

/**
 * plsim_work() - move all that can be moved
 * @work: of a channel
 */
void plsim_work(struct work_struct *work)
{
	struct plsim_chan *chan = container_of(to_delayed_work(work), struct plsim_chan, work);

	while (step(chan))
		cond_resched();
}
