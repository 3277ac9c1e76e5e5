// SPDX-License-Identifier: Apache-2.0
//
// What the processor, the configuration port and the memory do with the logic.
#include "harness.h"

#include <cerrno>

namespace
{
constexpr uint64_t BUS_PATIENCE = 100000; // edges until an access without an answer is given up
} // namespace

bool Harness::ends(const Bus &bus, bool write)
{
	for (uint64_t waited = 0; write ? bus.master.writing_now() : bus.master.reading_now();
	     waited += 4) {
		if (waited > BUS_PATIENCE)
			return false;
		run(4);
	}
	return true;
}

// One access of the processor. An access that nothing answers stays on the bus, as it does in hardware.
int Harness::word(Bus &bus, bool write, uint32_t address, uint32_t value, uint32_t strobes,
		  uint32_t &result)
{
	if (!ends(bus, write))
		return ETIMEDOUT; // one that was given up, and is not answered yet
	if (write)
		bus.master.write(address, value, strobes);
	else
		bus.master.read(address);
	fabric->touch();
	if (!ends(bus, write))
		return ETIMEDOUT;
	result = bus.master.value();
	switch (bus.master.response()) {
	case 0:
		return 0;
	case 3:
		return EFAULT; // DECERR: no slave has the address
	default:
		return EIO;
	}
}

int Harness::access(const cm_message &message)
{
	bool write = message.op == CM_WRITE;
	uint8_t *words = arena(message.c, 4 * message.b);
	for (auto &bus : buses) {
		for (auto &[base, end] : bus->windows) {
			if (message.a < base || message.a + 4 * message.b > end)
				continue;
			for (uint64_t index = 0; index < message.b; index++) {
				uint32_t value = 0;
				if (write)
					memcpy(&value, words + 4 * index, 4);
				uint32_t address = uint32_t(message.a + 4 * index);
				if (int status = word(*bus, write, address, value,
						      uint32_t(message.d), value))
					return status;
				if (!write)
					memcpy(words + 4 * index, &value, 4);
			}
			return 0;
		}
	}
	return EFAULT;
}

// UG470, "Bit Swapping": ICAPE2 wants the bits of each byte reversed, and so does ICAPE3 (UG570).
int Harness::clocked(uint32_t value, bool taken)
{
	if (!taken)
		return port_error;
	if (reverses) {
		value = (value & 0x55555555) << 1 | (value >> 1 & 0x55555555);
		value = (value & 0x33333333) << 2 | (value >> 2 & 0x33333333);
		value = (value & 0x0f0f0f0f) << 4 | (value >> 4 & 0x0f0f0f0f);
	}
	configured.push_back(value);
	return port_error;
}

int Harness::configure(const cm_message &message, uint64_t &came_out)
{
	if (!port)
		return ENODEV;
	port_error = message.d;
	uint8_t *bytes = arena(message.b, 4 * message.c);
	configured.clear();
	uint64_t waited = 0;
	port->send(bytes, 4 * message.c);
	fabric->touch();
	while (port->busy() && waited < 64 * message.c + BUS_PATIENCE) {
		run(16);
		waited += 16;
	}
	bool stuck = port->busy();
	port->done();
	run(16); // the words that are on their way
	came_out = configured.size();
	memcpy(bytes, configured.data(), 4 * (came_out < message.c ? came_out : message.c));
	return stuck ? ETIMEDOUT : 0;
}

// Bytes of the board's memory; meanwhile the board may ask us for something, which then waits.
bool Harness::exchange(uint32_t op, uint64_t address, uint32_t length)
{
	tell(op, address, length);
	cm_message message;
	std::string text;
	while (!ended) {
		if (!receive(message, text))
			continue;
		if (message.op == (op | CM_ANSWER))
			return message.a == 0;
		postponed.emplace_back(message, text);
	}
	return false;
}
