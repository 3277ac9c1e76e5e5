// SPDX-License-Identifier: Apache-2.0
//
// Requests and what is told; the clocks while there is something to do.
#include "harness.h"

#include <cerrno>
#include <ctime>
#include <poll.h>
#include <sstream>
#include <sys/socket.h>
#include <tuple>

namespace
{
constexpr uint64_t QUIET =
	20000; // edges after the last thing that moved, until the clocks slow down
constexpr uint64_t IDLE_EDGES = 1000; // of the clocks in each IDLE_MS while nothing moves
constexpr int IDLE_MS = 10;

uint64_t cpu_ns()
{
	timespec now;
	clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
	return uint64_t(now.tv_sec) * 1000000000 + uint64_t(now.tv_nsec);
}

} // namespace

void Harness::send(const cm_message &message, const std::string &text)
{
	std::string packet(reinterpret_cast<const char *>(&message), sizeof message);
	packet += text.substr(0, TEXT);
	if (::send(connection, packet.data(), packet.size(), MSG_NOSIGNAL) < 0)
		ended = true; // the board is gone
}

void Harness::tell(uint32_t op, uint64_t a, uint64_t b, uint64_t c, const std::string &text)
{
	send(cm_message{ op, 0, a, b, c, 0 }, text);
}

void Harness::answer(const cm_message &request, int status, uint64_t b, const std::string &text)
{
	send(cm_message{ request.op | CM_ANSWER, request.id, uint64_t(status), b, 0, 0 }, text);
}

// Run the clocks; whether anything moved.
bool Harness::run(uint64_t edges)
{
	bool moved = false;
	for (auto &bus : buses)
		moved |= bus->master.busy();
	uint64_t before = 0, after = 0;
	for (auto &source : sources)
		before += source ? source->beats : 0;
	for (auto &sink : sinks)
		before += sink ? sink->beats : 0;
	for (auto &slave : memories)
		before += slave->beats;
	fabric->run(edges);
	for (auto &source : sources)
		after += source ? source->beats : 0;
	for (auto &sink : sinks)
		after += sink ? sink->beats : 0;
	for (auto &slave : memories)
		after += slave->beats;
	moved |= before != after;
	quiet = moved ? 0 : quiet + edges;
	report();
	return moved;
}

void Harness::report()
{
	for (uint32_t stream = 0; stream < sources.size(); stream++) {
		uint64_t length;
		bool overflow;
		if (sources[stream] && sources[stream]->done())
			tell(CM_SENT, stream);
		if (sinks[stream] && sinks[stream]->done(length, overflow))
			tell(CM_RECEIVED, stream, length, overflow);
	}
	if (interrupt.get() != level) {
		level = interrupt.get();
		quiet = 0;
		tell(CM_INTERRUPT, level);
	}
	for (uint32_t index = 0; index < outputs.size(); index++) {
		uint64_t value = outputs[index].first.get();
		if (value == outputs[index].second)
			continue;
		outputs[index].second = value;
		tell(CM_OUTPUT, index, value);
	}
}

std::string Harness::state() const
{
	std::ostringstream text;
	text << "{\"picoseconds\": " << fabric->picoseconds() << ", \"cpu_ns\": " << cpu_ns()
	     << ", \"cycles\": {";
	for (uint32_t index = 0; index < fabric->clock_count(); index++) {
		const Clock &clock = fabric->clock(index);
		text << (index ? ", " : "") << "\"" << clock.name << "\": " << clock.cycles;
	}
	text << "}, \"loaded_at\": {";
	for (uint32_t index = 0; index < names.size(); index++)
		text << (index ? ", " : "") << "\"" << names[index]
		     << "\": " << fabric->loaded_at(index);
	text << "}}";
	return text.str();
}

void Harness::handle(const cm_message &message, const std::string &text)
{
	uint64_t b = 0;
	std::string reply;
	int status = 0;
	uint32_t stream = uint32_t(message.a);
	bool known = stream < sources.size();
	switch (message.op) {
	case CM_READ:
	case CM_WRITE:
		status = access(message);
		break;
	case CM_SEND:
		if (!known || !sources[stream])
			status = ENOENT;
		else if (sources[stream]->busy())
			status = EBUSY;
		else
			sources[stream]->send(arena(message.b, message.c), message.c, message.d);
		break;
	case CM_RECEIVE:
		if (!known || !sinks[stream])
			status = ENOENT;
		else if (sinks[stream]->armed())
			status = EBUSY;
		else
			sinks[stream]->receive(arena(message.b, message.c), message.c, message.d);
		break;
	case CM_CANCEL:
		if (known && sources[stream])
			sources[stream]->cancel();
		if (known && sinks[stream])
			sinks[stream]->cancel();
		break;
	case CM_LOAD:
		fabric->load(uint32_t(message.a), text, message.b);
		break;
	case CM_UNDEFINE:
		fabric->undefine(uint32_t(message.a), message.b);
		break;
	case CM_EMPTY:
		fabric->empty(uint32_t(message.a));
		break;
	case CM_CONFIGURE:
		status = configure(message, b);
		break;
	case CM_RESET:
		fabric->reset();
		break;
	case CM_TRACE:
		if (text.empty())
			fabric->untrace();
		else
			fabric->trace(text);
		break;
	case CM_MARK:
		fabric->mark(text);
		break;
	case CM_TRY:
		reply = fabric->lacks(text);
		status = reply.empty() ? 0 : ENOENT;
		break;
	case CM_STATE:
		reply = state();
		break;
	default:
		status = ENOSYS;
	}
	fabric->touch();
	quiet = 0;
	answer(message, status, b, reply);
}

bool Harness::receive(cm_message &message, std::string &text)
{
	char packet[sizeof(cm_message) + TEXT];
	ssize_t length = recv(connection, packet, sizeof packet, 0);
	if (length < ssize_t(sizeof(cm_message))) {
		ended = ended || length == 0 || errno != EINTR;
		return false;
	}
	memcpy(&message, packet, sizeof message);
	text.assign(packet + sizeof message, size_t(length) - sizeof message);
	return true;
}

bool Harness::take(int wait_ms)
{
	cm_message message;
	std::string text;
	if (!postponed.empty()) {
		std::tie(message, text) = postponed.front();
		postponed.pop_front();
	} else {
		pollfd waiting = { connection, POLLIN, 0 };
		if (poll(&waiting, 1, wait_ms) <= 0 || !receive(message, text))
			return false;
	}
	try {
		handle(message, text);
	} catch (const Failure &failure) {
		answer(message, EINVAL, 0, failure.what());
	} catch (const std::exception &failure) {
		answer(message, EINVAL, 0, failure.what());
	}
	return true;
}

int Harness::serve()
{
	fabric->reset();
	answer(cm_message{}, 0); // ready
	while (!ended) {
		bool runs = quiet < QUIET;
		while (!ended && take(runs ? 0 : IDLE_MS))
			runs = true;
		if (!ended)
			run(runs ? 512 : IDLE_EDGES);
	}
	return 0;
}
