// SPDX-License-Identifier: Apache-2.0
//
// Loaded libraries, their instances, and wires between the pins of two of them.
#pragma once
#include "model.h"

#include <cstring>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

struct Failure : std::runtime_error {
	using std::runtime_error::runtime_error;
};

inline uint32_t pin_bytes(uint32_t bits)
{
	if (bits <= 8)
		return 1;
	if (bits <= 16)
		return 2;
	if (bits <= 32)
		return 4;
	return bits <= 64 ? 8 : (bits + 31) / 32 * 4;
}

// One pin of an instance; `none` stands for a pin that a bus does not have.
struct Pin {
	uint8_t *at = nullptr;
	uint32_t bits = 0;

	explicit operator bool() const
	{
		return at != nullptr;
	}
	// Of a pin of one bit; false where there is none.
	bool high() const
	{
		return at && *at;
	}
	uint64_t get() const
	{
		if (!at)
			return 0;
		// loads and stores of the model's own size: others would wait for one another in the processor
		switch (pin_bytes(bits)) {
		case 1:
			return *at;
		case 2:
			return load<uint16_t>();
		case 4:
			return load<uint32_t>();
		default:
			return load<uint64_t>();
		}
	}
	void set(uint64_t value) const
	{
		if (!at)
			return;
		switch (pin_bytes(bits)) {
		case 1:
			*at = uint8_t(value);
			break;
		case 2:
			memcpy(at, &value, 2);
			break;
		case 4:
			memcpy(at, &value, 4);
			break;
		default:
			memcpy(at, &value, 8);
		}
	}

      private:
	template <typename T> T load() const
	{
		T value;
		memcpy(&value, at, sizeof value);
		return value;
	}
};

class Instance
{
      public:
	Instance(const std::string &library, uint64_t seed, const cm_host *host);
	~Instance();
	Instance(const Instance &) = delete;
	void operator=(const Instance &) = delete;

	void eval()
	{
		table->eval(model);
	}
	Pin find(const std::string &name) const; // an empty pin where there is none
	Pin need(const std::string &name) const;
	uint32_t count() const
	{
		return table->pins;
	}
	const cm_pin &description(uint32_t index) const
	{
		return table->pin[index];
	}
	Pin at(uint32_t index) const;

	bool trace(const std::string &path);
	void dump(uint64_t picoseconds)
	{
		table->dump(model, picoseconds);
	}
	void untrace();
	bool tracing() const
	{
		return traced;
	}
	void abandon()
	{
		model = nullptr;
	} // its code was left in the middle: nothing of it is called again

      private:
	void *library = nullptr;
	const cm_model *table = nullptr;
	void *model = nullptr;
	bool traced = false;
};

// Pins of one side that drive pins of the other.
class Wires
{
      public:
	void add(const Pin &from, const Pin &to);
	// Bring every value across; whether one of them differs from what was there.
	bool carry()
	{
		bool changed = false;
		for (const Wire &wire : wires) {
			switch (wire.bytes) {
			case 1:
				changed |= move<uint8_t>(wire);
				break;
			case 2:
				changed |= move<uint16_t>(wire);
				break;
			case 4:
				changed |= move<uint32_t>(wire);
				break;
			case 8:
				changed |= move<uint64_t>(wire);
				break;
			default:
				if (memcmp(wire.to, wire.from, wire.bytes)) {
					memcpy(wire.to, wire.from, wire.bytes);
					changed = true;
				}
			}
		}
		return changed;
	}

      private:
	struct Wire {
		const uint8_t *from;
		uint8_t *to;
		uint32_t bytes;
	};
	template <typename T> static bool move(const Wire &wire)
	{
		T value;
		memcpy(&value, wire.from, sizeof value);
		if (!memcmp(wire.to, &value, sizeof value))
			return false;
		memcpy(wire.to, &value, sizeof value);
		return true;
	}
	std::vector<Wire> wires;
};
