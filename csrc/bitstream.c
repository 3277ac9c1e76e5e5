// SPDX-License-Identifier: Apache-2.0
#include "bitstream.h"

#include <string.h>

#define SYNC_WORD 0xAA995566u
#define NOP_WORD 0x20000000u
#define DUMMY_WORD 0xFFFFFFFFu
#define BUS_WIDTH_SYNC 0x000000BBu
#define BUS_WIDTH_DETECT 0x11220044u

#define POLYNOMIAL 0x82F63B78u /* CRC-32C, reflected */
#define ADDRESS_BITS 5
#define SLICES 4 /* words taken at once */

enum {
	REG_CRC = 0,
	REG_FAR = 1,
	REG_FDRI = 2,
	REG_CMD = 4,
	REG_MFWR = 10,
	REG_CBC = 11,
	REG_DWC = 26,
};

enum {
	CMD_WCFG = 1,
	CMD_MFW = 2,
	CMD_RCRC = 7,
	CMD_DESYNC = 13,
};

enum state {
	STATE_UNSYNCED = 0,
	STATE_HEADER = 1,
	STATE_TYPE2 = 2, /* a type 1 with count 0 was read: its type 2 must follow */
	STATE_DATA = 3,
	STATE_FILL = 4,
	STATE_OPAQUE = 5,
	STATE_FAULT = 6,
};

/* CRC, FAR, FDRI, CMD, CTL0, MASK, LOUT, COR0, MFWR, CBC, IDCODE, AXSS, COR1, WBSTAR, TIMER, RBCRC_SW, CTL1, DWC, BSPI */
#define WRITABLE                                                                                 \
	(1u << 0 | 1u << 1 | 1u << 2 | 1u << 4 | 1u << 5 | 1u << 6 | 1u << 8 | 1u << 9 |         \
	 1u << 10 | 1u << 11 | 1u << 12 | 1u << 13 | 1u << 14 | 1u << 16 | 1u << 17 | 1u << 19 | \
	 1u << 24 | 1u << 26 | 1u << 31)

/* tables[j][k][b]: what byte k with value b, fed j + 1 words before the end, adds to the CRC. */
static uint32_t tables[SLICES][4][256];
/* What a register's address adds to the CRC of one word, and of SLICES words. */
static uint32_t address_of_one[1 << ADDRESS_BITS];
static uint32_t address_of_all[1 << ADDRESS_BITS];

static uint32_t shift(uint32_t crc, int bits)
{
	while (bits-- > 0)
		crc = crc >> 1 ^ (POLYNOMIAL & -(crc & 1));
	return crc;
}

static inline uint32_t load(const uint8_t *at, int swapped)
{
	uint32_t word;

	memcpy(&word, at, sizeof(word));
#if __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
	return swapped ? word : __builtin_bswap32(word);
#else
	return swapped ? __builtin_bswap32(word) : word;
#endif
}

static inline uint32_t look_up(int words, uint32_t value)
{
	return tables[words][0][value & 255] ^ tables[words][1][value >> 8 & 255] ^
	       tables[words][2][value >> 16 & 255] ^ tables[words][3][value >> 24];
}

/* `address` is that of address_of_one. */
static inline uint32_t crc_word(uint32_t crc, uint32_t address, uint32_t word)
{
	return look_up(0, crc ^ word) ^ address;
}

/* Runs once when the module is loaded, before any thread can call; the tables are constant from then on. */
__attribute__((constructor)) static void make_tables(void)
{
	for (int byte = 0; byte < 4; byte++) {
		for (uint32_t value = 0; value < 256; value++) {
			uint32_t crc = value << (8 * byte);

			for (int words = 0; words < SLICES; words++) {
				crc = shift(crc, 32 + ADDRESS_BITS);
				tables[words][byte][value] = crc;
			}
		}
	}
	for (uint32_t reg = 0; reg < 1 << ADDRESS_BITS; reg++) {
		address_of_one[reg] = shift(reg, ADDRESS_BITS);
		for (int words = 0; words < SLICES; words++)
			address_of_all[reg] = crc_word(address_of_all[reg], address_of_one[reg], 0);
	}
}

static inline uint32_t crc_run(uint32_t crc, uint32_t reg, const uint8_t *words, size_t count,
			       int swapped)
{
	const uint32_t one = address_of_one[reg];
	const uint32_t all = address_of_all[reg];

	for (; count >= SLICES; count -= SLICES, words += 4 * SLICES)
		crc = look_up(3, crc ^ load(words, swapped)) ^
		      look_up(2, load(words + 4, swapped)) ^ look_up(1, load(words + 8, swapped)) ^
		      look_up(0, load(words + 12, swapped)) ^ all;
	for (; count > 0; count--, words += 4)
		crc = crc_word(crc, one, load(words, swapped));
	return crc;
}

