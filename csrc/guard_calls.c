// SPDX-License-Identifier: Apache-2.0
/* The functions that libzmq calls in place of the C library's. */
#include <errno.h>
#include <poll.h>
#include <time.h>
#include <unistd.h>

#include "guard_private.h"

#define FRAMES 32768 /* unread: more than libzmq lets wait, unless their message has no end */

int cm_guard_close(int fd)
{
	struct cm_guard_place *place = cm_guard_place(fd);
	int result;

	if (!place || (!place->listens && !atomic_load(&place->kind)))
		return close(fd);
	pthread_mutex_lock(&cm_guard_lock);
	if (atomic_exchange(&place->kind, CM_GUARD_NONE))
		cm_guard_leave(place);
	place->listens = CM_GUARD_NONE;
	result = close(fd); /* in the lock: a new one with this descriptor must not be cut */
	pthread_mutex_unlock(&cm_guard_lock);
	return result;
}

static int64_t seconds(void)
{
	struct timespec now = { 0 };

	clock_gettime(CLOCK_MONOTONIC_COARSE, &now);
	return now.tv_sec + 1;
}

/* Whether reading is on hold; what a peer sent before it went is read to its end. */
static bool is_held(int fd, struct cm_guard_place *place)
{
	struct pollfd peer = { .fd = fd };

	if (!atomic_load_explicit(&place->held, memory_order_relaxed))
		return false;
	if (poll(&peer, 1, 0) > 0 && peer.revents & (POLLHUP | POLLERR))
		return false;
	if (place->epoll < 0) /* nothing keeps libzmq from asking again at once */
		nanosleep(&(struct timespec){ .tv_nsec = 200000 }, NULL);
	return true;
}

/* Most messages need no settling. */
static void settle(struct cm_guard_place *place, const struct cm_guard_limits *limits)
{
	const struct cm_guard_stream *stream = &place->stream;

	if (stream->came == place->came && !stream->small &&
	    cm_guard_is_long(stream) == place->has_place)
		return;
	pthread_mutex_lock(&cm_guard_lock);
	cm_guard_settle(place, limits);
	pthread_mutex_unlock(&cm_guard_lock);
}

/* Whether the peer's subscriptions, over all its connections, are still within the bound after this read. */
static bool may_subscribe(const struct cm_guard_place *place, uint32_t topics,
			  const struct cm_guard_limits *limits)
{
	bool may;

	if (!topics || !limits->topics)
		return true;
	pthread_mutex_lock(&cm_guard_lock);
	may = cm_guard_pay(&place->peer, topics, limits->topics, seconds());
	pthread_mutex_unlock(&cm_guard_lock);
	return may;
}

static int ended(struct cm_guard_place *place, int cause)
{
	pthread_mutex_lock(&cm_guard_lock);
	cm_guard_refuse(&place->peer, cause);
	pthread_mutex_unlock(&cm_guard_lock);
	errno = ECONNRESET;
	return -1;
}

ssize_t cm_guard_recv(int fd, void *data, size_t size, int flags)
{
	struct cm_guard_place *place = cm_guard_place(fd);
	uint32_t kind =
		place ? atomic_load_explicit(&place->kind, memory_order_relaxed) : CM_GUARD_NONE;
	struct cm_guard_limits limits = { 0 };
	uint32_t before;
	ssize_t got;
	int cause;

	if (kind)
		limits = cm_guard_bounds();
	if (kind && is_held(fd, place)) {
		errno = EAGAIN;
		return -1;
	}
	if (kind == CM_GUARD_REQUESTS && size > cm_guard_room(&place->stream))
		size = cm_guard_room(&place->stream);
	got = recv(fd, data, size, flags);
	if (got <= 0 || !kind)
		return got;
	if (place->has_place)
		atomic_fetch_add_explicit(&place->read, (uint64_t)got, memory_order_relaxed);
	before = atomic_load_explicit(&place->stream.frames, memory_order_relaxed);
	cause = cm_guard_follow(&place->stream, kind, &limits, data, (size_t)got,
				kind == CM_GUARD_TOPICS ? seconds() : 0);
	if (cause < 0 && kind == CM_GUARD_REQUESTS && place->stream.curve &&
	    place->stream.frames - atomic_load_explicit(&place->frames, memory_order_relaxed) >
		    FRAMES)
		cause = CM_GUARD_PARTS;
	if (cause < 0 && kind == CM_GUARD_TOPICS &&
	    !may_subscribe(place, atomic_load(&place->stream.frames) - before, &limits))
		cause = CM_GUARD_RATE;
	if (cause < 0 && kind == CM_GUARD_REQUESTS)
		settle(place, &limits);
	return cause < 0 ? got : ended(place, cause);
}

ssize_t cm_guard_recv_chk(int fd, void *data, size_t size, size_t room, int flags)
{
	return cm_guard_recv(fd, data, size < room ? size : room, flags);
}
