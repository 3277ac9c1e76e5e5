// SPDX-License-Identifier: Apache-2.0
//
// How fast simulated time may pass: by default as fast as the machine can while something moves.
#pragma once
#include <cstdint>
#include <ctime>

class Pace
{
      public:
	// A second of simulated time takes at least so many seconds of the wall clock; 0: no limit.
	void slow_to(double seconds)
	{
		scale = seconds;
		begun = wall();
	}
	bool slowed() const
	{
		return scale > 0;
	}
	// Whether clocks may run on, when they stand at so many picoseconds.
	bool due(uint64_t picoseconds) const
	{
		return !slowed() || left(picoseconds) <= 0;
	}
	// How long to wait until they may; `otherwise` where there is no limit.
	int wait_ms(uint64_t picoseconds, int otherwise) const
	{
		if (!slowed())
			return otherwise;
		double ms = left(picoseconds) * 1e3;
		return ms <= 0 ? 0 : ms < 1 ? 1 : ms > otherwise ? otherwise : int(ms);
	}
	void wait(uint64_t picoseconds) const
	{
		double seconds = slowed() ? left(picoseconds) : 0;
		if (seconds <= 0)
			return;
		timespec time = { time_t(seconds),
				  long((seconds - double(time_t(seconds))) * 1e9) };
		nanosleep(&time, nullptr);
	}
	// A machine that was too slow does not hurry afterwards.
	void forgive(uint64_t picoseconds)
	{
		double late = -left(picoseconds);
		if (slowed() && late > 0.005)
			begun += late;
	}

      private:
	static double wall()
	{
		timespec now;
		clock_gettime(CLOCK_MONOTONIC, &now);
		return double(now.tv_sec) + double(now.tv_nsec) * 1e-9;
	}
	double left(uint64_t picoseconds) const
	{
		return begun + double(picoseconds) * 1e-12 * scale - wall();
	}
	double scale = 0, begun = 0;
};
