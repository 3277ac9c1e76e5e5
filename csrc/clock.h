/* SPDX-License-Identifier: Apache-2.0 */
/* CLOCK_MONOTONIC in nanoseconds, and the rest of a timeout. */
#ifndef CM_SHIM_CLOCK_H
#define CM_SHIM_CLOCK_H

#include <stdint.h>
#include <time.h>

#define CM_NS_PER_S INT64_C(1000000000)

static inline int64_t cm_clock_ns(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (int64_t)now.tv_sec * CM_NS_PER_S + now.tv_nsec;
}

/* A relative timeout for ppoll(); one that is over counts as 0. */
static inline struct timespec cm_clock_timespec(int64_t timeout_ns)
{
	struct timespec limit = { 0 };

	if (timeout_ns > 0) {
		limit.tv_sec = (time_t)(timeout_ns / CM_NS_PER_S);
		limit.tv_nsec = (long)(timeout_ns % CM_NS_PER_S);
	}
	return limit;
}

/* The time at which a relative timeout ends: now if it is over, INT64_MAX if never. */
static inline int64_t cm_clock_deadline(int64_t timeout_ns)
{
	int64_t now = cm_clock_ns();

	if (timeout_ns <= 0)
		return now;
	return timeout_ns > INT64_MAX - now ? INT64_MAX : now + timeout_ns;
}

/* The time left until @deadline; INT64_MAX stays INT64_MAX. */
static inline int64_t cm_clock_left(int64_t deadline)
{
	return deadline == INT64_MAX ? INT64_MAX : deadline - cm_clock_ns();
}

#endif /* CM_SHIM_CLOCK_H */
