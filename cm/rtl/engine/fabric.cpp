// SPDX-License-Identifier: Apache-2.0
#include "fabric.h"

namespace
{
Fabric *evaluated; // the one fabric of the process: the HDL's $finish has no argument that would tell

void model_stopped(const char *how, const char *file, int line, const char *text)
{
	std::string why = how;
	if (text && *text)
		why += std::string(": ") + text;
	if (file && *file)
		why += std::string(" (") + file + ":" + std::to_string(line) + ")";
	evaluated->leave(why);
}

int port_clocked(uint32_t word, int taken)
{
	return evaluated->configured(word, taken);
}

const cm_host host = { model_stopped, port_clocked };
} // namespace

Fabric::Fabric(const std::string &library, uint64_t seed, Told told, Port taken)
    : stopped(std::move(told)), port(std::move(taken))
{
	evaluated = this;
	static_part = std::make_unique<Instance>(library, seed, &host);
	for (uint32_t index = 0; index < static_part->count();
	     index++) // nothing floats: what nothing drives is 0
		if (static_part->description(index).direction == CM_IN)
			memset(static_part->at(index).at, 0,
			       pin_bytes(static_part->description(index).bits));
}

uint32_t Fabric::add_clock(const std::string &name, uint64_t period)
{
	Clock clock;
	clock.name = name;
	clock.period = clock.due = period;
	clock.pin = static_part->need("clk_" + name);
	clocks.push_back(std::move(clock));
	return uint32_t(clocks.size() - 1);
}

void Fabric::add_region(Region region)
{
	for (uint32_t index = 0; index < static_part->count(); index++) {
		const cm_pin &pin = static_part->description(index);
		if (pin.direction == CM_IN && std::string(pin.name).rfind(region.prefix, 0) == 0)
			region.driven.push_back(static_part->at(index));
	}
	regions.push_back(std::move(region));
}

void Fabric::unload(Region &region)
{
	region.module.reset();
	region.in = region.out = Wires();
	region.clock_pins.clear();
	region.noise = 0;
}

void Fabric::load(uint32_t index, const std::string &library, uint64_t seed)
{
	Region &region = regions.at(index);
	auto module = std::make_unique<Instance>(library, seed, &host);
	unload(region);
	for (uint32_t pin = 0; pin < module->count(); pin++) {
		const cm_pin &described = module->description(pin);
		bool clock = false;
		for (auto &[name, number] : region.clocks) {
			if (name != described.name)
				continue;
			region.clock_pins.emplace_back(module->at(pin), number);
			clock = true;
		}
		if (clock || described.direction == CM_INOUT)
			continue;
		Pin outer = static_part->need(region.prefix + described.name);
		if (described.direction == CM_IN)
			region.in.add(outer, module->at(pin));
		else
			region.out.add(module->at(pin), outer);
	}
	region.module = std::move(module);
	region.loaded = now;
	touch();
	if (!traces.empty())
		trace(region);
}

void Fabric::undefine(uint32_t index, uint64_t seed)
{
	unload(regions.at(index));
	regions.at(index).noise = seed | 1;
}

void Fabric::empty(uint32_t index)
{
	Region &region = regions.at(index);
	unload(region);
	for (const Pin &pin : region.driven)
		memset(pin.at, 0, pin_bytes(pin.bits));
	touch();
}

// xorshift64*: every output of a region that is being written to changes at every edge
void Fabric::babble(Region &region)
{
	for (const Pin &pin : region.driven) {
		for (uint32_t byte = 0; byte < (pin.bits + 7) / 8; byte++) {
			region.noise ^= region.noise >> 12;
			region.noise ^= region.noise << 25;
			region.noise ^= region.noise >> 27;
			uint8_t value = uint8_t(region.noise * 2685821657736338717ull >> 56);
			uint32_t left = pin.bits - 8 * byte;
			pin.at[byte] = left < 8 ? uint8_t(value & ((1u << left) - 1)) : value;
		}
	}
}

void Fabric::evaluate_static()
{
	current = STATIC;
	evaluations++;
	static_part->eval();
	current = NOTHING;
}

void Fabric::evaluate(Region &region, uint32_t index)
{
	current = int(index);
	evaluations++;
	region.module->eval();
	current = NOTHING;
}

// Values go to and fro between the static part and the modules until none changes.
void Fabric::settle()
{
	for (int round = 0; round < ROUNDS; round++) {
		evaluate_static();
		bool changed = false;
		for (uint32_t index = 0; index < regions.size(); index++) {
			Region &region = regions[index];
			if (!region.module)
				continue;
			bool fell = round == 0 && region.clocked; // its clock did
			if (region.in.carry() || fell)
				evaluate(region, index);
			changed |= region.out.carry();
		}
		if (!changed)
			return;
	}
	throw Failure(
		"the values between the static part and a region never settle: a loop without a register");
}

