// SPDX-License-Identifier: Apache-2.0
//
// What stands for the interconnect and the memory behind an AXI4 or AXI4-Lite master of a region (ARM IHI 0022):
// INCR and FIXED bursts, one read and one write at a time, bytes by strobe.
#pragma once
#include "pins.h"

#include <functional>
#include <string>
#include <vector>

// Bytes of the board's memory, by their address as devices have it; false where there is none.
struct Store {
	std::function<bool(uint64_t address, uint8_t *to, uint32_t length)> read;
	std::function<bool(uint64_t address, const uint8_t *from, const uint8_t *mask,
			   uint32_t length)>
		write;
};

class MemorySlave
{
      public:
	MemorySlave(const Instance &part, const std::string &prefix, const Store &store);

	void sample();
	void edge();
	uint64_t beats = 0; // that have moved

      private:
	struct Burst {
		uint64_t address = 0;
		uint32_t left = 0; // beats
		uint32_t size = 0; // bytes of a beat
		uint64_t id = 0;
		bool fixed = false, failed = false;
	};
	void take(Burst &burst, const Pin &addr, const Pin &len, const Pin &size, const Pin &kind,
		  const Pin &id) const;
	void offer();
	void store_beat();

	Store store;
	Pin araddr, arlen, arsize, arburst, arid, arvalid, arready, rdata, rresp, rlast, rid,
		rvalid, rready;
	Pin awaddr, awlen, awsize, awburst, awid, awvalid, awready, wdata, wstrb, wvalid, wready,
		bresp, bid, bvalid, bready;
	Burst reading, writing;
	bool ar = false, r = false, aw = false, w = false, b = false; // handshakes of this cycle
	bool answers = false; // a write waits for its response
	std::vector<uint8_t> word, mask;
};
