// SPDX-License-Identifier: GPL-2.0-only
/*
 * AXI VDMA v6.3 (PG020), register direct mode, flushing on frame sync, which
 * comes with each frame: a frame begins when there is one.  sources.md says
 * where each bit stands.
 *
 * Until it is stopped it goes on: parked, with the frame store of PARK_PTR;
 * circular, with one after the other.
 */
#include <linux/bitfield.h>
#include <linux/string.h>

#include "model.h"

#define PARK_PTR 0x28
#define VERSION 0x2c
#define MM2S_VSIZE 0x50
#define S2MM_VSIZE 0xa0
#define HSIZE 0x04
#define STRIDE 0x08
#define START 0x0c

#define PARK_READ GENMASK(4, 0)
#define PARK_WRITE GENMASK(12, 8)
#define PARK_READ_STORE GENMASK(20, 16)
#define PARK_WRITE_STORE GENMASK(28, 24)
#define VSIZE_BITS GENMASK(12, 0)
#define HSIZE_BITS GENMASK(15, 0)

static u32 frame_base(const struct axi_channel *channel)
{
	return channel->receives ? S2MM_VSIZE : MM2S_VSIZE;
}

/**
 * axi_vdma_read() - read a register
 * @channel: channel
 * @offset: in the window
 *
 * Return: the value.
 */
u32 axi_vdma_read(struct axi_channel *channel, u32 offset)
{
	struct axi_engine *engine = channel->engine;
	u32 store;

	if (offset == PARK_PTR)
		return engine->park | FIELD_PREP(PARK_READ_STORE, engine->channels[0].store) |
		       FIELD_PREP(PARK_WRITE_STORE, engine->channels[1].store);
	if (offset == VERSION)
		return 0x62000000;
	if (!channel->there)
		return 0;
	if (offset - channel->offset == DMACR) {
		if (!channel->resetting)
			return channel->cr;
		channel->resetting--;
		return channel->cr | CR_RESET;
	}
	if (offset - channel->offset == DMASR)
		return axi_status(channel);
	if (offset == frame_base(channel))
		return channel->vsize;
	if (offset == frame_base(channel) + HSIZE)
		return channel->hsize;
	if (offset == frame_base(channel) + STRIDE)
		return channel->stride;
	store = (offset - frame_base(channel) - START) / 4;
	return store < engine->fstores ? lower_32_bits(channel->start[store]) : 0;
}

static void write_frame(struct axi_channel *channel, u32 reg, u32 value)
{
	u32 store = (reg - START) / 4;

	if (!reg) {
		/* "VSIZE must be written last: it starts the transfer" */
		channel->vsize = value & VSIZE_BITS;
		channel->armed = channel->vsize && axi_running(channel);
		if (channel->vsize && !channel->armed)
			channel->misuse++;
	} else if (reg == HSIZE) {
		channel->hsize = value & HSIZE_BITS;
	} else if (reg == STRIDE) {
		channel->stride = value & HSIZE_BITS;
	} else if (store < channel->engine->fstores) {
		channel->start[store] = value;
	} else {
		channel->misuse++;
	}
}

/**
 * axi_vdma_write() - write a register
 * @channel: channel
 * @offset: in the window
 * @value: value
 */
void axi_vdma_write(struct axi_channel *channel, u32 offset, u32 value)
{
	if (offset == PARK_PTR) {
		channel->engine->park = value & (PARK_READ | PARK_WRITE);
		return;
	}
	if (!channel->there) {
		channel->misuse++;
		return;
	}
	if (offset - channel->offset == DMACR)
		axi_write_control(channel, value);
	else if (offset - channel->offset == DMASR)
		axi_write_status(channel, value);
	else if (offset >= frame_base(channel))
		write_frame(channel, offset - frame_base(channel), value);
	else
		channel->misuse++;
}

static u32 store_now(struct axi_channel *channel)
{
	u32 park = channel->receives ? FIELD_GET(PARK_WRITE, channel->engine->park) :
				       FIELD_GET(PARK_READ, channel->engine->park);

	channel->store = channel->cr & CR_CIRCULAR ? channel->store + 1 : park;
	channel->store %= channel->engine->fstores;
	return channel->store;
}

static bool move_lines(struct axi_channel *channel, u64 address, struct axi_packet *packet)
{
	u32 line;

	for (line = 0; line < channel->vsize; line++) {
		void *memory = axi_memory(address + line * channel->stride, channel->hsize);
		u8 *data = packet->data + line * channel->hsize;

		if (!memory)
			return false;
		if (channel->receives)
			memcpy(memory, data, channel->hsize);
		else
			memcpy(data, memory, channel->hsize);
	}
	return true;
}

static struct axi_packet *frame(struct axi_channel *channel)
{
	size_t length = (size_t)channel->vsize * channel->hsize;
	struct axi_packet *packet;

	if (!channel->receives)
		return axi_packet_new(length, GFP_ATOMIC);
	packet = axi_packet_first(channel);
	/* a frame of another size is flushed and told; the channel goes on with the next one */
	while (packet && packet->length != length) {
		channel->sr |= packet->length < length ? SR_SOF_EARLY : SR_SOF_LATE;
		axi_raise(channel, SR_ERR);
		axi_packet_drop(packet);
		packet = axi_packet_first(channel);
	}
	return packet;
}

/**
 * axi_vdma_step() - do one frame
 * @channel: channel; the engine's lock is held
 *
 * Return: true if something was done, and there may be more.
 */
bool axi_vdma_step(struct axi_channel *channel)
{
	struct axi_packet *packet;
	bool moved;

	if (!axi_running(channel) || !channel->armed || channel->hold)
		return false;
	if (channel->inject) {
		axi_fail(channel, channel->inject);
		channel->inject = 0;
		return true;
	}
	packet = frame(channel);
	if (!packet)
		return false;
	moved = move_lines(channel, channel->start[store_now(channel)], packet);
	if (channel->receives || !moved)
		axi_packet_drop(packet);
	else
		axi_pl_sent(channel->engine, packet);
	if (!moved) {
		axi_fail(channel, SR_DEC_ERR);
		return true;
	}
	channel->transfers++;
	channel->bytes += (u64)channel->vsize * channel->hsize;
	axi_trace(channel->engine, 'd', channel->offset, channel->vsize);
	axi_count_packet(channel);
	/* a display is fed at the pace of its frames, which is that of this worker */
	return channel->receives;
}
