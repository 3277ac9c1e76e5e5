/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Configuration packets of AMD 7-series and UltraScale+ devices (UG470, UG570), word by word.
 *
 * A port consumes 32-bit words as the device's configuration logic does and reports what happened
 * as events.  It owns nothing and allocates nothing: the caller owns the structure, the words and
 * the array of events.  It never blocks and cannot fail; what it does not understand is an event
 * (CM_CONFIG_FAULT), after which the rest of the words is consumed without looking at them.
 */
#ifndef CM_BITSTREAM_H
#define CM_BITSTREAM_H

#include <stddef.h>
#include <stdint.h>

#define CM_CONFIG_HEAD 128 /* words kept of the newest FDRI run: one frame of any family */

enum cm_config_event_kind {
	CM_CONFIG_SYNC = 1, /* the sync word */
	CM_CONFIG_WRITE =
		2, /* a register was written: reg, value; RCRC: count, extra as for DESYNC */
	CM_CONFIG_FRAMES = 3, /* FDRI: count words at FAR value; extra: words since FAR was set */
	CM_CONFIG_MULTI = 4,  /* MFWR: count words at FAR value; extra: all of them OR-ed */
	CM_CONFIG_CRC =
		5, /* CRC register: value as written, count as computed, extra: writes it covers */
	CM_CONFIG_DESYNC =
		6, /* count: writes since CRC or RCRC, extra: those of them that touch frames */
	CM_CONFIG_FILL = 7,   /* count zero words between packets */
	CM_CONFIG_STRAY = 8,  /* the first word outside of sync that is not padding: value */
	CM_CONFIG_OPAQUE = 9, /* count words of ciphertext follow (DWC) */
	CM_CONFIG_FAULT = 10, /* reg: enum cm_config_fault, value: the word */
};

enum cm_config_fault {
	CM_FAULT_TYPE = 1,	/* packet type that does not exist */
	CM_FAULT_OPCODE = 2,	/* read, reserved, or a NOP that is not exactly 20000000 */
	CM_FAULT_REGISTER = 3,	/* register that no bitstream writes */
	CM_FAULT_COUNT = 4,	/* word count that this register cannot have */
	CM_FAULT_ORDER = 5,	/* type 2 without its type 1, or a type 1 without its type 2 */
	CM_FAULT_DISGUISED = 6, /* the CRC of what went before, written to another register */
};

struct cm_config_event {
	uint64_t
		word; /* position in words since the port was reset: the packet's header or first word */
	uint32_t kind;
	uint32_t reg;
	uint32_t value;
	uint32_t count;
	uint32_t extra;
	uint32_t frames; /* MULTI: packets told of at once, at FAR value, value + 1, … */
};

struct cm_config_port {
	uint64_t position;    /* words consumed */
	uint64_t start;	      /* position of the packet, or fill, under way */
	uint32_t state;	      /* enum in bitstream.c; 0: out of sync */
	uint32_t reg;	      /* register of the packet under way */
	uint32_t count;	      /* words of the packet under way */
	uint32_t left;	      /* of them, still to come */
	uint32_t accumulated; /* OR of the packet's words */
	uint32_t crc;
	uint32_t pending;	 /* writes since CRC or RCRC */
	uint32_t pending_frames; /* of them, writes of FAR, FDRI, MFWR, CMD=WCFG and CMD=MFW */
	uint32_t far;
	uint32_t far_words; /* FDRI words since FAR was written */
	uint32_t strays;    /* stray words since the last DESYNC */
	uint32_t
		capture; /* not 0: cm_config_feed returns after each FRAMES event, so `head` is its */
	uint32_t head_count;
	uint32_t head[CM_CONFIG_HEAD];
};

/* Put `port` where a device is after power-on: out of sync, CRC 0.  Keeps nothing. */
void cm_config_reset(struct cm_config_port *port, uint32_t capture);

/*
 * Consume up to `count` words at `words` (any alignment; `swapped`: each word's bytes reversed, as
 * a DMA-fed ICAP reads them from memory) and write at most `capacity` (at least 2) events.
 *
 * Returns the words consumed, fewer than `count` when the events are full or a capture stopped it;
 * call again with the rest.  `*made` gets the number of events.
 */
size_t cm_config_feed(struct cm_config_port *port, const uint8_t *words, size_t count, int swapped,
		      struct cm_config_event *events, size_t capacity, size_t *made);

/* 1 while a packet is incomplete, 2 while in sync between packets, 0 out of sync, 3 after a fault. */
int cm_config_phase(const struct cm_config_port *port);

/* CRC-32C over 37 bits for each word: its 32, then the 5 of the register's address. */
uint32_t cm_config_crc(uint32_t crc, uint32_t reg, const uint8_t *words, size_t count, int swapped);

/* Reverse the bytes of each of `count` words; `to` may be `from`, else they must not overlap. */
void cm_config_swap(uint8_t *to, const uint8_t *from, size_t count);

#endif
