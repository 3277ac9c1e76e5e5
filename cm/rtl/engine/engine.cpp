// SPDX-License-Identifier: Apache-2.0
//
// The process in which the Verilated logic of a simulated board runs: takes requests from its socket, runs the
// clocks while something moves, and tells what came of it. Started by cm/rtl/process.py: its arguments are a file
// with the wiring as lines of text, and the descriptors of its socket and of the arena.
#include "fabric.h"
#include "messages.h"

#include <cerrno>
#include <cinttypes>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <deque>
#include <fstream>
#include <poll.h>
#include <sstream>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <tuple>
#include <unistd.h>

namespace
{
constexpr size_t TEXT = 4096;
constexpr uint64_t QUIET =
	20000; // edges after the last thing that moved, until the clocks slow down
constexpr uint64_t IDLE_EDGES = 1000; // of the clocks in each IDLE_MS while nothing moves
constexpr int IDLE_MS = 10;
constexpr uint64_t BUS_PATIENCE = 100000; // edges until an access that nobody answers is given up
constexpr int HANG_SECONDS = 2;		  // for one evaluation
Fabric *watched;
bool looked_once;

struct Bus {
	LiteMaster master;
	uint32_t clock;
	std::vector<std::pair<uint64_t, uint64_t>> windows; // base, end
};

void tick(int)
{
	// twice the same evaluation: it has run for a whole period at least
	if (!watched->hangs())
		looked_once = false;
	else if (looked_once)
		watched->leave("it hangs: an evaluation did not end in " +
			       std::to_string(HANG_SECONDS) + " s");
	else
		looked_once = true;
}

void crashed(int number)
{
	watched->leave(std::string("its code was ended by ") + strsignal(number));
}

class Engine
{
      public:
	Engine(std::istream &wiring, int socket, int arena);
	int serve();

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
	uint64_t quiet = QUIET;
	std::vector<uint32_t> configured;
	bool port_error = false, reverses = false;
	int connection;
	uint8_t *memory;
	bool ended = false;
};

Engine::Engine(std::istream &wiring, int socket, int arena_fd) : connection(socket)
{
	void *mapped = mmap(nullptr, CM_ARENA_BYTES, PROT_READ | PROT_WRITE,
			    MAP_SHARED | MAP_NORESERVE, arena_fd, 0);
	if (mapped == MAP_FAILED)
		throw Failure("the arena cannot be mapped");
	memory = static_cast<uint8_t *>(mapped);
	for (std::string line; std::getline(wiring, line);)
		wire(line);
	if (!fabric)
		throw Failure("the wiring names no static part");
}

// One line of the wiring: see cm/rtl/wiring.py
void Engine::wire(const std::string &line)
{
	std::istringstream words(line);
	std::string kind, name;
	uint32_t clock = 0;
	words >> kind;
	if (kind == "static") {
		uint64_t seed;
		words >> seed >> name;
		fabric = std::make_unique<Fabric>(
			name, seed,
			[this](uint32_t region, const std::string &why) {
				tell(CM_STOPPED, region, 0, 0, why);
			},
			[this](uint32_t value, bool taken) { return clocked(value, taken); });
		watched = fabric.get();
		interrupt = fabric->part().find("irq");
	} else if (kind == "clock") {
		uint64_t period;
		words >> name >> period;
		fabric->add_clock(name, period);
	} else if (kind == "bus") {
		words >> name >> clock;
		auto bus =
			std::make_unique<Bus>(Bus{ LiteMaster(fabric->part(), name), clock, {} });
		for (uint64_t base, end; words >> base >> end;)
			bus->windows.emplace_back(base, end);
		fabric->clock(clock).masters.push_back(&bus->master);
		buses.push_back(std::move(bus));
	} else if (kind == "source" || kind == "sink") {
		words >> name >> clock;
		bool source = kind == "source";
		sources.push_back(source ? std::make_unique<Source>(fabric->part(), name)
					 : nullptr);
		sinks.push_back(source ? nullptr : std::make_unique<Sink>(fabric->part(), name));
		if (source)
			fabric->clock(clock).sources.push_back(sources.back().get());
		else
			fabric->clock(clock).sinks.push_back(sinks.back().get());
	} else if (kind == "drain") {
		words >> name >> clock;
		drains.push_back(std::make_unique<Sink>(fabric->part(), name));
		drains.back()->always_ready();
		fabric->clock(clock).sinks.push_back(drains.back().get());
	} else if (kind == "memory") {
		words >> name >> clock;
		Store store;
		store.read = [this](uint64_t address, uint8_t *to, uint32_t length) {
			bool there = exchange(CM_FETCH, address, length);
			memcpy(to, memory + CM_EXCHANGE, length);
			return there;
		};
		store.write = [this](uint64_t address, const uint8_t *from, const uint8_t *mask,
				     uint32_t length) {
			memcpy(memory + CM_EXCHANGE, from, length);
			memcpy(memory + CM_EXCHANGE + length, mask, length);
			return exchange(CM_STORE, address, length);
		};
		memories.push_back(std::make_unique<MemorySlave>(fabric->part(), name, store));
		fabric->clock(clock).memories.push_back(memories.back().get());
	} else if (kind == "port") {
		words >> name >> clock >> reverses;
		port = std::make_unique<Source>(fabric->part(), name);
		fabric->clock(clock).sources.push_back(port.get());
	} else if (kind == "output") {
		words >> name;
		outputs.emplace_back(fabric->part().need(name), 0);
	} else if (kind == "region") {
		region(words);
	} else if (!kind.empty()) {
		throw Failure("the wiring says " + kind + ", which is nothing");
	}
}

void Engine::region(std::istringstream &words)
{
	Region made;
	words >> made.name >> made.prefix;
	std::string pin;
	for (uint32_t clock; words >> pin >> clock;)
		made.clocks.emplace_back(pin, clock);
	names.push_back(made.name);
	fabric->add_region(std::move(made));
}

uint8_t *Engine::arena(uint64_t offset, uint64_t length) const
{
	if (offset > CM_ARENA_BYTES || length > CM_ARENA_BYTES - offset)
		throw Failure("a request points behind the arena");
	return memory + offset;
}

void Engine::send(const cm_message &message, const std::string &text)
{
	std::string packet(reinterpret_cast<const char *>(&message), sizeof message);
	packet += text.substr(0, TEXT);
	if (::send(connection, packet.data(), packet.size(), MSG_NOSIGNAL) < 0)
		ended = true; // the board is gone
}

void Engine::tell(uint32_t op, uint64_t a, uint64_t b, uint64_t c, const std::string &text)
{
	send(cm_message{ op, 0, a, b, c, 0 }, text);
}

void Engine::answer(const cm_message &request, int status, uint64_t b, const std::string &text)
{
	send(cm_message{ request.op | CM_ANSWER, request.id, uint64_t(status), b, 0, 0 }, text);
}

// Run the clocks; whether anything moved.
bool Engine::run(uint64_t edges)
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

void Engine::report()
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

bool Engine::ends(const Bus &bus, bool write)
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
int Engine::word(Bus &bus, bool write, uint32_t address, uint32_t value, uint32_t strobes,
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

int Engine::access(const cm_message &message)
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
int Engine::clocked(uint32_t value, bool taken)
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

int Engine::configure(const cm_message &message, uint64_t &came_out)
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

static uint64_t cpu_ns()
{
	timespec now;
	clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
	return uint64_t(now.tv_sec) * 1000000000 + uint64_t(now.tv_nsec);
}

std::string Engine::state() const
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

void Engine::handle(const cm_message &message, const std::string &text)
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
			sources[stream]->send(arena(message.b, message.c), message.c);
		break;
	case CM_RECEIVE:
		if (!known || !sinks[stream])
			status = ENOENT;
		else if (sinks[stream]->armed())
			status = EBUSY;
		else
			sinks[stream]->receive(arena(message.b, message.c), message.c);
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
	case CM_STATE:
		reply = state();
		break;
	case CM_SPIN:
		run(message.b);
		break;
	default:
		status = ENOSYS;
	}
	fabric->touch();
	quiet = 0;
	answer(message, status, b, reply);
}

