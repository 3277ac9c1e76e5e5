// SPDX-License-Identifier: Apache-2.0
//
// A Verilated module as the harness sees it: a table of functions in a shared library, and its pins as memory.
#pragma once
#include <cstdint>

enum cm_direction : uint32_t { CM_IN, CM_OUT, CM_INOUT };

struct cm_pin {
	const char *name; // as the HDL calls it
	uint32_t bits;
	uint32_t direction; // enum cm_direction
};

// What a module may do to the harness. `stopped` and `missing` do not return: the module is not called again.
struct cm_host {
	void (*stopped)(const char *how, const char *file, int line, const char *text);
	// A clock of ICAPE2 or ICAPE3, and the word that it took, if it did, as it stood on its pins; whether the port
	// shows an error.
	int (*configured)(uint32_t word, int taken);
	// Where a file is that the HDL names without a folder of the root, or nullptr; and that there is none.
	const char *(*found)(const char *name);
	void (*missing)(const char *name);
};

struct cm_model {
	uint32_t version; // CM_MODEL_VERSION
	uint32_t pins;
	const cm_pin *pin;
	void *(*create)(uint64_t seed, const cm_host *host);
	void (*destroy)(void *model);
	void (*eval)(void *model);
	void *(*where)(void *model,
		       uint32_t pin); // its memory: 1, 2, 4, 8 or a multiple of 4 bytes
	// nullptr where the library was built without tracing
	int (*trace)(void *model, const char *path); // 0, or -1
	void (*dump)(void *model, uint64_t picoseconds);
	void (*untrace)(void *model);
};

constexpr uint32_t CM_MODEL_VERSION = 4;
constexpr const char *CM_MODEL_SYMBOL = "cm_model_table"; // extern "C" const cm_model *