void Fabric::step()
{
	uint64_t next = ~0ull;
	for (const Clock &clock : clocks)
		next = clock.due < next ? clock.due : next;
	now = next;
	for (Clock &clock : clocks) {
		clock.rises = clock.due == next;
		if (!clock.rises)
			continue;
		clock.due += clock.period;
		clock.cycles++;
		clock.pin.set(1);
		for (LiteMaster *master : clock.masters)
			master->sample();
		for (Source *source : clock.sources)
			source->sample();
		for (Sink *sink : clock.sinks)
			sink->sample();
		for (MemorySlave *memory : clock.memories)
			memory->sample();
	}
	// every register takes what its inputs were before the edge: modules first, with the pins as they are
	for (uint32_t index = 0; index < regions.size(); index++) {
		Region &region = regions[index];
		region.clocked = false;
		for (auto &[pin, number] : region.clock_pins) {
			if (!clocks[number].rises)
				continue;
			pin.set(1);
			region.clocked = true;
		}
		if (region.module && region.clocked)
			evaluate(region, index);
	}
	evaluate_static();
	if (!traces.empty())
		dump();
	for (Clock &clock : clocks) {
		if (!clock.rises)
			continue;
		clock.pin.set(0);
		for (LiteMaster *master : clock.masters)
			master->edge();
		for (Source *source : clock.sources)
			source->edge();
		for (Sink *sink : clock.sinks)
			sink->edge();
		for (MemorySlave *memory : clock.memories)
			memory->edge();
	}
	for (Region &region : regions) {
		for (auto &[pin, number] : region.clock_pins)
			if (clocks[number].rises)
				pin.set(0);
		if (region.module)
			region.out.carry();
		else if (region.noise)
			babble(region);
	}
	settle();
	if (!traces.empty()) {
		now += 1; // ps: the clock's fall is shown, if only just
		dump();
		now -= 1;
	}
}

void Fabric::run(uint64_t edges)
{
	volatile uint64_t left = edges;
	if (sigsetjmp(out, 0)) {
		int which = current;
		current = NOTHING;
		if (which < 0)
			throw Failure("the static part: " + why);
		Region &region = regions[which];
		region.module->abandon();
		empty(uint32_t(which));
		stopped(uint32_t(which), why);
	}
	if (touched) {
		touched = false;
		settle();
	}
	while (left) {
		left = left - 1;
		step();
	}
}

void Fabric::leave(const std::string &text)
{
	why = text;
	siglongjmp(out, 1);
}

bool Fabric::hangs()
{
	bool same = current != NOTHING && evaluations == seen;
	seen = evaluations;
	return same;
}

// All resets for 32 cycles of every clock, as proc_sys_reset holds them (PG164: at least 16).
void Fabric::reset()
{
	std::vector<Pin> resets;
	for (const Clock &clock : clocks)
		if (Pin pin = static_part->find("resetn_" + clock.name))
			resets.push_back(pin);
	touch();
	for (const Pin &pin : resets)
		pin.set(0);
	for (Clock &clock : clocks)
		for (LiteMaster *master : clock.masters)
			master->reset();
	uint64_t slowest = 0, fastest = ~0ull;
	for (const Clock &clock : clocks) {
		slowest = clock.period > slowest ? clock.period : slowest;
		fastest = clock.period < fastest ? clock.period : fastest;
	}
	uint64_t edges = 32 * (slowest / fastest + 1) * clocks.size();
	run(edges);
	for (const Pin &pin : resets)
		pin.set(1);
	touch();
	run(edges);
}

void Fabric::dump()
{
	static_part->dump(now);
	for (Region &region : regions)
		if (region.module && region.module->tracing())
			region.module->dump(now);
}

void Fabric::trace(const std::string &folder)
{
	untrace();
	loads = 0;
	if (!static_part->trace(folder + "/static.fst"))
		throw Failure("the libraries were built without tracing");
	traces = folder;
	for (Region &region : regions)
		if (region.module)
			trace(region);
}

void Fabric::trace(Region &region)
{
	std::string number = loads++ ? "." + std::to_string(loads) : "";
	region.module->trace(traces + "/" + region.name + number + ".fst");
}

void Fabric::untrace()
{
	static_part->untrace();
	for (Region &region : regions)
		if (region.module)
			region.module->untrace();
	traces.clear();
}

// The pin `cm_event` of the static part is there for traces only: viewers show it as text.
void Fabric::mark(const std::string &text)
{
	Pin pin = static_part->find("cm_event");
	if (!pin)
		return;
	uint32_t bytes = pin.bits / 8;
	memset(pin.at, 0, pin_bytes(pin.bits));
	for (uint32_t index = 0; index < bytes && index < text.size(); index++)
		pin.at[bytes - 1 - index] =
			uint8_t(text[index]); // the first letter is the highest byte
}
