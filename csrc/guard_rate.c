// SPDX-License-Identifier: Apache-2.0
/*
 * Subscriptions of a peer over all its connections, including ended ones: a peer that keeps reconnecting would
 * otherwise begin anew each time, and libzmq would take apart all its subscriptions in one go.
 */
#include <string.h>

#include "guard_private.h"

#define KNOWN 64 /* peers that are remembered: those that subscribed last */
#define ALL 4	 /* times what one connection may send */

static struct known {
	struct cm_guard_peer peer;
	uint32_t credit;
	int64_t since; /* of the credit, in seconds; 0: unused */
} known[KNOWN];

static struct known *find(const struct cm_guard_peer *peer, uint32_t most, int64_t now_s)
{
	struct known *oldest = &known[0];

	for (struct known *each = known; each < known + KNOWN; each++) {
		if (each->since && cm_guard_same(&each->peer, peer))
			return each;
		if (each->since < oldest->since)
			oldest = each;
	}
	*oldest = (struct known){ .peer = *peer, .credit = most, .since = now_s };
	return oldest;
}

bool cm_guard_pay(const struct cm_guard_peer *peer, uint32_t topics, uint32_t each, int64_t now_s)
{
	uint32_t most = each * ALL;
	struct known *one = find(peer, most, now_s);
	int64_t passed = now_s - one->since;

	if (passed >= 16 || one->credit > most)
		one->credit = most;
	else if (passed > 0)
		one->credit += (uint32_t)((uint64_t)passed * most / 16);
	if (one->credit > most)
		one->credit = most;
	one->since = now_s;
	if (topics > one->credit) {
		one->credit = 0;
		return false;
	}
	one->credit -= topics;
	return true;
}
