// SPDX-License-Identifier: Apache-2.0
//
// From the lines of the wiring to clocks, ends of streams and regions: see cm/simulation/rtl/design.py, which writes them.
#include "harness.h"

#include <sstream>
#include <sys/mman.h>

Harness::Harness(std::istream &wiring, int socket, int arena_fd) : connection(socket)
{
	void *mapped = mmap(nullptr, CM_ARENA_BYTES, PROT_READ | PROT_WRITE,
			    MAP_SHARED | MAP_NORESERVE, arena_fd, 0);
	if (mapped == MAP_FAILED)
		throw Failure("the arena cannot be mapped");
	memory = static_cast<uint8_t *>(mapped);
	for (std::string line; std::getline(wiring, line);)
		wire(line);
	if (!fabric)
		throw Failure("the wiring names no static part");
}

// One line of the wiring: see wiring() of cm/simulation/rtl/design.py
void Harness::wire(const std::string &line)
{
	std::istringstream words(line);
	std::string kind, name;
	uint32_t clock = 0;
	words >> kind;
	if (kind == "static") {
		uint64_t seed;
		words >> seed >> name;
		fabric = std::make_unique<Fabric>(
			name, seed,
			[this](uint32_t region, const std::string &why) {
				tell(CM_STOPPED, region, 0, 0, why);
			},
			[this](uint32_t value, bool taken) { return clocked(value, taken); });
		interrupt = fabric->part().find("irq");
	} else if (kind == "clock") {
		uint64_t period;
		words >> name >> period;
		fabric->add_clock(name, period);
	} else if (kind == "bus") {
		words >> name >> clock;
		auto bus =
			std::make_unique<Bus>(Bus{ LiteMaster(fabric->part(), name), clock, {} });
		for (uint64_t base, end; words >> base >> end;)
			bus->windows.emplace_back(base, end);
		fabric->clock(clock).masters.push_back(&bus->master);
		buses.push_back(std::move(bus));
	} else if (kind == "source" || kind == "sink") {
		bool source = kind == "source", ends = true;
		words >> name >> clock;
		if (!source)
			words >> ends;
		sources.push_back(source ? std::make_unique<Source>(fabric->part(), name)
					 : nullptr);
		sinks.push_back(source ? nullptr
				       : std::make_unique<Sink>(fabric->part(), name, ends));
		if (source)
			fabric->clock(clock).sources.push_back(sources.back().get());
		else
			fabric->clock(clock).sinks.push_back(sinks.back().get());
	} else if (kind == "drain") {
		words >> name >> clock;
		drains.push_back(std::make_unique<Sink>(fabric->part(), name));
		drains.back()->always_ready();
		fabric->clock(clock).sinks.push_back(drains.back().get());
	} else if (kind == "memory") {
		words >> name >> clock;
		Store store;
		store.read = [this](uint64_t address, uint8_t *to, uint32_t length) {
			bool there = exchange(CM_FETCH, address, length);
			memcpy(to, memory + CM_EXCHANGE, length);
			return there;
		};
		store.write = [this](uint64_t address, const uint8_t *from, const uint8_t *mask,
				     uint32_t length) {
			memcpy(memory + CM_EXCHANGE, from, length);
			memcpy(memory + CM_EXCHANGE + length, mask, length);
			return exchange(CM_STORE, address, length);
		};
		memories.push_back(std::make_unique<MemorySlave>(fabric->part(), name, store));
		fabric->clock(clock).memories.push_back(memories.back().get());
	} else if (kind == "port") {
		words >> name >> clock >> reverses;
		port = std::make_unique<Source>(fabric->part(), name);
		fabric->clock(clock).sources.push_back(port.get());
	} else if (kind == "output") {
		words >> name;
		outputs.emplace_back(fabric->part().need(name), 0);
	} else if (kind == "region") {
		region(words);
	} else if (!kind.empty()) {
		throw Failure("the wiring says " + kind + ", which is nothing");
	}
}

void Harness::region(std::istringstream &words)
{
	Region made;
	words >> made.name >> made.prefix;
	std::string pin;
	for (uint32_t clock; words >> pin >> clock;)
		made.clocks.emplace_back(pin, clock);
	names.push_back(made.name);
	fabric->add_region(std::move(made));
}

uint8_t *Harness::arena(uint64_t offset, uint64_t length) const
{
	if (offset > CM_ARENA_BYTES || length > CM_ARENA_BYTES - offset)
		throw Failure("a request points behind the arena");
	return memory + offset;
}
