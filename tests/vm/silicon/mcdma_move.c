// SPDX-License-Identifier: GPL-2.0-only
/* AXI MCDMA at work: descriptors of each channel, packets by their TDEST. */
#include <linux/bitfield.h>
#include <linux/minmax.h>
#include <linux/string.h>

#include "mcdma.h"

struct descriptor {
	__le32 next;
	__le32 next_msb;
	__le32 buffer;
	__le32 buffer_msb;
	__le32 reserved;
	__le32 control;
	__le32 status;
	__le32 sideband;
};

#define CONTROL_EOF BIT(30)
#define STATUS_COMPLETE BIT(31)
#define STATUS_SOF BIT(27)
#define STATUS_EOF BIT(26)
#define SIDEBAND_TDEST GENMASK(19, 16)

static void fail(struct axi_engine *engine, int way, struct axi_channel *channel, u32 error)
{
	engine->errors[way] |= error;
	engine->channels[way].sr |= SR_HALTED;
	engine->channels[way].cr &= ~CR_RS;
	channel->armed = false;
	channel->sr |= MCDMA_ERROR;
}

static struct axi_packet *packet_for(struct axi_engine *engine, u32 tdest)
{
	struct axi_packet *packet;

	list_for_each_entry(packet, &engine->channels[1].stream, node) {
		if (packet->tdest == tdest)
			return packet;
	}
	return NULL;
}

/* status of the descriptor, or 0 where there is no memory */
static u32 receive(struct axi_packet *packet, u64 address, u32 room)
{
	size_t length = min_t(size_t, room, packet->length - packet->taken);
	void *to = axi_memory(address, length);
	u32 status = STATUS_COMPLETE | length;

	if (!to)
		return 0;
	memcpy(to, packet->data + packet->taken, length);
	status |= packet->taken ? 0 : STATUS_SOF;
	packet->taken += length;
	if (packet->taken < packet->length)
		return status;
	axi_packet_drop(packet);
	return status | STATUS_EOF;
}

static u32 send(struct axi_engine *engine, struct axi_channel *channel, u32 tdest, u64 address,
		u32 length, bool last)
{
	struct axi_packet *before = channel->packet, *packet;
	size_t kept = before ? before->length : 0;
	void *from = axi_memory(address, length);

	packet = from ? axi_packet_new(kept + length, GFP_ATOMIC) : NULL;
	if (!packet)
		return 0;
	if (before)
		memcpy(packet->data, before->data, kept);
	memcpy(packet->data + kept, from, length);
	packet->tdest = tdest;
	axi_packet_drop(before);
	channel->packet = last ? NULL : packet;
	if (last)
		axi_pl_sent(engine, packet);
	return STATUS_COMPLETE | length;
}

static void done(struct axi_engine *engine, int way, struct axi_channel *channel, bool packet)
{
	engine->channels[way].transfers++;
	channel->begun = true;
	if (channel->curdesc == channel->taildesc)
		channel->armed = false;
	if (!packet)
		return;
	if (channel->countdown > 1) {
		channel->countdown--;
		return;
	}
	channel->countdown = FIELD_GET(MCDMA_THRESHOLD, channel->cr);
	channel->sr |= MCDMA_IOC;
	engine->channels[way].interrupts++;
}

static bool step(struct axi_engine *engine, int way, u32 number)
{
	struct axi_channel *channel = &engine->mc[way][number], *common = &engine->channels[way];
	struct axi_packet *packet = way ? packet_for(engine, number) : NULL;
	bool last = true, runs = common->cr & CR_RS && engine->chen[way] & BIT(number);
	struct descriptor *desc;
	u32 length, status;
	u64 buffer;

	if (!runs || !(channel->cr & CR_RS) || !channel->armed || common->hold || (way && !packet))
		return false;
	if (channel->begun)
		channel->curdesc = channel->next;
	desc = axi_memory(channel->curdesc, sizeof(*desc));
	if (!desc || le32_to_cpu(desc->status) & STATUS_COMPLETE) {
		fail(engine, way, channel, desc ? MCDMA_ERR_SG_INT : MCDMA_ERR_SG_DEC);
		return true;
	}
	channel->next = le32_to_cpu(desc->next) | (u64)le32_to_cpu(desc->next_msb) << 32;
	buffer = le32_to_cpu(desc->buffer) | (u64)le32_to_cpu(desc->buffer_msb) << 32;
	length = le32_to_cpu(desc->control) & engine->length_mask;
	if (way) {
		status = receive(packet, buffer, length);
		last = status & STATUS_EOF;
	} else {
		last = le32_to_cpu(desc->control) & CONTROL_EOF;
		status = send(engine, channel, number, buffer, length, last);
	}
	if (!length || !status) {
		fail(engine, way, channel, length ? MCDMA_ERR_DEC : MCDMA_ERR_INT);
		return true;
	}
	desc->status = cpu_to_le32(status);
	desc->sideband = cpu_to_le32(FIELD_PREP(SIDEBAND_TDEST, number));
	done(engine, way, channel, last);
	return true;
}

/**
 * axi_mcdma_step() - do one descriptor of each channel
 * @engine: engine; its lock is held
 *
 * Return: true if something was done, and there may be more.
 */
bool axi_mcdma_step(struct axi_engine *engine)
{
	bool moved = false;
	int i;

	for (i = 0; i < AXI_MC_CHANNELS; i++)
		moved |= step(engine, 0, i) | step(engine, 1, i);
	return moved;
}
