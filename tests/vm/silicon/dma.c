// SPDX-License-Identifier: GPL-2.0-only
/*
 * AXI DMA v7.1 (PG021): register space and descriptors of chapter 2,
 * programming sequences of chapter 3.  sources.md says where each bit and rule
 * stands, and who else says so.
 */
#include <linux/bitfield.h>
#include <linux/irq.h>
#include <linux/interrupt.h>
#include <linux/minmax.h>
#include <linux/string.h>

#include "model.h"

#define CURDESC 0x08
#define CURDESC_MSB 0x0c
#define TAILDESC 0x10
#define TAILDESC_MSB 0x14
#define ADDRESS 0x18 /* SA and DA, simple mode */
#define ADDRESS_MSB 0x1c
#define LENGTH 0x28

/* writable bits of DMACR: RS, Reset, Keyhole, Cyclic, the enables, IRQThreshold, IRQDelay */
#define CR_WRITABLE (CR_RS | BIT(3) | CR_CYCLIC | SR_IRQS | CR_THRESHOLD | CR_DELAY)
/* table 2-6: IRQThreshold is 1 after reset, and bit 1 reads as 1 */
#define CR_AFTER_RESET (FIELD_PREP(CR_THRESHOLD, 1) | BIT(1))
#define RESET_READS 2 /* of DMACR, while a reset takes its time */

/* a descriptor, table 2-25 on */
struct descriptor {
	__le32 next;
	__le32 next_msb;
	__le32 buffer;
	__le32 buffer_msb;
	__le32 reserved[2];
	__le32 control;
	__le32 status;
};

#define CONTROL_SOF BIT(27)
#define CONTROL_EOF BIT(26)
#define STATUS_COMPLETE BIT(31)
#define STATUS_DEC_ERR BIT(30)
#define STATUS_SLV_ERR BIT(29)
#define STATUS_INT_ERR BIT(28)
#define STATUS_SOF BIT(27)
#define STATUS_EOF BIT(26)

/**
 * axi_status() - DMASR as it reads
 * @channel: channel
 *
 * Return: the value.
 */
u32 axi_status(const struct axi_channel *channel)
{
	u32 value = channel->sr;

	if (!channel->engine->vdma && channel->engine->sg)
		value |= SR_SG;
	return value | FIELD_PREP(CR_THRESHOLD, channel->countdown);
}

/**
 * axi_running() - whether a channel may move data
 * @channel: channel
 *
 * Return: true if it is started and not halted.
 */
bool axi_running(const struct axi_channel *channel)
{
	return channel->there && channel->cr & CR_RS && !(channel->sr & SR_HALTED);
}

static void reload(struct axi_channel *channel)
{
	channel->countdown = FIELD_GET(CR_THRESHOLD, channel->cr);
}

/**
 * axi_reset_channel() - as it is after reset
 * @channel: channel
 */
void axi_reset_channel(struct axi_channel *channel)
{
	channel->cr = CR_AFTER_RESET;
	channel->sr = SR_HALTED;
	channel->curdesc = 0;
	channel->taildesc = 0;
	channel->address = 0;
	channel->length = 0;
	channel->armed = false;
	channel->begun = false;
	channel->vsize = 0;
	channel->store = 0;
	channel->resets++;
	if (channel->packet)
		axi_packet_drop(channel->packet);
	channel->packet = NULL;
	/* what was received of a packet is gone, the rest of it comes */
	reload(channel);
}

/* DMACR.Reset: "Resetting one channel resets the other", of AXI DMA */
static void reset(struct axi_channel *channel)
{
	struct axi_engine *engine = channel->engine;

	if (engine->vdma) {
		axi_reset_channel(channel);
	} else {
		axi_reset_channel(&engine->channels[0]);
		axi_reset_channel(&engine->channels[1]);
	}
	channel->resetting = RESET_READS;
}

/**
 * axi_raise() - an interrupt event
 * @channel: channel
 * @bits: SR_IOC, SR_DLY or SR_ERR
 */
