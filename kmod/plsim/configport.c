// SPDX-License-Identifier: GPL-2.0-only
/*
 * The packet processor of a configuration port, as far as a load can fail in
 * it: sync word, packets, CRC and IDCODE (UG470, chapter 5), and as far as frames
 * are written and read back (chapter 6).
 */
#include <linux/bitfield.h>
#include <linux/bits.h>
#include <linux/kernel.h>

#include "cm_icap.h"
#include "configport.h"

#define SYNC_WORD 0xAA995566
#define CRC32C_REFLECTED 0x82F63B78

#define PACKET_TYPE GENMASK(31, 29)
#define PACKET_OP GENMASK(28, 27)
#define PACKET_REGISTER GENMASK(17, 13)
#define PACKET_COUNT1 GENMASK(10, 0)
#define PACKET_COUNT2 GENMASK(26, 0)
#define OP_NOP 0
#define OP_READ 1
#define OP_WRITE 2

#define REG_CRC 0
#define REG_FAR 1
#define REG_FDRI 2
#define REG_FDRO 3
#define REG_CMD 4
#define REG_STAT 7
#define REG_MFWR 10
#define REG_IDCODE 12
#define CMD_RCFG 4
#define CMD_RCRC 7
/* of a device that runs (table 5-28) */
#define STAT_RUNNING 0x000078FC
#define CMD_DESYNC 13

/* the top nibble is the silicon's revision */
#define IDCODE_MASK GENMASK(27, 0)

/**
 * cm_configport_crc() - one register write added to the CRC
 * @crc: value so far
 * @address: register
 * @data: word
 *
 * Return: CRC-32C over 37 bits more, the 32 of the word and 5 of the address.
 */
u32 cm_configport_crc(u32 crc, u32 address, u32 data)
{
	u64 bits = (u64)(address & 0x1f) << 32 | data;
	int i;

	for (i = 0; i < 37; i++, bits >>= 1)
		crc = crc >> 1 ^ ((crc ^ bits) & 1 ? CRC32C_REFLECTED : 0);
	return crc;
}

/**
 * cm_configport_begin() - a load starts, or what closes a read
 * @port: port; what an aborted load left is forgotten
 */
void cm_configport_begin(struct cm_configport *port)
{
	/* behind a read the port is still in sync */
	port->synced = port->synced && port->asked;
	port->seen_sync = port->synced;
	port->asked = 0;
	port->remaining = 0;
	port->crc = 0;
	port->words = 0;
	port->frame_words = 0;
	port->crc_checks = 0;
	port->errors = 0;
}

static void check_crc(struct cm_configport *port, u32 word)
{
	if (word != port->crc)
		port->errors |= CM_ICAP_ERR_CRC;
	port->crc_checks++;
	port->crc = 0;
}

static u32 current_far(struct cm_configport *port)
{
	return cm_frames_at(port->frames, port->far, port->place, port->number);
}

static void start_frames(struct cm_configport *port, u32 far)
{
	port->far = far;
	port->number = 0;
	port->column = 0;
	port->full = false;
	if (port->frames)
		port->place = cm_frames_place(port->frames, far);
}

/* the last frame of a run stays in the buffer: the one behind it would push it out */
static void frame_word(struct cm_configport *port, u32 word)
{
	struct cm_frames *frames = port->frames;

	frames->arriving[port->column++] = word;
	if (port->column < CM_FRAME_WORDS)
		return;
	port->column = 0;
	if (port->full) {
		cm_frames_store(frames, current_far(port), frames->buffer);
		port->number++;
	}
	memcpy(frames->buffer, frames->arriving, sizeof(frames->buffer));
	port->full = true;
}

/* the frame in the buffer once more (compressed bitstreams) */
static void frame_again(struct cm_configport *port)
{
	if (port->remaining)
		return;
	cm_frames_store(port->frames, current_far(port), port->frames->buffer);
	port->number++;
}

