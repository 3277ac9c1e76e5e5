// SPDX-License-Identifier: Apache-2.0
/*
 * What a peer does over all its connections, including ended ones. Subscriptions: a peer that keeps reconnecting would
 * otherwise begin anew each time, and libzmq would take apart all its subscriptions in one go. Connecting itself: one
 * that connects without end keeps others out.
 */
#include <string.h>

#include "guard_private.h"

#define KNOWN 64	/* peers that are remembered: those that came last */
#define ALL 4		/* times what one connection may send */
#define TOPICS_MS 16000 /* until what was spent has come back */
#define CONNECTS_MS 1000

struct known {
	struct cm_guard_peer peer;
	uint32_t credit;
	int64_t since; /* of the credit, in milliseconds; 0: unused */
};

static struct known subscribers[KNOWN], connecters[KNOWN];

static struct known *find(struct known *all, const struct cm_guard_peer *peer, uint32_t most,
			  int64_t now_ms)
{
	struct known *oldest = all;

	for (struct known *each = all; each < all + KNOWN; each++) {
		if (each->since && cm_guard_same(&each->peer, peer))
			return each;
		if (each->since < oldest->since)
			oldest = each;
	}
	*oldest = (struct known){ .peer = *peer, .credit = most, .since = now_ms };
	return oldest;
}

/* Spend some of a credit that comes back within @full_ms; false, with nothing left, if there is less. */
static bool spend(struct known *one, uint32_t some, uint32_t most, int64_t full_ms, int64_t now_ms)
{
	int64_t passed = now_ms - one->since;
	uint64_t back = passed <= 0	   ? 0
			: passed < full_ms ? (uint64_t)passed * most / (uint64_t)full_ms
					   : most;

	if (back) /* less than one goes on growing */
		one->since = now_ms;
	one->credit = one->credit + back < most ? one->credit + (uint32_t)back : most;
	if (some > one->credit) {
		one->credit = 0;
		return false;
	}
	one->credit -= some;
	return true;
}

bool cm_guard_pay(const struct cm_guard_peer *peer, uint32_t topics, uint32_t each, int64_t now_s)
{
	int64_t now_ms = now_s * 1000;

	return spend(find(subscribers, peer, each * ALL, now_ms), topics, each * ALL, TOPICS_MS,
		     now_ms);
}

bool cm_guard_connects(const struct cm_guard_peer *peer, uint32_t each, int64_t now_ms)
{
	return spend(find(connecters, peer, each, now_ms), 1, each, CONNECTS_MS, now_ms);
}
