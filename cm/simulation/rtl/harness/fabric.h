// SPDX-License-Identifier: Apache-2.0
//
// The programmable logic: the static part, what is loaded in its regions, and the clocks of both.
#pragma once
#include "agents.h"
#include "memory.h"

#include <csetjmp>
#include <functional>
#include <map>
#include <string>
#include <vector>

struct Clock {
	std::string name;
	uint64_t period;  // ps
	uint64_t due = 0; // ps of its next rising edge
	uint64_t cycles = 0;
	bool rises = false; // in this step
	Pin pin;	    // of the static part
	std::vector<LiteMaster *> masters;
	std::vector<Source *> sources;
	std::vector<Sink *> sinks;
	std::vector<MemorySlave *> memories;
};

// A region's pins at the static part are called `prefix` and the pin's name.
struct Region {
	std::string name, prefix;
	std::vector<std::string> folders;		      // of its module's sources
	std::vector<std::pair<std::string, uint32_t>> clocks; // pin, index of the clock
	std::unique_ptr<Instance> module;
	Wires in, out; // to the module, and back
	std::vector<std::pair<Pin, uint32_t>> clock_pins;
	std::vector<Pin> driven; // pins of the static part that the region drives
	uint64_t noise = 0;   // state of the generator while the region is undefined; 0: it is not
	bool clocked = false; // in this step
	uint64_t loaded = 0;  // ps
	uint32_t number = 0;  // of this load of any region
};

class Fabric
{
      public:
	using Told = std::function<void(uint32_t region, const std::string &why)>;

	static const cm_host host; // what every model is given
	using Port = std::function<int(uint32_t word, bool taken)>;

	Fabric(const std::string &library, uint64_t seed, Told stopped, Port port);

	Instance &part()
	{
		return *static_part;
	}
	uint32_t add_clock(const std::string &name, uint64_t period);
	void add_region(Region region);
	Clock &clock(uint32_t index)
	{
		return clocks.at(index);
	}
	const Clock &clock(uint32_t index) const
	{
		return clocks.at(index);
	}
	size_t clock_count() const
	{
		return clocks.size();
	}

	// `what`: a library, and on lines of their own the folders in which its HDL finds files
	void load(uint32_t region, const std::string &what, uint64_t seed);
	std::string
	lacks(const std::string &what); // what it would miss of these files; empty if nothing
	void undefine(uint32_t region, uint64_t seed);
	void empty(uint32_t region);
	void reset();
	uint64_t loaded_at(uint32_t region) const
	{
		return regions.at(region).loaded;
	} // ps

	void run(uint64_t edges); // of any clock
	void touch()
	{
		touched = true;
	} // a pin of the static part was set outside an edge
	uint64_t picoseconds() const
	{
		return now;
	}
	void trace(const std::string
			   &folder); // a file for each part, that of a region again at each load
	void untrace();
	void mark(const std::string &text); // shown in the static part's file
	int configured(uint32_t word, bool taken)
	{
		return port(word, taken);
	}

	bool
	hangs(); // called by a timer: whether the same evaluation runs as when it was called before
	[[noreturn]] void leave(const std::string &why); // the evaluation that runs now
	const char *found(const char *name);		 // a file that it reads
	[[noreturn]] void miss(const char *name);

      private:
	void step();
	void settle();
	void evaluate(Region &region, uint32_t index);
	void evaluate_static();
	void unload(Region &region);
	void babble(Region &region);
	void trace(Region &region);
	void dump();

	std::unique_ptr<Instance> static_part;
	std::vector<Clock> clocks;
	std::vector<Region> regions;
	Told stopped;
	Port port;
	uint64_t now = 0, evaluations = 0, seen = 0;
	int current = NOTHING; // what is evaluated
	static constexpr int NOTHING = -2, STATIC = -1, TRIAL = -3;
	static constexpr int ROUNDS = 100; // until values between two modules must have settled
	std::string why, path;
	std::vector<std::string> tried; // folders of what is on trial
	bool missed = false;
	const std::vector<std::string> &folders() const;
	sigjmp_buf out;
	std::string traces; // folder; empty: none are written
	uint32_t loads = 0; // since tracing began
	uint32_t loaded_ever = 0;
	bool touched = true;
};
