/* SPDX-License-Identifier: Apache-2.0 */
/* Shared by the units behind bitstream.h. bitstream.c calls bitstream_writes.c, both call bitstream_crc.c. */
#ifndef CM_BITSTREAM_PRIVATE_H
#define CM_BITSTREAM_PRIVATE_H

#include "bitstream.h"

#include <string.h>

enum {
	REG_CRC = 0,
	REG_FAR = 1,
	REG_FDRI = 2,
	REG_CMD = 4,
	REG_LOUT = 8,
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

/* Where events go; it has room for as many as one step can make. */
struct sink {
	struct cm_config_event *events;
	size_t capacity;
	size_t made;
};

static inline void emit(struct sink *sink, struct cm_config_event event)
{
	sink->events[sink->made++] = event;
}

static inline void fault(struct cm_config_port *port, struct sink *sink, uint32_t reason,
			 uint32_t word)
{
	port->state = STATE_FAULT;
	emit(sink, (struct cm_config_event){ .word = port->position,
					     .kind = CM_CONFIG_FAULT,
					     .reg = reason,
					     .value = word });
}

static inline int is_bulk(uint32_t reg)
{
	return reg == REG_FDRI || reg == REG_MFWR || reg == REG_CBC;
}

/* cm_config_crc() for one word at hand; `reg` is below 32. */
uint32_t cm_config_crc_word(uint32_t crc, uint32_t reg, uint32_t word);

/* The one word of a packet to any register that is not bulk. */
void cm_config_register_word(struct cm_config_port *port, struct sink *sink, uint32_t word);

/* Words of a packet to a bulk register: takes as many as are here, and returns how many that was. */
size_t cm_config_bulk_words(struct cm_config_port *port, struct sink *sink, const uint8_t *words,
			    size_t count, int swapped);

#endif
