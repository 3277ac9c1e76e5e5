// SPDX-License-Identifier: GPL-2.0-only
/* Frames that can be told apart and checked. */
#include <linux/ktime.h>
#include <linux/math64.h>
#include <linux/overflow.h>
#include <linux/slab.h>
#include <asm/byteorder.h>

#include "plsim.h"

/**
 * plsim_packet_new() - memory for a packet
 * @length: bytes
 *
 * Return: a packet to be given to kvfree(), or NULL.
 */
struct plsim_packet *plsim_packet_new(size_t length)
{
	struct plsim_packet *packet = kvmalloc(struct_size(packet, data, length), GFP_KERNEL);

	if (packet) {
		INIT_LIST_HEAD(&packet->node);
		packet->length = length;
		packet->taken = 0;
	}
	return packet;
}

/**
 * plsim_pattern() - what a source's frame holds
 * @data: filled in, aligned to 4 bytes
 * @length: bytes
 * @frame: its number, from 0
 *
 * Little-endian 32-bit words that count up, and begin with the frame's number;
 * what is left of a word at the end is filled with its low bytes.
 */
void plsim_pattern(u8 *data, size_t length, u64 frame)
{
	u32 word = frame;
	__le32 *words = (__le32 *)data;
	size_t i;

	for (i = 0; i + sizeof(word) <= length; i += sizeof(word))
		*words++ = cpu_to_le32(word++);
	for (; i < length; i++, word >>= 8)
		data[i] = word;
}

static bool frame_due(struct plsim_chan *chan)
{
	u64 interval = (u64)READ_ONCE(chan->interval_us) * NSEC_PER_USEC;
	u64 now = ktime_get_ns();
	u64 missed;

	if (!interval)
		return true;
	if (!chan->next_frame)
		chan->next_frame = now;
	if (now < chan->next_frame)
		return false;
	/* a camera does not wait: what was not taken is gone */
	missed = div64_u64(now - chan->next_frame, interval);
	chan->frames += missed;
	chan->lost += missed;
	chan->next_frame += (missed + 1) * interval;
	return true;
}

/**
 * plsim_source_frame() - the next frame of a source
 * @chan: channel
 *
 * Return: a packet, or NULL if none is due yet, or there is no memory.
 */
struct plsim_packet *plsim_source_frame(struct plsim_chan *chan)
{
	struct plsim_packet *packet;

	if (!frame_due(chan))
		return NULL;
	packet = plsim_packet_new(chan->frame_length);
	if (packet)
		plsim_pattern(packet->data, packet->length, chan->frames++);
	return packet;
}
