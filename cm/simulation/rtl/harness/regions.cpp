// SPDX-License-Identifier: Apache-2.0
//
// What is in the regions: modules that come and go, noise, nothing; and what is written of all that to files.
#include "fabric.h"

#include <sstream>
#include <unistd.h>

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

namespace
{
std::vector<std::string> lines_of(const std::string &text)
{
	std::vector<std::string> found;
	std::istringstream lines(text);
	for (std::string line; std::getline(lines, line);)
		found.push_back(line);
	return found;
}
} // namespace

std::string Fabric::lacks(const std::string &what)
{
	tried = lines_of(what);
	Instance module(tried.at(0), 1, &host);
	tried.erase(tried.begin());
	missed = false;
	if (sigsetjmp(out, 0)) {
		module.abandon();
	} else {
		current = TRIAL;
		evaluations++;
		module.eval(); // its initial blocks
	}
	current = NOTHING;
	return missed ? why : "";
}

void Fabric::load(uint32_t index, const std::string &what, uint64_t seed)
{
	Region &region = regions.at(index);
	auto lines = lines_of(what);
	auto module = std::make_unique<Instance>(lines.at(0), seed, &host);
	unload(region);
	region.folders.assign(lines.begin() + 1, lines.end());
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
	region.number = ++loaded_ever;
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