bool Engine::receive(cm_message &message, std::string &text)
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

// Bytes of the board's memory; meanwhile the board may ask us for something, which then waits.
bool Engine::exchange(uint32_t op, uint64_t address, uint32_t length)
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

bool Engine::take(int wait_ms)
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

int Engine::serve()
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

void catch_signals()
{
	static char stack[65536];
	stack_t other = { stack, 0, sizeof stack };
	sigaltstack(&other, nullptr);
	struct sigaction action = {};
	action.sa_flags = SA_ONSTACK | SA_NODEFER;
	action.sa_handler = crashed;
	for (int number : { SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT })
		sigaction(number, &action, nullptr);
	action.sa_flags |= SA_RESTART;
	action.sa_handler = tick;
	sigaction(SIGALRM, &action, nullptr);
	itimerval every = { { HANG_SECONDS, 0 }, { HANG_SECONDS, 0 } };
	setitimer(ITIMER_REAL, &every, nullptr);
}
} // namespace

int main(int argc, char **argv)
{
	if (argc != 4) {
		fprintf(stderr, "usage: %s WIRING SOCKET ARENA\n", argv[0]);
		return 2;
	}
	try {
		std::ifstream wiring(argv[1]);
		Engine engine(wiring, atoi(argv[2]), atoi(argv[3]));
		catch_signals();
		return engine.serve();
	} catch (const std::exception &failure) {
		fprintf(stderr, "cm rtl: %s\n", failure.what());
		return 1;
	}
}
