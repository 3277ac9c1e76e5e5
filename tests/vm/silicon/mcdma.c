// SPDX-License-Identifier: GPL-2.0-only
/*
 * AXI MCDMA v1.1 (PG288), as far as Xilinx' own driver of it tells (sources.md):
 * MM2S and S2MM with a control register each, and behind it channels with
 * descriptors of their own, of which a packet's TDEST chooses one.
 */
#include <linux/bitfield.h>

#include "mcdma.h"

#define S2MM 0x500
#define CHEN 0x08
#define ERR 0x10
#define RXINT_SER 0x20
#define TXINT_SER 0x28
#define FIRST 0x40 /* channel 0 */
#define NEXT 0x40 /* from one to the next */

/* of a channel */
#define CR 0x00
#define SR 0x04
#define CDESC 0x08
#define CDESC_MSB 0x0c
#define TDESC 0x10
#define TDESC_MSB 0x14

static void reset_channel(struct axi_channel *channel)
{
	channel->cr = FIELD_PREP(MCDMA_THRESHOLD, 1);
	channel->sr = 0;
	channel->curdesc = 0;
	channel->taildesc = 0;
	channel->armed = false;
	channel->begun = false;
	channel->countdown = 1;
	axi_packet_drop(channel->packet);
	channel->packet = NULL;
}

/**
 * axi_mcdma_reset() - as it is after reset: both directions
 * @engine: engine
 */
void axi_mcdma_reset(struct axi_engine *engine)
{
	int way, i;

	for (way = 0; way < 2; way++) {
		engine->channels[way].cr = 0;
		engine->channels[way].sr = SR_HALTED;
		engine->channels[way].resets++;
		engine->chen[way] = 0;
		engine->errors[way] = 0;
		for (i = 0; i < AXI_MC_CHANNELS; i++)
			reset_channel(&engine->mc[way][i]);
	}
}

static u32 pending(const struct axi_engine *engine, int way)
{
	u32 bits = 0;
	int i;

	for (i = 0; i < AXI_MC_CHANNELS; i++) {
		const struct axi_channel *channel = &engine->mc[way][i];

		bits |= channel->sr & channel->cr & AXI_MC_IRQS ? BIT(i) : 0;
	}
	return bits;
}

static struct axi_channel *channel_at(struct axi_engine *engine, int way, u32 offset)
{
	u32 number = (offset - FIRST) / NEXT;

	return offset >= FIRST && number < AXI_MC_CHANNELS ? &engine->mc[way][number] : NULL;
}

static u32 read_channel(const struct axi_channel *channel, u32 reg)
{
	switch (reg) {
	case CR:
		return channel->cr;
	case SR:
		return channel->sr | FIELD_PREP(MCDMA_THRESHOLD, channel->countdown);
	case CDESC:
		return lower_32_bits(channel->curdesc);
	case CDESC_MSB:
		return upper_32_bits(channel->curdesc);
	case TDESC:
		return lower_32_bits(channel->taildesc);
	case TDESC_MSB:
		return upper_32_bits(channel->taildesc);
	default:
		return 0;
	}
}

/**
 * axi_mcdma_read() - read a register
 * @engine: engine
 * @offset: in the window
 *
 * Return: the value.
 */
u32 axi_mcdma_read(struct axi_engine *engine, u32 offset)
{
	int way = offset >= S2MM;
	u32 reg = offset - way * S2MM;
	struct axi_channel *channel = channel_at(engine, way, reg);

	if (channel)
		return read_channel(channel, (reg - FIRST) % NEXT);
	if (reg == DMACR)
		return engine->channels[way].cr;
	if (reg == DMASR)
		return engine->channels[way].sr;
	if (reg == CHEN)
		return engine->chen[way];
	if (reg == ERR)
		return engine->errors[way];
	return reg == (way ? RXINT_SER : TXINT_SER) ? pending(engine, way) : 0;
}

static void write_channel(struct axi_channel *channel, u32 reg, u32 value)
{
	u64 low = GENMASK_ULL(31, 0);

	switch (reg) {
	case CR:
		if (FIELD_GET(MCDMA_THRESHOLD, value) != FIELD_GET(MCDMA_THRESHOLD, channel->cr))
			channel->countdown = FIELD_GET(MCDMA_THRESHOLD, value);
		channel->cr = value;
		return;
	case SR:
		channel->sr &= ~(value & AXI_MC_IRQS);
		return;
	case CDESC:
		channel->curdesc = (channel->curdesc & ~low) | (value & ~0x3f);
		channel->begun = false;
		return;
	case CDESC_MSB:
		channel->curdesc = (channel->curdesc & low) | (u64)value << 32;
		return;
	case TDESC:
		channel->taildesc = (channel->taildesc & ~low) | (value & ~0x3f);
		channel->armed = true;
		return;
	case TDESC_MSB:
		channel->taildesc = (channel->taildesc & low) | (u64)value << 32;
		return;
	default:
		channel->misuse++;
	}
}

static void write_control(struct axi_engine *engine, int way, u32 value)
{
	struct axi_channel *common = &engine->channels[way];
	int i;

	if (value & CR_RESET) {
		axi_mcdma_reset(engine);
		return;
	}
	common->cr = value & CR_RS;
	if (value & CR_RS) {
		common->sr &= ~SR_HALTED;
		return;
	}
	common->sr |= SR_HALTED;
	for (i = 0; i < AXI_MC_CHANNELS; i++)
		engine->mc[way][i].armed = false;
}

/**
 * axi_mcdma_write() - write a register
 * @engine: engine
 * @offset: in the window
 * @value: value
 */
void axi_mcdma_write(struct axi_engine *engine, u32 offset, u32 value)
{
	int way = offset >= S2MM;
	u32 reg = offset - way * S2MM;
	struct axi_channel *channel = channel_at(engine, way, reg);

	if (channel)
		write_channel(channel, (reg - FIRST) % NEXT, value);
	else if (reg == DMACR)
		write_control(engine, way, value);
	else if (reg == CHEN)
		engine->chen[way] = value;
	else
		engine->channels[way].misuse++;
}
