// SPDX-License-Identifier: Apache-2.0
#include "memory.h"

namespace
{
constexpr uint64_t OKAY = 0, DECERR = 3;
constexpr uint64_t FIXED = 0;
} // namespace

MemorySlave::MemorySlave(const Instance &part, const std::string &prefix, const Store &given)
    : store(given)
{
	auto pin = [&](const char *name) { return part.find(prefix + "_" + name); };
	araddr = pin("araddr"), arlen = pin("arlen"), arsize = pin("arsize"),
	arburst = pin("arburst");
	arid = pin("arid"), arvalid = pin("arvalid"), arready = pin("arready");
	rdata = pin("rdata"), rresp = pin("rresp"), rlast = pin("rlast"), rid = pin("rid");
	rvalid = pin("rvalid"), rready = pin("rready");
	awaddr = pin("awaddr"), awlen = pin("awlen"), awsize = pin("awsize"),
	awburst = pin("awburst");
	awid = pin("awid"), awvalid = pin("awvalid"), awready = pin("awready");
	wdata = pin("wdata"), wstrb = pin("wstrb"), wvalid = pin("wvalid"), wready = pin("wready");
	bresp = pin("bresp"), bid = pin("bid"), bvalid = pin("bvalid"), bready = pin("bready");
	if (!araddr && !awaddr)
		throw Failure("there is no memory master " + prefix);
	uint32_t bytes = (rdata ? rdata.bits : wdata.bits) / 8;
	word.resize(bytes);
	mask.resize(bytes);
	arready.set(1);
	awready.set(1);
}

void MemorySlave::take(Burst &burst, const Pin &addr, const Pin &len, const Pin &size,
		       const Pin &kind, const Pin &id) const
{
	burst.address = addr.get();
	burst.left = uint32_t(len.get()) + 1; // AXI4-Lite has none: 1
	burst.size = size ? 1u << size.get() : uint32_t(word.size());
	burst.id = id.get();
	burst.fixed = kind && kind.get() == FIXED;
	burst.failed = false;
}

void MemorySlave::sample()
{
	ar = arvalid.high() && arready.high();
	r = rvalid.high() && rready.high();
	aw = awvalid.high() && awready.high();
	w = wvalid.high() && wready.high();
	b = bvalid.high() && bready.high();
	if (ar)
		take(reading, araddr, arlen, arsize, arburst, arid);
	if (aw)
		take(writing, awaddr, awlen, awsize, awburst, awid);
	if (w)
		store_beat();
	beats += r + w;
}

// A beat moves the lanes of its address: the first of a burst may be a part of one (A3.4.1).
void MemorySlave::offer()
{
	uint32_t width = uint32_t(word.size()), lane = uint32_t(reading.address % width);
	uint32_t length = reading.size - uint32_t(reading.address % reading.size);
	std::fill(word.begin(), word.end(), 0);
	bool there = store.read(reading.address, word.data() + lane, length);
	memcpy(rdata.at, word.data(), width);
	rresp.set(there ? OKAY : DECERR);
	rid.set(reading.id);
	rlast.set(reading.left == 1);
	rvalid.set(1);
	if (!reading.fixed)
		reading.address += length;
	reading.left--;
}

void MemorySlave::store_beat()
{
	uint32_t width = uint32_t(word.size()), lane = uint32_t(writing.address % width);
	uint32_t length = writing.size - uint32_t(writing.address % writing.size);
	uint64_t strobes = wstrb ? wstrb.get() : ~0ull;
	memcpy(word.data(), wdata.at, width);
	for (uint32_t byte = 0; byte < width; byte++)
		mask[byte] = byte >= 64 || (strobes >> byte & 1);
	writing.failed |=
		!store.write(writing.address, word.data() + lane, mask.data() + lane, length);
	if (!writing.fixed)
		writing.address += length;
	writing.left--;
	answers = writing.left == 0;
}

void MemorySlave::edge()
{
	if (ar)
		arready.set(0);
	if (r)
		rvalid.set(0);
	if (reading.left && !rvalid.high())
		offer();
	else if (r && !reading.left)
		arready.set(1);
	if (aw) {
		awready.set(0);
		wready.set(1);
	}
	if (answers) {
		answers = false;
		wready.set(0);
		bresp.set(writing.failed ? DECERR : OKAY);
		bid.set(writing.id);
		bvalid.set(1);
	}
	if (b) {
		bvalid.set(0);
		awready.set(1);
	}
}
