// SPDX-License-Identifier: Apache-2.0
//
// What stands for the block design round the static part: an AXI4-Lite master for the processor, and
// AXI4-Stream ends for the AXI DMA engines (PG021). Each is clocked: `sample` looks at the pins before an edge,
// `edge` changes what it drives after it. So nothing that they drive depends on what they see in one cycle.
#pragma once
#include "pins.h"

#include <cstdint>
#include <string>

// ARM IHI 0022, AXI4-Lite: one access at a time, words of 32 bits.
class LiteMaster
{
      public:
	LiteMaster(const Instance &part, const std::string &prefix);

	void read(uint32_t address);
	void write(uint32_t address, uint32_t value, uint32_t strobes);
	bool busy() const
	{
		return reading || writing;
	}
	bool reading_now() const
	{
		return reading;
	}
	bool writing_now() const
	{
		return writing;
	}
	uint32_t value() const
	{
		return data;
	} // of the last read
	uint32_t response() const
	{
		return resp;
	} // of the last access: 0 OKAY, 2 SLVERR, 3 DECERR

	void sample();
	void edge();
	void reset();

      private:
	Pin awaddr, awprot, awvalid, awready, wdata, wstrb, wvalid, wready, bresp, bvalid, bready;
	Pin araddr, arprot, arvalid, arready, rdata, rresp, rvalid, rready;
	bool reading = false, writing = false;
	bool aw = false, w = false, b = false, ar = false, r = false; // handshakes of this cycle
	uint32_t data = 0, resp = 0;
};

// Memory to stream: sends one packet at a time, TLAST with its last beat, TKEEP where the stream has it. A frame of a
// VDMA (PG020) has TLAST with the last beat of each line, and TUSER[0] with its first beat.
class Source
{
      public:
	Source(const Instance &part, const std::string &prefix);

	void send(const uint8_t *bytes, uint64_t length, uint64_t line = 0);
	void cancel();
	bool busy() const
	{
		return left > 0 || offered;
	}
	bool done(); // once for each packet

	void sample()
	{
		taken = offered && (!tready || tready.high());
	}
	void edge();
	uint64_t beats = 0; // that have moved

      private:
	void offer();
	Pin tdata, tkeep, tlast, tuser, tvalid, tready;
	const uint8_t *next = nullptr;
	uint64_t left = 0;
	uint64_t line = 0, of_line = 0; // bytes of each; left of this one
	uint32_t width;
	bool offered = false, taken = false, finished = false;
};

// Stream to memory: fills the room that it was given until TLAST, or until it is full where the module's packets have
// no end; without room it is not ready. For a VDMA (PG020) a
// frame begins with TUSER[0] and has as many lines as fit the room: what comes before it is dropped, and so is the rest
// of a line that is too long; a line that is too short ends in zeros, and a frame that is cut short begins anew.
class Sink
{
      public:
	Sink(const Instance &part, const std::string &prefix, bool ends = true);

	void receive(uint8_t *to, uint64_t capacity, uint64_t line = 0);
	void cancel();
	bool armed() const
	{
		return room;
	}
	bool done(uint64_t &length, bool &overflow); // once for each packet
	void always_ready();			     // nothing is behind it: beats are dropped
	uint64_t beats = 0;			     // that have moved

	void sample();
	void edge();

      private:
	void store();
	void store_video();
	Pin tdata, tkeep, tlast, tuser, tvalid, tready;
	uint8_t *to = nullptr;
	uint64_t capacity = 0, stored = 0;
	uint64_t line = 0, row = 0,
		 column = 0; // of a frame: bytes of a line; where the next beat goes
	bool framed = false;
	uint32_t width;
	bool room = false, taken = false, finished = false, over = false, drops = false;
};
