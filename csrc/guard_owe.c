// SPDX-License-Identifier: Apache-2.0
/*
 * Connections whose peers have sent as much as may wait: they are read no further.
 *
 * What counts as waiting are whole messages that the manager has not taken, and what a long message may still become:
 * before it is read, it gets a place of as many bytes as a message may have, and gives it back when it is whole. A peer
 * may have two times @bytes waiting, a user three times, all together four times; a connection with nothing waiting may
 * always go on if no other has anything waiting.
 */
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "guard_private.h"

#define LOOKS 10 /* seconds for which a place is kept while others wait for one, */
#define STALLS 2 /* or in which less comes than */
#define LEAST (64 << 10)
#define PINGS 4		/* frames of a connection in a second, which libzmq keeps to itself */
#define PING_BYTES 1024 /* and what they count for */

static uint64_t all; /* bytes of all connections */
static uint64_t turn;
static uint32_t waiting; /* connections that are held for what they owe */

static struct cm_guard_sum *sum_of(const struct cm_guard_peer *peer, bool user)
{
	for (int fd = cm_guard_first(); fd >= 0; fd = cm_guard_place(fd)->next) {
		const struct cm_guard_place *other = cm_guard_place(fd);

		if (user ? peer->pid && other->peer.pid && other->peer.uid == peer->uid
			 : cm_guard_same(&other->peer, peer))
			return user ? other->user : other->mine;
	}
	return calloc(1, sizeof(struct cm_guard_sum));
}

static void put_back(struct cm_guard_sum *sum)
{
	if (sum && !--sum->connections)
		free(sum);
}

bool cm_guard_owe(struct cm_guard_place *place)
{
	place->mine = sum_of(&place->peer, false);
	if (!place->mine)
		return false;
	place->mine->connections++;
	place->user = place->peer.pid ? sum_of(&place->peer, true) : place->mine;
	if (!place->user) {
		put_back(place->mine);
		return false;
	}
	place->user->connections++;
	place->came = place->small = place->taken = place->owes = 0;
	place->looks = place->stalls = 0;
	place->stuck = 0;
	place->ended = false;
	place->has_place = place->wants_place = place->curve = false;
	place->epoll = -1;
	atomic_store(&place->held, 0);
	return true;
}

/* Recount what it owes. */
static void reckon(struct cm_guard_place *place, uint64_t bytes)
{
	uint64_t now = (place->came > place->taken ? place->came - place->taken : 0) +
		       place->small + (place->has_place ? bytes : 0);

	all += now - place->owes;
	place->user->owes += now - place->owes;
	if (place->user != place->mine)
		place->mine->owes += now - place->owes;
	place->owes = now;
}

static bool may_go_on(const struct cm_guard_place *place, uint64_t bytes)
{
	uint64_t more = place->wants_place ? bytes : 0;

	if (!bytes || place->has_place || (!place->owes && !more) || !all)
		return true;
	return place->mine->owes + more <= 2 * bytes && place->user->owes + more <= 3 * bytes &&
	       all + more <= 4 * bytes;
}

/* Let it go on if nothing prevents that; a long message then has its place. */
static bool let_on(struct cm_guard_place *place, uint64_t bytes)
{
	if (!may_go_on(place, bytes))
		return false;
	place->has_place = place->has_place || place->wants_place;
	place->wants_place = false;
	reckon(place, bytes);
	waiting -= cm_guard_go_on(place, CM_GUARD_HELD_OWES);
	return true;
}

static bool comes_before(const struct cm_guard_place *one, const struct cm_guard_place *other)
{
	if (one->user->owes != other->user->owes)
		return one->user->owes < other->user->owes;
	if (one->mine->owes != other->mine->owes)
		return one->mine->owes < other->mine->owes;
	return one->since < other->since;
}

/*
 * Something was taken or has gone: of the connections that may go on, those whose user owes least come first, then
 * those whose process does, then the one that has waited longest.
 */
