// SPDX-License-Identifier: Apache-2.0
#include "agents.h"

LiteMaster::LiteMaster(const Instance &part, const std::string &prefix)
    : awaddr(part.need(prefix + "_awaddr")), awprot(part.need(prefix + "_awprot")),
      awvalid(part.need(prefix + "_awvalid")), awready(part.need(prefix + "_awready")),
      wdata(part.need(prefix + "_wdata")), wstrb(part.need(prefix + "_wstrb")),
      wvalid(part.need(prefix + "_wvalid")), wready(part.need(prefix + "_wready")),
      bresp(part.need(prefix + "_bresp")), bvalid(part.need(prefix + "_bvalid")),
      bready(part.need(prefix + "_bready")), araddr(part.need(prefix + "_araddr")),
      arprot(part.need(prefix + "_arprot")), arvalid(part.need(prefix + "_arvalid")),
      arready(part.need(prefix + "_arready")), rdata(part.need(prefix + "_rdata")),
      rresp(part.need(prefix + "_rresp")), rvalid(part.need(prefix + "_rvalid")),
      rready(part.need(prefix + "_rready"))
{
	reset();
}

void LiteMaster::reset()
{
	for (const Pin *pin : { &awvalid, &wvalid, &bready, &arvalid, &rready })
		pin->set(0);
	reading = writing = false;
}

void LiteMaster::read(uint32_t address)
{
	araddr.set(address);
	arprot.set(0);
	arvalid.set(1);
	reading = true;
}

void LiteMaster::write(uint32_t address, uint32_t value, uint32_t strobes)
{
	awaddr.set(address);
	awprot.set(0);
	awvalid.set(1);
	wdata.set(value);
	wstrb.set(strobes);
	wvalid.set(1);
	writing = true;
}

void LiteMaster::sample()
{
	if (!busy())
		return;
	aw = awvalid.high() && awready.high();
	w = wvalid.high() && wready.high();
	b = bready.high() && bvalid.high();
	ar = arvalid.high() && arready.high();
	r = rready.high() && rvalid.high();
	if (b)
		resp = bresp.get();
	if (r) {
		resp = rresp.get();
		data = rdata.get();
	}
}

void LiteMaster::edge()
{
	if (!busy())
		return;
	if (aw)
		awvalid.set(0);
	if (w)
		wvalid.set(0);
	if (ar) {
		arvalid.set(0);
		rready.set(1);
	}
	if (r) {
		rready.set(0);
		reading = false;
	}
	if (b) {
		bready.set(0);
		writing = false;
	} else if (writing && !awvalid.high() && !wvalid.high()) {
		bready.set(1);
	}
}

Source::Source(const Instance &part, const std::string &prefix)
    : tdata(part.need(prefix + "_tdata")), tkeep(part.find(prefix + "_tkeep")),
      tlast(part.find(prefix + "_tlast")), tuser(part.find(prefix + "_tuser")),
      tvalid(part.need(prefix + "_tvalid")), tready(part.find(prefix + "_tready")),
      width((tdata.bits + 7) / 8)
{
	tvalid.set(0);
}

void Source::send(const uint8_t *bytes, uint64_t length, uint64_t line_bytes)
{
	next = bytes;
	left = length;
	line = of_line = line_bytes;
	tuser.set(1);
	offer();
}

void Source::cancel()
{
	left = 0;
	offered = finished = false;
	tvalid.set(0);
}

bool Source::done()
{
	bool was = finished;
	finished = false;
	return was;
}

static uint64_t little_endian(const uint8_t *bytes, uint32_t length)
{
	uint64_t value = 0;
	for (uint32_t byte = length; byte-- > 0;)
		value = value << 8 | bytes[byte];
	return value;
}

void Source::offer()
{
	uint64_t here = line && of_line < left ? of_line : left;
	uint32_t length = here < width ? uint32_t(here) : width;
	if (width <= 8) {
		tdata.set(little_endian(next, length));
	} else {
		memset(tdata.at, 0, pin_bytes(tdata.bits));
		memcpy(tdata.at, next, length);
	}
	if (tdata.bits % 8) { // the bits that the pin has
		uint8_t &top = tdata.at[width - 1];
		top &= uint8_t((1u << tdata.bits % 8) - 1);
	}
	next += length;
	left -= length;
	of_line -= line ? length : 0;
	tkeep.set(length >= 64 ? ~0ull : (1ull << length) - 1);
	tlast.set(left == 0 || (line && of_line == 0));
	of_line = line && of_line == 0 ? line : of_line;
	tvalid.set(1);
	offered = true;
}

void Source::edge()
{
	if (!offered || !taken)
		return;
	beats++;
	tuser.set(0);
	if (left) {
		offer();
		return;
	}
	tvalid.set(0);
	offered = false;
	finished = true;
}

Sink::Sink(const Instance &part, const std::string &prefix, bool ends)
    : tdata(part.need(prefix + "_tdata")), tkeep(part.find(prefix + "_tkeep")),
      tlast(ends ? part.find(prefix + "_tlast") : Pin()), tuser(part.find(prefix + "_tuser")),
      tvalid(part.need(prefix + "_tvalid")), tready(part.find(prefix + "_tready")),
      width((tdata.bits + 7) / 8)
{
	tready.set(0);
}

void Sink::always_ready()
{
	drops = true;
	tready.set(1);
}

void Sink::receive(uint8_t *into, uint64_t bytes, uint64_t line_bytes)
{
	line = line_bytes;
	row = column = 0;
	framed = false;
	to = into;
	capacity = bytes;
	stored = 0;
	room = true;
	over = finished = false;
	tready.set(1);
}

void Sink::cancel()
{
	room = finished = false;
	tready.set(0);
}

bool Sink::done(uint64_t &length, bool &overflow)
{
	if (!finished)
		return false;
	finished = false;
	length = stored;
	overflow = over;
	return true;
}

void Sink::sample()
{
	taken = tvalid.high() && (room || drops);
	beats += taken;
	if (taken && room)
		line ? store_video() : store();
}

// Bytes that TKEEP marks; where a packet is longer than its room, the rest of it is lost (PG021: DMAIntErr).
void Sink::store()
{
	uint64_t all = width < 64 ? (1ull << width) - 1 : ~0ull;
	uint64_t keep = tkeep ? tkeep.get() : all;
	bool whole = (keep & all) == all && capacity - stored >= width; // nearly every beat
	if (whole) {
		memcpy(to + stored, tdata.at, width);
		stored += width;
	}
	for (uint32_t byte = 0; byte < width && !whole; byte++) {
		if (byte < 64 && !(keep >> byte & 1))
			continue;
		if (stored == capacity)
			over = true;
		else
			to[stored++] = tdata.at[byte];
	}
	// a stream without TLAST is cut where the room is full, as the harness's length register does
	bool last = tlast ? tlast.high() : stored == capacity;
	if (last) {
		room = false;
		finished = true;
	}
}

void Sink::store_video()
{
	if (tuser.get() & 1) {
		over |= framed; // the frame before it was cut short
		framed = true;
		row = column = 0;
	}
	if (!framed)
		return;
	uint64_t fits = column < line ? line - column : 0;
	memcpy(to + row * line + column, tdata.at, fits < width ? fits : width);
	column += width;
	over |= column > line;
	if (!tlast.high())
		return;
	if (column < line) {
		over = true;
		memset(to + row * line + column, 0, line - column);
	}
	row++;
	column = 0;
	if ((row + 1) * line > capacity) {
		stored = row * line;
		room = false;
		finished = true;
	}
}

void Sink::edge()
{
	if (!drops)
		tready.set(room);
}