uint32_t cm_config_crc(uint32_t crc, uint32_t reg, const uint8_t *words, size_t count, int swapped)
{
	/* Two copies, so that the byte order is no question inside the loop. */
	reg &= (1u << ADDRESS_BITS) - 1;
	return swapped ? crc_run(crc, reg, words, count, 1) : crc_run(crc, reg, words, count, 0);
}

void cm_config_swap(uint8_t *to, const uint8_t *from, size_t count)
{
	for (size_t i = 0; i < count; i++) {
		uint32_t word;

		memcpy(&word, from + 4 * i, sizeof(word));
		word = __builtin_bswap32(word);
		memcpy(to + 4 * i, &word, sizeof(word));
	}
}

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

struct sink {
	struct cm_config_event *events;
	size_t capacity;
	size_t made;
};

static void emit(struct sink *sink, struct cm_config_event event)
{
	sink->events[sink->made++] = event;
}

static void fault(struct cm_config_port *port, struct sink *sink, uint32_t reason, uint32_t word)
{
	port->state = STATE_FAULT;
	emit(sink, (struct cm_config_event){ .word = port->position,
					     .kind = CM_CONFIG_FAULT,
					     .reg = reason,
					     .value = word });
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
	const int bulk = reg == REG_FDRI || reg == REG_MFWR || reg == REG_CBC;

	if ((word >> 27 & 3) != 2) {
		fault(port, sink, CM_FAULT_OPCODE, word);
	} else if ((word & 0x07FC1800u) != 0 || (WRITABLE >> reg & 1) == 0) {
		fault(port, sink, CM_FAULT_REGISTER, word);
	} else if (count != 1 && !bulk) {
		fault(port, sink, CM_FAULT_COUNT, word);
	} else {
		port->start = port->position;
		port->reg = reg;
		begin_data(port, count);
		if (count == 0)
			port->state = STATE_TYPE2;
	}
}

static void header_word(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	if (word >> 29 == 1) {
		type1_header(port, sink, word);
	} else if (word == 0) {
		port->state = STATE_FILL;
		port->start = port->position;
		port->count = 1;
	} else if (word >> 29 == 2) {
		fault(port, sink, CM_FAULT_ORDER, word);
	} else {
		fault(port, sink, CM_FAULT_TYPE, word);
	}
}

/* NOPs come in hundreds: all that are here, or else the one packet header. */
static size_t header_words(struct cm_config_port *port, struct sink *sink, const uint8_t *words,
			   size_t count, int swapped)
{
	size_t nops = 0;

	while (nops < count && load(words + 4 * nops, swapped) == NOP_WORD)
		nops++;
	if (nops > 0)
		return nops;
	header_word(port, sink, load(words, swapped));
	return 1;
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

/* Returns 1 when the fill has ended and the word is still to be looked at. */
static int fill_word(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	if (word == 0) {
		port->count++;
		return 0;
	}
	emit(sink, (struct cm_config_event){
			   .word = port->start, .kind = CM_CONFIG_FILL, .count = port->count });
	port->state = STATE_HEADER;
	return 1;
}

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
		cover(port, 1); /* one for each FAR in a compressed stream: too many to tell of */
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
static void register_word(struct cm_config_port *port, struct sink *sink, uint32_t word)
{
	port->state = STATE_HEADER;
	if (port->reg == REG_CRC) {
		check_crc(port, sink, word);
		return;
	}
	/*
	 * One flipped bit in the header of a CRC packet makes it a write of something else. Then the
	 * value written is still the CRC of what went before: that is how it is found out.
	 */
	if (port->pending > 0 && word == port->crc) {
		fault(port, sink, CM_FAULT_DISGUISED, word);
		return;
	}
	port->crc = crc_word(port->crc, address_of_one[port->reg], word);
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
static size_t bulk_words(struct cm_config_port *port, struct sink *sink, const uint8_t *words,
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

static size_t opaque_words(struct cm_config_port *port, size_t count)
{
	const size_t run = count < port->left ? count : port->left;

	port->left -= (uint32_t)run;
	if (port->left == 0)
		port->state = STATE_HEADER;
	return run;
}

static int is_bulk(const struct cm_config_port *port)
{
	return port->reg == REG_FDRI || port->reg == REG_MFWR || port->reg == REG_CBC;
}

/* Consume at least one word, or (end of a fill) none with one event made; at most two events. */
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
		if (is_bulk(port))
			return bulk_words(port, sink, words, count, swapped);
		register_word(port, sink, load(words, swapped));
		return 1;
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
