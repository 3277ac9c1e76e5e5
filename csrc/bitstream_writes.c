// SPDX-License-Identifier: Apache-2.0
#include "bitstream_private.h"

/* Writes of registers: their CRC and their events. */

static void check_crc(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	emit(sink, (struct cm_config_event){ .word = port->start,
					     .kind = CM_CONFIG_CRC,
					     .value = word,
					     .count = port->crc,
					     .extra = port->pending });
	port->crc = 0;
	port->pending = 0;
	port->pending_frames = 0;
}

static void cover(struct cm_config_port *port, int frames)
{
	port->pending++;
	port->pending_frames += frames != 0;
}

static void command(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	struct cm_config_event event = {
		.word = port->start, .kind = CM_CONFIG_WRITE, .reg = REG_CMD, .value = word
	};

	if (word == CMD_WCFG || word == CMD_MFW) {
		cover(port, 1); /* one for each FAR in a compressed stream: too many to report */
		return;
	}
	event.count = port->pending;
	event.extra = port->pending_frames;
	cover(port, 0);
	if (word == CMD_RCRC) {
		port->crc = 0;
		port->pending = 0;
		port->pending_frames = 0;
	} else if (word == CMD_DESYNC) {
		event.kind = CM_CONFIG_DESYNC;
		port->state = STATE_UNSYNCED;
		port->strays = 0;
	}
	emit(sink, event);
}

static void set_register(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	emit(sink, (struct cm_config_event){ .word = port->start,
					     .kind = CM_CONFIG_WRITE,
					     .reg = port->reg,
					     .value = word });
	cover(port, 0);
	if (port->reg == REG_DWC && word > 0) {
		emit(sink, (struct cm_config_event){ .word = port->position + 1,
						     .kind = CM_CONFIG_OPAQUE,
						     .count = word });
		port->state = STATE_OPAQUE;
		port->left = word;
	}
}

/* The one word of a packet to any register but FDRI, MFWR and CBC. */
void cm_config_register_word(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	port->state = STATE_HEADER;
	if (port->reg == REG_CRC) {
		check_crc(port, sink, word);
		return;
	}
	/*
	 * One flipped bit in the header of a CRC packet makes it a write of something else. Then the
	 * value written is still the CRC of what went before, which reveals it.
	 */
	if (port->pending > 0 && word == port->crc) {
		fault(port, sink, CM_FAULT_DISGUISED, word);
		return;
	}
	if (port->reg ==
	    REG_LOUT) { /* goes to the DOUT pin: not covered by any CRC that Vivado writes */
		port->state = STATE_HEADER;
		return;
	}
	port->crc = cm_config_crc_word(port->crc, port->reg, word);
	if (port->reg == REG_FAR) {
		port->far = word;
		port->far_words = 0;
		cover(port, 1);
	} else if (port->reg == REG_CMD) {
		command(port, sink, word);
	} else {
		set_register(port, sink, word);
	}
}

/* Compressed streams hold thousands of MFWR packets to neighbouring frames: one event for a run
 * of them, which never goes on into the next column. */
static int joins_last(const struct sink *sink, const struct cm_config_event *event)
{
	struct cm_config_event *last = sink->made > 0 ? &sink->events[sink->made - 1] : NULL;

	if (last == NULL || last->kind != CM_CONFIG_MULTI || last->count != event->count ||
	    last->value + last->frames != event->value || (event->value & 127) == 0)
		return 0;
	last->frames++;
	last->extra |= event->extra;
	return 1;
}

static void end_multi(struct cm_config_port *port, struct sink *sink)
{
	const struct cm_config_event event = { .word = port->start,
					       .kind = CM_CONFIG_MULTI,
					       .reg = port->reg,
					       .value = port->far,
					       .count = port->count,
					       .extra = port->accumulated,
					       .frames = 1 };

	if (!joins_last(sink, &event))
		emit(sink, event);
}

static void end_run(struct cm_config_port *port, struct sink *sink)
{
	emit(sink, (struct cm_config_event){ .word = port->start,
					     .kind = CM_CONFIG_FRAMES,
					     .reg = port->reg,
					     .value = port->far,
					     .count = port->count,
					     .extra = port->far_words });
	port->far_words += port->count;
}

static void end_bulk(struct cm_config_port *port, struct sink *sink)
{
	port->state = STATE_HEADER;
	cover(port, port->reg != REG_CBC);
	if (port->reg == REG_MFWR)
		end_multi(port, sink);
	else if (port->reg == REG_FDRI)
		end_run(port, sink);
	else
		emit(sink, (struct cm_config_event){ .word = port->start,
						     .kind = CM_CONFIG_WRITE,
						     .reg = port->reg,
						     .count = port->count });
}

static void keep_head(struct cm_config_port *port, const uint8_t *words, size_t count, int swapped)
{
	for (; count > 0 && port->head_count < CM_CONFIG_HEAD; count--, words += 4)
		port->head[port->head_count++] = load(words, swapped);
}

/* Words of FDRI, MFWR or CBC: as many as are here. */
size_t cm_config_bulk_words(struct cm_config_port *port, struct sink *sink, const uint8_t *words,
			    size_t count, int swapped)
{
	const size_t run = count < port->left ? count : port->left;

	port->crc = cm_config_crc(port->crc, port->reg, words, run, swapped);
	if (port->reg == REG_FDRI)
		keep_head(port, words, run, swapped);
	else
		for (size_t i = 0; i < run; i++)
			port->accumulated |= load(words + 4 * i, swapped);
	port->left -= (uint32_t)run;
	if (port->left == 0)
		end_bulk(port, sink);
	return run;
}
