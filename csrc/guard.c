// SPDX-License-Identifier: Apache-2.0
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <pthread.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

#include "guard_private.h"

#define DESCRIPTORS 65536 /* connections with a higher one are refused */
#define FEW 4		  /* connections of a peer that counts as a newcomer */

pthread_mutex_t cm_guard_lock = PTHREAD_MUTEX_INITIALIZER;
/* Only pages of descriptors that were used are memory. */
static struct cm_guard_place places[DESCRIPTORS];
static int first = -1;
struct cm_guard_limits cm_guard_limits;
static struct cm_guard_counts counts;
static uint64_t serials;
int cm_guard_spare = -1;
_Thread_local uint32_t cm_guard_expected;

struct cm_guard_place *cm_guard_place(int fd)
{
	return fd >= 0 && fd < DESCRIPTORS ? &places[fd] : NULL;
}

int cm_guard_first(void)
{
	return first;
}

bool cm_guard_same(const struct cm_guard_peer *a, const struct cm_guard_peer *b)
{
	return a->pid || b->pid ? a->pid == b->pid
				: !memcmp(a->address, b->address, sizeof(a->address));
}

/* IPv4 in full; of IPv6 the network half, since one owner has all addresses in a network. */
static void note_address(struct cm_guard_peer *peer, const struct sockaddr_storage *from)
{
	if (from->ss_family == AF_INET6) {
		const struct in6_addr *address = &((const struct sockaddr_in6 *)from)->sin6_addr;

		memcpy(peer->address, address,
		       IN6_IS_ADDR_V4MAPPED(address) || IN6_IS_ADDR_LOOPBACK(address) ? 16 : 8);
	} else if (from->ss_family == AF_INET) {
		peer->address[10] = peer->address[11] = 0xff;
		memcpy(peer->address + 12, &((const struct sockaddr_in *)from)->sin_addr, 4);
	}
}

struct cm_guard_peer cm_guard_look(int fd, uint32_t kind, const struct sockaddr_storage *from)
{
	struct cm_guard_peer peer = { .fd = fd, .kind = kind };
	struct ucred who = { 0 };
	socklen_t size = sizeof(who);

	if (from->ss_family != AF_UNIX) {
		note_address(&peer, from);
	} else if (!getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &who, &size)) {
		peer.pid = who.pid ? who.pid
				   : -1; /* in another PID namespace: all of those count as one */
		peer.uid = who.uid;
		peer.gid = who.gid;
	}
	return peer;
}

void cm_guard_refuse(const struct cm_guard_peer *peer, int cause)
{
	counts.refused[cause]++;
	counts.last = *peer;
	counts.last_cause = (uint32_t)cause;
}

static int cause_against(const struct cm_guard_peer *peer)
{
	struct rlimit most = { 0 };
	uint32_t held = 0, user = 0;

	for (int fd = first; fd >= 0; fd = places[fd].next) {
		held += cm_guard_same(&places[fd].peer, peer);
		user += peer->pid && places[fd].peer.pid && places[fd].peer.uid == peer->uid;
	}
	if (peer->fd >= DESCRIPTORS ||
	    (!getrlimit(RLIMIT_NOFILE, &most) && most.rlim_cur != RLIM_INFINITY &&
	     (uint64_t)peer->fd + cm_guard_limits.descriptors >= most.rlim_cur))
		return CM_GUARD_DESCRIPTORS;
	if ((cm_guard_limits.each && held >= cm_guard_limits.each) ||
	    (cm_guard_limits.connections && user >= cm_guard_limits.connections / 4 * 3))
		return CM_GUARD_EACH;
	if (cm_guard_limits.connections &&
	    counts.connections + (held < FEW ? 0 : cm_guard_limits.newcomers) >=
		    cm_guard_limits.connections)
		return CM_GUARD_FULL;
	return -1;
}

