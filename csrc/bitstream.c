// SPDX-License-Identifier: Apache-2.0
#include "bitstream_private.h"

#define SYNC_WORD 0xAA995566u
#define NOP_WORD 0x20000000u
#define DUMMY_WORD 0xFFFFFFFFu
#define BUS_WIDTH_SYNC 0x000000BBu
#define BUS_WIDTH_DETECT 0x11220044u

/* CRC, FAR, FDRI, CMD, CTL0, MASK, LOUT, COR0, MFWR, CBC, IDCODE, AXSS, COR1, WBSTAR, TIMER, RBCRC_SW, CTL1, DWC, BSPI */
#define WRITABLE                                                                                 \
	(1u << 0 | 1u << 1 | 1u << 2 | 1u << 4 | 1u << 5 | 1u << 6 | 1u << 8 | 1u << 9 |         \
	 1u << 10 | 1u << 11 | 1u << 12 | 1u << 13 | 1u << 14 | 1u << 16 | 1u << 17 | 1u << 19 | \
	 1u << 24 | 1u << 26 | 1u << 31)

void cm_config_reset(struct cm_config_port *port, uint32_t capture)
{
	memset(port, 0, sizeof(*port));
	port->capture = capture;
}

int cm_config_phase(const struct cm_config_port *port)
{
	switch (port->state) {
	case STATE_UNSYNCED:
		return 0;
	case STATE_HEADER:
	case STATE_FILL:
		return 2;
	case STATE_FAULT:
		return 3;
	default:
		return 1;
	}
}

static void unsynced_word(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	if (word == SYNC_WORD) {
		emit(sink,
		     (struct cm_config_event){ .word = port->position, .kind = CM_CONFIG_SYNC });
		port->state = STATE_HEADER;
	} else if (word != DUMMY_WORD && word != NOP_WORD && word != BUS_WIDTH_SYNC &&
		   word != BUS_WIDTH_DETECT) {
		if (port->strays++ == 0)
			emit(sink, (struct cm_config_event){ .word = port->position,
							     .kind = CM_CONFIG_STRAY,
							     .value = word });
	}
}

static void begin_data(struct cm_config_port *port, uint32_t count)
{
	port->state = STATE_DATA;
	port->count = count;
	port->left = count;
	port->accumulated = 0;
	if (port->reg == REG_FDRI)
		port->head_count = 0;
}

static void type1_header(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	const uint32_t reg = word >> 13 & 0x1F;
	const uint32_t count = word & 0x7FF;

	if ((word >> 27 & 3) != 2) {
		fault(port, sink, CM_FAULT_OPCODE, word);
	} else if ((word & 0x07FC1800u) != 0 || (WRITABLE >> reg & 1) == 0) {
		fault(port, sink, CM_FAULT_REGISTER, word);
	} else if (count != 1 && !is_bulk(reg)) {
		fault(port, sink, CM_FAULT_COUNT, word);
	} else {
		port->start = port->position;
		port->reg = reg;
		begin_data(port, count);
		if (count == 0)
			port->state = STATE_TYPE2;
	}
}

/* A debug bitstream has padding frames between its packets; the CRC covers them as frame data. */
static void begin_fill(struct cm_config_port *port)
{
	port->count = 1;
	port->crc = cm_config_crc_word(port->crc, REG_FDRI, 0);
}

static void header_word(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	if (word >> 29 == 1) {
		type1_header(port, sink, word);
	} else if (word == 0) {
		port->state = STATE_FILL;
		port->start = port->position;
		begin_fill(port);
	} else if (word >> 29 == 2) {
		fault(port, sink, CM_FAULT_ORDER, word);
	} else {
		fault(port, sink, CM_FAULT_TYPE, word);
	}
}

static void type2_word(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	const uint32_t count = word & 0x07FFFFFF;

	if (word >> 29 != 2)
		fault(port, sink, CM_FAULT_ORDER, word);
	else if ((word >> 27 & 3) != 2)
		fault(port, sink, CM_FAULT_OPCODE, word);
	else if (count == 0)
		fault(port, sink, CM_FAULT_COUNT, word);
	else
		begin_data(port, count);
}

/* Returns 1 when the fill has ended and the word has yet to be processed. */
static int fill_word(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	if (word == 0) {
		port->count++;
		port->crc = cm_config_crc_word(port->crc, REG_FDRI, 0);
		return 0;
	}
	emit(sink, (struct cm_config_event){
			   .word = port->start, .kind = CM_CONFIG_FILL, .count = port->count });
	port->state = STATE_HEADER;
	return 1;
}

static size_t opaque_words(struct cm_config_port *port, size_t count)
{
	const size_t run = count < port->left ? count : port->left;

	port->left -= (uint32_t)run;
	if (port->left == 0)
		port->state = STATE_HEADER;
	return run;
}

static size_t data_words(struct cm_config_port *port, struct sink *sink, const uint8_t *words,
			 size_t count, int swapped)
{
	if (is_bulk(port->reg))
		return cm_config_bulk_words(port, sink, words, count, swapped);
	cm_config_register_word(port, sink, load(words, swapped));
	return 1;
}

/* NOPs come in hundreds: all that are here, or else one packet header and the words behind it. */
static size_t header_words(struct cm_config_port *port, struct sink *sink, const uint8_t *words,
			   size_t count, int swapped)
{
	size_t used = 0;

	while (used < count && load(words + 4 * used, swapped) == NOP_WORD)
		used++;
	if (used > 0)
		return used;
	header_word(port, sink, load(words, swapped));
	if (port->state == STATE_DATA && count > 1) {
		port->position++; /* that of the current word, while it is processed */
		used = data_words(port, sink, words + 4, count - 1, swapped);
		port->position--;
	}
	return 1 + used;
}

/* Consume at least one word, or (at the end of a fill) none but make one event; at most two events. */
static size_t step(struct cm_config_port *port, struct sink *sink, const uint8_t *words,
		   size_t count, int swapped)
{
	switch (port->state) {
	case STATE_UNSYNCED:
		unsynced_word(port, sink, load(words, swapped));
		return 1;
	case STATE_HEADER:
		return header_words(port, sink, words, count, swapped);
	case STATE_TYPE2:
		type2_word(port, sink, load(words, swapped));
		return 1;
	case STATE_FILL:
		return fill_word(port, sink, load(words, swapped)) ? 0 : 1;
	case STATE_OPAQUE:
		return opaque_words(port, count);
	case STATE_DATA:
		return data_words(port, sink, words, count, swapped);
	default:
		return count;
	}
}

size_t cm_config_feed(struct cm_config_port *port, const uint8_t *words, size_t count, int swapped,
		      struct cm_config_event *events, size_t capacity, size_t *made)
{
	struct sink sink = { .events = events, .capacity = capacity };
	size_t done = 0;

	while (done < count && sink.made + 2 <= sink.capacity) {
		const size_t before = sink.made;
		const size_t used = step(port, &sink, words + 4 * done, count - done, swapped);

		done += used;
		port->position += used;
		if (port->capture != 0 && sink.made > before &&
		    sink.events[sink.made - 1].kind == CM_CONFIG_FRAMES)
			break;
	}
	*made = sink.made;
	return done;
}
