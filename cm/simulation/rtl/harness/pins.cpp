// SPDX-License-Identifier: Apache-2.0
#include "pins.h"

#include <dlfcn.h>

Instance::Instance(const std::string &path, uint64_t seed, const cm_host *host)
{
	library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
	if (!library)
		throw Failure(dlerror());
	auto found = static_cast<const cm_model *const *>(dlsym(library, CM_MODEL_SYMBOL));
	if (!found || (*found)->version != CM_MODEL_VERSION) {
		dlclose(library);
		throw Failure(path + " is no model of this version");
	}
	table = *found;
	model = table->create(seed, host);
}

Instance::~Instance()
{
	if (!model)
		return; // and its library stays: a frame of its code may be on a stack that was left
	untrace();
	table->destroy(model);
	dlclose(library);
}

Pin Instance::at(uint32_t index) const
{
	return Pin{ static_cast<uint8_t *>(table->where(model, index)), table->pin[index].bits };
}

Pin Instance::find(const std::string &name) const
{
	for (uint32_t index = 0; index < table->pins; index++)
		if (name == table->pin[index].name)
			return at(index);
	return Pin{};
}

Pin Instance::need(const std::string &name) const
{
	Pin pin = find(name);
	if (!pin)
		throw Failure("there is no pin " + name);
	return pin;
}

bool Instance::trace(const std::string &path)
{
	traced = table->trace && table->trace(model, path.c_str()) == 0;
	return traced;
}

void Instance::untrace()
{
	if (traced && model)
		table->untrace(model);
	traced = false;
}

void Wires::add(const Pin &from, const Pin &to)
{
	if (from.bits != to.bits)
		throw Failure("two pins of different widths are joined");
	wires.push_back(Wire{ from.at, to.at, pin_bytes(from.bits) });
}