static void let_others_on(uint64_t bytes)
{
	struct cm_guard_place *best, *each;

	do {
		best = NULL;
		for (int fd = waiting ? cm_guard_first() : -1; fd >= 0; fd = each->next) {
			each = cm_guard_place(fd);
			if (!(atomic_load(&each->held) & CM_GUARD_HELD_OWES) ||
			    !may_go_on(each, bytes))
				continue;
			if (!best || comes_before(each, best))
				best = each;
		}
	} while (best && let_on(best, bytes));
}

void cm_guard_settle(struct cm_guard_place *place, const struct cm_guard_limits *limits)
{
	bool is_long = cm_guard_is_long(&place->stream), had = place->has_place;

	if (limits->bytes) {
		place->has_place = had && is_long;
		place->wants_place = is_long && !had;
	}
	if (place->came != place->stream.came || (!place->has_place && !place->stream.curve))
		place->looks = 0;
	place->curve = place->stream.curve;
	place->came = place->stream.came;
	place->small += place->stream.small; /* those since the last time */
	place->stream.small = 0;
	reckon(place, limits->bytes);
	if (!let_on(place, limits->bytes) && cm_guard_stop(place, CM_GUARD_HELD_OWES)) {
		place->since = ++turn;
		waiting++;
	}
	if (had && !place->has_place)
		let_others_on(limits->bytes);
}

void cm_guard_taken(int fd, uint64_t bytes)
{
	struct cm_guard_place *place = cm_guard_place(fd);

	if (!place || !atomic_load(&place->kind))
		return;
	pthread_mutex_lock(&cm_guard_lock);
	/* The descriptor may be another connection by now: count no more than that one has sent. */
	if (atomic_load(&place->kind)) {
		place->taken +=
			bytes < place->came - place->taken ? bytes : place->came - place->taken;
		place->small = 0;
		place->looks = place->has_place ? place->looks : 0;
		atomic_store(&place->frames, atomic_load(&place->stream.frames));
		reckon(place, cm_guard_limits.bytes);
		let_others_on(cm_guard_limits.bytes);
	}
	pthread_mutex_unlock(&cm_guard_lock);
}

/* Pings are encrypted like everything else, and are never taken: those of a second are forgotten. */
static void forget_pings(struct cm_guard_place *place)
{
	uint32_t frames = atomic_load(&place->stream.frames) - atomic_load(&place->frames);

	atomic_fetch_add(&place->frames, frames < PINGS ? frames : PINGS);
	place->small -= place->small < PING_BYTES ? place->small : PING_BYTES;
	reckon(place, cm_guard_limits.bytes);
}

void cm_guard_look_on(void)
{
	struct cm_guard_place *place;

	pthread_mutex_lock(&cm_guard_lock);
	for (int fd = cm_guard_first(); fd >= 0; fd = place->next) {
		place = cm_guard_place(fd);
		if (place->curve)
			forget_pings(place);
		place->looks = place->has_place || place->owes ? place->looks + 1 : 0;
		place->stalls = atomic_exchange(&place->read, 0) < LEAST ? place->stalls + 1 : 0;
		if (waiting && (place->has_place || place->curve) && place->looks > STALLS &&
		    (place->looks > LOOKS || place->stalls > STALLS)) {
			cm_guard_refuse(&place->peer, CM_GUARD_SLOW);
			shutdown(fd, SHUT_RDWR);
		}
	}
	let_others_on(cm_guard_limits.bytes);
	pthread_mutex_unlock(&cm_guard_lock);
}

void cm_guard_quit(struct cm_guard_place *place)
{
	waiting -= cm_guard_go_on(place, CM_GUARD_HELD_OWES);
	place->came = place->small = place->taken = 0;
	place->has_place = place->wants_place = false;
	reckon(place, 0);
	if (place->user != place->mine)
		put_back(place->user);
	else
		place->user->connections--;
	put_back(place->mine);
	place->mine = place->user = NULL;
	let_others_on(cm_guard_limits.bytes);
}