void axi_raise(struct axi_channel *channel, u32 bits)
{
	bool before = channel->sr & channel->cr & SR_IRQS;

	channel->sr |= bits;
	if (!before && channel->sr & channel->cr & SR_IRQS) {
		channel->interrupts++;
		axi_trace(channel->engine, 'i', channel->offset, bits);
	}
}

/**
 * axi_fail() - the channel ends with an error
 * @channel: channel
 * @error: bit of DMASR; only a reset clears it
 */
void axi_fail(struct axi_channel *channel, u32 error)
{
	channel->sr |= error | SR_HALTED;
	channel->sr &= ~SR_IDLE;
	channel->cr &= ~CR_RS;
	channel->armed = false;
	axi_raise(channel, SR_ERR);
}

/**
 * axi_count_packet() - IRQThreshold counts packets, and is loaded again at its end
 * @channel: channel
 */
void axi_count_packet(struct axi_channel *channel)
{
	if (channel->countdown > 1) {
		channel->countdown--;
		return;
	}
	reload(channel);
	axi_raise(channel, SR_IOC);
}

/**
 * axi_write_control() - DMACR
 * @channel: channel
 * @value: value
 */
void axi_write_control(struct axi_channel *channel, u32 value)
{
	u32 threshold = FIELD_GET(CR_THRESHOLD, channel->cr);
	u32 writable = CR_WRITABLE | (channel->engine->vdma ? CR_CIRCULAR : 0);

	if (value & CR_RESET) {
		reset(channel);
		return;
	}
	/* a threshold of 0 has no effect; to AXI VDMA it is 1 */
	if (!FIELD_GET(CR_THRESHOLD, value))
		value |= FIELD_PREP(CR_THRESHOLD, channel->engine->vdma ? 1 : threshold);
	channel->cr = (channel->cr & ~writable) | (value & writable);
	if (FIELD_GET(CR_THRESHOLD, value) != threshold)
		reload(channel);
	if (value & CR_RS && !(channel->sr & SR_ERRORS)) {
		if (channel->sr & SR_HALTED)
			channel->begun = false;
		channel->sr &= ~SR_HALTED;
	} else if (!(value & CR_RS) && !channel->sticks) {
		channel->sr |= SR_HALTED;
		channel->sr &= ~SR_IDLE;
		channel->armed = false;
	}
}

/**
 * axi_write_status() - DMASR: the interrupts are cleared by writing 1, and AXI VDMA's frame errors
 * @channel: channel
 * @value: value
 */
void axi_write_status(struct axi_channel *channel, u32 value)
{
	channel->sr &= ~(value & (channel->engine->vdma ? SR_IRQS | SR_FRAME_ERRORS : SR_IRQS));
}

/**
 * axi_dma_read() - read a register
 * @channel: channel
 * @offset: in the window
 *
 * Return: the value; registers that the engine was built without read as 0.
 */
u32 axi_dma_read(struct axi_channel *channel, u32 offset)
{
	if (!channel->there)
		return 0;
	switch (offset - channel->offset) {
	case DMACR:
		if (!channel->resetting)
			return channel->cr;
		channel->resetting--;
		return channel->cr | CR_RESET;
	case DMASR:
		return axi_status(channel);
	case CURDESC:
		return lower_32_bits(channel->curdesc);
	case CURDESC_MSB:
		return upper_32_bits(channel->curdesc);
	case TAILDESC:
		return lower_32_bits(channel->taildesc);
	case TAILDESC_MSB:
		return upper_32_bits(channel->taildesc);
	case ADDRESS:
		return lower_32_bits(channel->address);
	case LENGTH:
		return channel->length;
	default:
		return 0;
	}
}

static void set_half(u64 *value, u32 half, bool upper)
{
	*value = upper ? (*value & GENMASK_ULL(31, 0)) | (u64)half << 32 :
			 (*value & GENMASK_ULL(63, 32)) | half;
}

/* "When DMACR.RS is 1, CURDESC is read only": it is where the engine is */
static void write_curdesc(struct axi_channel *channel, u32 value, bool upper)
{
	if (axi_running(channel))
		return;
	set_half(&channel->curdesc, upper ? value : value & ~0x3f, upper);
}

