// SPDX-License-Identifier: Apache-2.0
//
// Messages between the harness and the board that started it: one SEQPACKET each, `cm_message` and then text.
// cm/simulation/rtl/process.py says the same in Python.
#pragma once
#include <cstdint>

struct cm_message {
	uint32_t op;
	uint32_t id; // of a request, and in its answer
	uint64_t a, b, c, d;
};

enum cm_op : uint32_t {
	// requests of the board; each is answered with op | CM_ANSWER, a: errno or 0
	CM_READ = 1, // a: address, b: words, c: where in the arena they go
	CM_WRITE, // a: address, b: words, c: where in the arena they are, d: byte strobes of each
	// d of both: 0 for a packet, else a frame of lines of so many bytes, as a VDMA moves them
	CM_SEND,    // a: stream, b: where in the arena it is, c: bytes; CM_SENT follows
	CM_RECEIVE, // a: stream, b: where in the arena it goes, c: room in bytes; CM_RECEIVED follows
	CM_CANCEL, // a: stream; nothing follows any more
	CM_LOAD,   // a: region, b: seed, text: the library, and the folders of its HDL, a line each
	CM_UNDEFINE,  // a: region, b: seed: its outputs are noise
	CM_EMPTY,     // a: region: its outputs are 0
	CM_CONFIGURE, // b: where in the arena words for the configuration port are, c: words; answer b: words that came out
	CM_RESET,     // the reset of the static part
	CM_TRACE,     // text: a folder, or empty to end it
	CM_MARK,      // text: what to show in the trace
	CM_STATE,     // answer's text: JSON
	CM_TRY,	      // text: as CM_LOAD's; ENOENT, and its text says which file the HDL would miss
	// what the harness tells; the board answers the last two
	CM_SENT = 64, // a: stream
	CM_RECEIVED,  // a: stream, b: bytes, c: 1 if it had another length
	CM_INTERRUPT, // a: level
	CM_OUTPUT,    // a: external output, b: value
	CM_STOPPED,   // a: region, text: why
	CM_FETCH =
		72, // a: address, b: bytes; the board's answer has a: errno, and they are at CM_EXCHANGE
	CM_STORE, // a: address, b: bytes, which are at CM_EXCHANGE, and behind them their mask
	CM_ANSWER = 128,
};

constexpr uint64_t CM_ARENA_BYTES = 1ull << 32; // mapped whole, filled only where it is used
constexpr uint64_t CM_EXCHANGE = 32 << 20; // where in the arena bytes of memory are handed over