/* the first frame that is read is what was in the buffer */
static u32 read_frame_word(struct cm_configport *port)
{
	struct cm_frames *frames = port->frames;
	u32 word = frames->buffer[port->column];

	if (!port->column)
		cm_frames_fetch(frames, current_far(port), frames->arriving);
	frames->buffer[port->column] = frames->arriving[port->column];
	if (++port->column == CM_FRAME_WORDS) {
		port->column = 0;
		port->number++;
	}
	return word;
}

static void command(struct cm_configport *port, u32 word)
{
	port->command = word;
	if (word == CMD_RCRC)
		port->crc = 0;
	else if (word == CMD_DESYNC)
		port->synced = false;
}

static void check_idcode(struct cm_configport *port, u32 word)
{
	if (port->idcode && (word ^ port->idcode) & IDCODE_MASK)
		port->errors |= CM_ICAP_ERR_ID;
}

static void write_register(struct cm_configport *port, u32 word)
{
	if (port->address == REG_CRC) {
		check_crc(port, word);
		return;
	}
	port->crc = cm_configport_crc(port->crc, port->address, word);
	if (port->address == REG_CMD)
		command(port, word);
	else if (port->address == REG_IDCODE)
		check_idcode(port, word);
	else if (port->address == REG_FAR)
		start_frames(port, word);
	else if (port->address == REG_FDRI)
		port->frame_words++;
	if (!port->frames)
		return;
	if (port->address == REG_FDRI)
		frame_word(port, word);
	else if (port->address == REG_MFWR)
		frame_again(port);
}

static void header(struct cm_configport *port, u32 word)
{
	u32 operation = FIELD_GET(PACKET_OP, word);

	if (operation == OP_NOP)
		return;
	switch (FIELD_GET(PACKET_TYPE, word)) {
	case 1:
		port->address = FIELD_GET(PACKET_REGISTER, word);
		port->remaining = FIELD_GET(PACKET_COUNT1, word);
		break;
	case 2: /* to the register of the type 1 packet before it */
		port->remaining = FIELD_GET(PACKET_COUNT2, word);
		break;
	default:
		return;
	}
	port->writing = operation == OP_WRITE;
	/* words that are read come out of the port, not in */
	port->asked = operation == OP_READ ? port->remaining : 0;
	if (!port->writing)
		port->remaining = 0;
}

/**
 * cm_configport_answer() - a word is read from the port
 * @port: port, in sync, with words that were asked for
 *
 * Return: word, as the packets define it.
 */
u32 cm_configport_answer(struct cm_configport *port)
{
	switch (port->address) {
	case REG_FDRO:
		return port->frames && port->command == CMD_RCFG ? read_frame_word(port) : 0;
	case REG_STAT:
		return STAT_RUNNING;
	case REG_IDCODE:
		return port->idcode;
	default:
		return 0;
	}
}

/**
 * cm_configport_word() - the port takes a word
 * @port: port
 * @word: as the packets define it, 0xAA995566 is the sync word
 */
void cm_configport_word(struct cm_configport *port, u32 word)
{
	port->words++;
	if (!port->synced) {
		if (word == SYNC_WORD) {
			port->synced = true;
			port->seen_sync = true;
			port->remaining = 0;
		}
		return;
	}
	if (port->remaining) {
		port->remaining--;
		write_register(port, word);
	} else {
		header(port, word);
	}
}

/**
 * cm_configport_end() - a load has ended
 * @port: port
 *
 * Return: CM_ICAP_ERR_* bits; a load that stops inside a packet times out, as
 * the port waits for the rest.
 */
u32 cm_configport_end(struct cm_configport *port)
{
	if (!port->seen_sync)
		port->errors |= CM_ICAP_ERR_NOSYNC;
	else if (port->synced && port->remaining)
		port->errors |= CM_ICAP_ERR_TIMEOUT;
	return port->errors;
}
