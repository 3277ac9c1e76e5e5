// SPDX-License-Identifier: Apache-2.0
//
// Takes requests from its socket, runs the clocks while something moves, and tells what came of it.
#pragma once
#include "fabric.h"
#include "messages.h"

#include <deque>
#include <istream>

constexpr size_t TEXT = 32768; // bytes of a message's text

struct Bus {
	LiteMaster master;
	uint32_t clock;
	std::vector<std::pair<uint64_t, uint64_t>> windows; // base, end
};

class Harness
{
      public:
	Harness(std::istream &wiring, int socket, int arena);
	int serve();
	Fabric &logic()
	{
		return *fabric;
	}

      private:
	void wire(const std::string &line);
	void region(std::istringstream &words);
	bool take(int wait_ms);
	void handle(const cm_message &message, const std::string &text);
	void answer(const cm_message &request, int status, uint64_t b = 0,
		    const std::string &text = "");
	void tell(uint32_t op, uint64_t a = 0, uint64_t b = 0, uint64_t c = 0,
		  const std::string &text = "");
	void send(const cm_message &message, const std::string &text);
	int access(const cm_message &message);
	int word(Bus &bus, bool write, uint32_t address, uint32_t value, uint32_t strobes,
		 uint32_t &result);
	bool ends(const Bus &bus, bool write); // the access that is under way, if one is
	int configure(const cm_message &message, uint64_t &came_out);
	bool run(uint64_t edges);
	void report();
	std::string state() const;
	uint8_t *arena(uint64_t offset, uint64_t length) const;
	int clocked(uint32_t word, bool taken);
	bool exchange(uint32_t op, uint64_t address, uint32_t length);
	bool receive(cm_message &message, std::string &text);

	std::unique_ptr<Fabric> fabric;
	std::vector<std::unique_ptr<Bus>> buses;
	std::vector<std::unique_ptr<Source>> sources; // by stream; nullptr where it is a sink
	std::vector<std::unique_ptr<Sink>> sinks;
	std::vector<std::unique_ptr<Sink>> drains;
	std::vector<std::unique_ptr<MemorySlave>> memories;
	std::deque<std::pair<cm_message, std::string>>
		postponed; // requests that came while an answer was awaited
	std::unique_ptr<Source> port;
	std::vector<std::string> names;		       // of regions
	std::vector<std::pair<Pin, uint64_t>> outputs; // and the value that was told
	Pin interrupt;
	uint64_t level = 0;
	uint64_t quiet = 0; // edges since something moved
	std::vector<uint32_t> configured;
	bool port_error = false, reverses = false;
	int connection;
	uint8_t *memory;
	bool ended = false;
};
