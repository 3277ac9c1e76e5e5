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

// Memory to stream: sends one packet at a time, TLAST with its last beat, TKEEP where the stream has it.
class Source
{
      public:
	Source(const Instance &part, const std::string &prefix);

	void send(const uint8_t *bytes, uint64_t length);
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
	Pin tdata, tkeep, tlast, tvalid, tready;
	const uint8_t *next = nullptr;
	uint64_t left = 0;
	uint32_t width;
	bool offered = false, taken = false, finished = false;
};

// Stream to memory: fills the room that it was given until TLAST; without room it is not ready.
class Sink
{
      public:
	Sink(const Instance &part, const std::string &prefix);

	void receive(uint8_t *to, uint64_t capacity);
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
	Pin tdata, tkeep, tlast, tvalid, tready;
	uint8_t *to = nullptr;
	uint64_t capacity = 0, stored = 0;
	uint32_t width;
	bool room = false, taken = false, finished = false, over = false, drops = false;
};
