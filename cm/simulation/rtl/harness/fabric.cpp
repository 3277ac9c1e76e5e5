// SPDX-License-Identifier: Apache-2.0
#include "fabric.h"

#include <unistd.h>

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

const char *file_found(const char *name)
{
	return evaluated->found(name);
}

void file_missing(const char *name)
{
	evaluated->miss(name);
}

} // namespace

const cm_host Fabric::host = { model_stopped, port_clocked, file_found, file_missing };

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

const std::vector<std::string> &Fabric::folders() const
{
	static const std::vector<std::string> none;
	return current == TRIAL ? tried : current >= 0 ? regions[uint32_t(current)].folders : none;
}

const char *Fabric::found(const char *name)
{
	for (const std::string &folder : folders()) {
		path = folder + "/" + name;
		if (access(path.c_str(), R_OK) == 0)
			return path.c_str();
	}
	return nullptr;
}

void Fabric::miss(const char *name)
{
	std::string text =
		std::string("there is no file ") + name + ", which it reads into a memory";
	const char *between = ": not in ";
	for (const std::string &folder : *name == '/' ? std::vector<std::string>() : folders()) {
		text += between + folder;
		between = ", ";
	}
	missed = true;
	leave(text);
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