/* "Writing TAILDESC starts the engine", which has to run */
static void write_taildesc(struct axi_channel *channel, u32 value)
{
	set_half(&channel->taildesc, value & ~0x3f, false);
	if (!axi_running(channel)) {
		channel->misuse++;
		return;
	}
	channel->armed = true;
	channel->sr &= ~SR_IDLE;
}

/* "Writing a non-zero value starts the transfer"; one at a time */
static void write_length(struct axi_channel *channel, u32 value)
{
	if (!axi_running(channel) || channel->armed) {
		channel->misuse++;
		return;
	}
	channel->length = value & channel->engine->length_mask;
	if (!channel->length)
		return;
	channel->armed = true;
	channel->sr &= ~SR_IDLE;
}

/**
 * axi_dma_write() - write a register
 * @channel: channel
 * @offset: in the window
 * @value: value
 */
void axi_dma_write(struct axi_channel *channel, u32 offset, u32 value)
{
	bool sg = channel->engine->sg;
	u32 reg = offset - channel->offset;

	if (!channel->there) {
		channel->misuse++;
		return;
	}
	if (reg == DMACR)
		axi_write_control(channel, value);
	else if (reg == DMASR)
		axi_write_status(channel, value);
	else if (sg && (reg == CURDESC || reg == CURDESC_MSB))
		write_curdesc(channel, value, reg == CURDESC_MSB);
	else if (sg && reg == TAILDESC)
		write_taildesc(channel, value);
	else if (sg && reg == TAILDESC_MSB)
		set_half(&channel->taildesc, value, true);
	else if (!sg && (reg == ADDRESS || reg == ADDRESS_MSB))
		set_half(&channel->address, value, reg == ADDRESS_MSB);
	else if (!sg && reg == LENGTH)
		write_length(channel, value);
	else
		channel->misuse++;
}

/* bytes moved; -1 where there is no memory */
static long send(struct axi_channel *channel, u64 address, u32 length, bool last)
{
	struct axi_packet *before = channel->packet, *packet;
	size_t kept = before ? before->length : 0;
	void *from = axi_memory(address, length);

	if (!from)
		return -1;
	packet = axi_packet_new(kept + length, GFP_ATOMIC);
	if (!packet)
		return -1;
	if (before)
		memcpy(packet->data, before->data, kept);
	memcpy(packet->data + kept, from, length);
	axi_packet_drop(before);
	channel->packet = packet;
	if (last) {
		channel->packet = NULL;
		axi_pl_sent(channel->engine, packet);
	}
	return length;
}

static long receive(struct axi_channel *channel, u64 address, u32 room, bool *first, bool *last)
{
	struct axi_packet *packet = axi_packet_first(channel);
	size_t length = min_t(size_t, room, packet->length - packet->taken);
	void *to = axi_memory(address, length);

	if (!to)
		return -1;
	memcpy(to, packet->data + packet->taken, length);
	*first = !packet->taken;
	packet->taken += length;
	*last = packet->taken == packet->length;
	if (*last)
		axi_packet_drop(packet);
	return length;
}

static u32 error_in_descriptor(u32 error)
{
	return (error & SR_INT_ERR ? STATUS_INT_ERR : 0) |
	       (error & SR_SLV_ERR ? STATUS_SLV_ERR : 0) | (error & SR_DEC_ERR ? STATUS_DEC_ERR : 0);
}

static void fail_descriptor(struct axi_channel *channel, struct descriptor *desc, u32 error)
{
	if (error_in_descriptor(error))
		desc->status = cpu_to_le32(STATUS_COMPLETE | error_in_descriptor(error));
	axi_fail(channel, error);
}

static u32 take_injected(struct axi_channel *channel)
{
	u32 error = channel->inject;

	channel->inject = 0;
	if (!error && channel->engine->fail_next) {
		channel->engine->fail_next--;
		error = SR_SLV_ERR;
	}
	return error;
}