static bool enter(const struct cm_guard_peer *peer)
{
	struct cm_guard_place *place = cm_guard_place(peer->fd);

	place->peer = *peer;
	if (!cm_guard_owe(place))
		return false;
	place->next = first;
	place->before = -1;
	cm_guard_begin(&place->stream);
	atomic_store(&place->frames, 0); /* one by one: the last one may be being reported */
	if (first >= 0)
		places[first].before = peer->fd;
	first = peer->fd;
	place->peer.serial = ++serials;
	counts.connections++;
	atomic_store(&place->kind, peer->kind);
	return true;
}

bool cm_guard_admit(const struct cm_guard_peer *peer, int64_t now_ms, bool crowded)
{
	bool often;
	int cause;

	pthread_mutex_lock(&cm_guard_lock);
	often = cm_guard_limits.each && !cm_guard_connects(peer, cm_guard_limits.each, now_ms);
	cause = often && crowded ? CM_GUARD_OFTEN : cause_against(peer);
	if (cause < 0 && !enter(peer))
		cause = CM_GUARD_FULL;
	if (cause >= 0)
		cm_guard_refuse(peer, cause);
	pthread_mutex_unlock(&cm_guard_lock);
	return cause < 0;
}

void cm_guard_leave(struct cm_guard_place *place)
{
	if (place->before >= 0)
		places[place->before].next = place->next;
	else
		first = place->next;
	if (place->next >= 0)
		places[place->next].before = place->before;
	counts.connections--;
	cm_guard_quit(place);
}

void cm_guard_limit(const struct cm_guard_limits *wanted)
{
	pthread_mutex_lock(&cm_guard_lock);
	cm_guard_limits = *wanted;
	if (cm_guard_spare < 0)
		cm_guard_spare = open("/dev/null", O_RDONLY | O_CLOEXEC);
	pthread_mutex_unlock(&cm_guard_lock);
}

struct cm_guard_limits cm_guard_bounds(void)
{
	struct cm_guard_limits now;

	pthread_mutex_lock(&cm_guard_lock);
	now = cm_guard_limits;
	pthread_mutex_unlock(&cm_guard_lock);
	return now;
}

void cm_guard_expect(uint32_t kind)
{
	cm_guard_expected = kind;
}

int cm_guard_peers(struct cm_guard_peer *peers, int max)
{
	int count = 0;

	pthread_mutex_lock(&cm_guard_lock);
	for (int fd = first; fd >= 0 && count < max; fd = places[fd].next)
		peers[count++] = places[fd].peer;
	pthread_mutex_unlock(&cm_guard_lock);
	return count;
}

int cm_guard_peer(int fd, struct cm_guard_peer *peer)
{
	struct cm_guard_place *place = cm_guard_place(fd);
	int result = -1;

	pthread_mutex_lock(&cm_guard_lock);
	if (place && atomic_load(&place->kind)) {
		*peer = place->peer;
		result = 0;
	}
	pthread_mutex_unlock(&cm_guard_lock);
	if (result)
		errno = ENOENT;
	return result;
}

uint64_t cm_guard_serial(int fd)
{
	struct cm_guard_peer peer;

	return cm_guard_peer(fd, &peer) ? 0 : peer.serial;
}

int cm_guard_cut(int fd)
{
	struct cm_guard_place *place = cm_guard_place(fd);
	int result = -1;

	pthread_mutex_lock(&cm_guard_lock);
	if (place && atomic_load(&place->kind)) {
		cm_guard_refuse(&place->peer, CM_GUARD_CUT);
		shutdown(fd, SHUT_RDWR);
		result = 0;
	}
	pthread_mutex_unlock(&cm_guard_lock);
	if (result)
		errno = ENOENT;
	return result;
}

void cm_guard_count(struct cm_guard_counts *now)
{
	pthread_mutex_lock(&cm_guard_lock);
	*now = counts;
	pthread_mutex_unlock(&cm_guard_lock);
}
