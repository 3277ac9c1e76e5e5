/* SPDX-License-Identifier: GPL-2.0-only */
/* What a configuration port does with the words it is given. */
#ifndef _CM_CONFIGPORT_H
#define _CM_CONFIGPORT_H

#include "frames.h"

/**
 * struct cm_configport - a configuration port between two words
 * @idcode: of the device; 0 accepts any
 * @synced: a sync word was seen and no DESYNC since
 * @seen_sync: a sync word was seen in this load
 * @crc: running value
 * @remaining: data words of the packet under way
 * @address: register that they go to
 * @writing: they are written, not read
 * @words: words taken in this load
 * @frame_words: words written to FDRI in this load
 * @crc_checks: CRC words compared in this load
 * @errors: CM_ICAP_ERR_* of this load
 * @frames: configuration memory, or NULL
 * @command: last value of CMD
 * @far: last value of FAR
 * @place: of @far in the device's order
 * @number: frames since then
 * @column: word of the frame under way
 * @full: a frame is in the buffer since FAR was written
 * @asked: words that are to be read once the port is turned round
 */
struct cm_configport {
	u32 idcode;
	bool synced;
	bool seen_sync;
	u32 crc;
	u32 remaining;
	u32 address;
	bool writing;
	u64 words;
	u64 frame_words;
	u32 crc_checks;
	u32 errors;
	struct cm_frames *frames;
	u32 command;
	u32 far;
	size_t place;
	u32 number;
	u32 column;
	bool full;
	u32 asked;
};

void cm_configport_begin(struct cm_configport *port);
void cm_configport_word(struct cm_configport *port, u32 word);
u32 cm_configport_end(struct cm_configport *port);
u32 cm_configport_answer(struct cm_configport *port);
u32 cm_configport_crc(u32 crc, u32 address, u32 data);

#endif /* _CM_CONFIGPORT_H */
