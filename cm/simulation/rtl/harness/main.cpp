// SPDX-License-Identifier: Apache-2.0
//
// The process in which the Verilated logic of a simulated board runs. Started by cm/simulation/rtl/process.py: its arguments are
// a file with the wiring as lines of text, and the descriptors of its socket and of the arena.
#include "harness.h"

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sys/time.h>

namespace
{
constexpr int HANG_SECONDS = 2; // for one evaluation
Fabric *watched;
bool looked_once;

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
		Harness harness(wiring, atoi(argv[2]), atoi(argv[3]));
		watched = &harness.logic();
		catch_signals();
		return harness.serve();
	} catch (const std::exception &failure) {
		fprintf(stderr, "cm rtl: %s\n", failure.what());
		return 1;
	}
}