/* errors with which a descriptor is not begun: table 2-7, SGIntErr and DMAIntErr */
static u32 refuse(struct axi_channel *channel, const struct descriptor *desc, u32 length)
{
	u32 injected = take_injected(channel);

	if (injected)
		return injected;
	if (le32_to_cpu(desc->status) & STATUS_COMPLETE && !(channel->cr & CR_CYCLIC))
		return SR_SG_INT_ERR;
	return length ? 0 : SR_INT_ERR;
}

static void descriptor_done(struct axi_channel *channel, struct descriptor *desc, u32 status,
			    bool packet)
{
	bool tail = channel->curdesc == channel->taildesc;

	desc->status = cpu_to_le32(STATUS_COMPLETE | status);
	channel->transfers++;
	channel->bytes += status & channel->engine->length_mask;
	axi_trace(channel->engine, 'd', channel->offset, status);
	channel->begun = true;
	if (tail && !(channel->cr & CR_CYCLIC)) {
		channel->armed = false;
		channel->sr |= SR_IDLE;
	}
	if (packet)
		axi_count_packet(channel);
}

static bool sg_step(struct axi_channel *channel)
{
	u32 mask = channel->engine->length_mask, control, length, error;
	bool first = true, last = true;
	struct descriptor *desc;
	long moved;

	if (channel->receives && !axi_packet_first(channel))
		return false;
	/* the pointer to the next was fetched with the last descriptor */
	if (channel->begun)
		channel->curdesc = channel->next;
	desc = axi_memory(channel->curdesc, sizeof(*desc));
	if (!desc) {
		axi_fail(channel, SR_SG_DEC_ERR);
		return true;
	}
	channel->next = le32_to_cpu(desc->next) | (u64)le32_to_cpu(desc->next_msb) << 32;
	control = le32_to_cpu(desc->control);
	length = control & mask;
	error = refuse(channel, desc, length);
	if (error) {
		fail_descriptor(channel, desc, error);
		return true;
	}
	if (channel->receives) {
		moved = receive(channel, le32_to_cpu(desc->buffer) | (u64)le32_to_cpu(desc->buffer_msb) << 32,
				length, &first, &last);
	} else {
		last = control & CONTROL_EOF;
		moved = send(channel, le32_to_cpu(desc->buffer) | (u64)le32_to_cpu(desc->buffer_msb) << 32,
			     length, last);
	}
	if (moved < 0)
		fail_descriptor(channel, desc, SR_DEC_ERR);
	else
		descriptor_done(channel, desc,
				moved | (channel->receives && first ? STATUS_SOF : 0) |
					(channel->receives && last ? STATUS_EOF : 0), last);
	return true;
}

/* "S2MM_LENGTH: at the end the number of actual bytes written" */
static bool simple_step(struct axi_channel *channel)
{
	bool first = true, last = true;
	u32 error;
	long moved;

	if (channel->receives && !axi_packet_first(channel))
		return false;
	error = take_injected(channel) & (channel->receives ? ~0 : ~SR_INT_ERR);
	if (error) {
		axi_fail(channel, error);
		return true;
	}
	moved = channel->receives ?
			receive(channel, channel->address, channel->length, &first, &last) :
			send(channel, channel->address, channel->length, true);
	if (moved < 0 || !last) {
		/* S2MM_DMASR, DMAIntErr: any error of a write, or a packet longer than the buffer */
		axi_fail(channel, (moved < 0 ? SR_DEC_ERR : 0) |
				  (channel->receives ? SR_INT_ERR : 0));
		return true;
	}
	channel->length = moved;
	channel->armed = false;
	channel->transfers++;
	channel->bytes += moved;
	channel->sr |= SR_IDLE;
	axi_trace(channel->engine, 'd', channel->offset, moved);
	axi_raise(channel, SR_IOC);
	return true;
}

/**
 * axi_dma_step() - do one descriptor or transfer
 * @channel: channel; the engine's lock is held
 *
 * Return: true if something was done, and there may be more.
 */
bool axi_dma_step(struct axi_channel *channel)
{
	if (!axi_running(channel) || !channel->armed || channel->hold)
		return false;
	return channel->engine->sg ? sg_step(channel) : simple_step(channel);
}
