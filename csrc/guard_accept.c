// SPDX-License-Identifier: Apache-2.0
/*
 * How connections are taken. libzmq takes one at a time, with 0.1 ms of work for each; where more come, the kernel's
 * queue fills up, and a new client, whose ZeroMQ does not wait for a place in it, tries again after 0.1 s. So while
 * many wait, connections of peers that connect too often are taken and closed here, one after the other, until there
 * is one for libzmq.
 */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "guard_private.h"

#define MANY 64	     /* connections taken in a row, behind each of which another waited */
#define CROWDED 2000 /* milliseconds for which it counts that so many waited */
#define AT_ONCE 64   /* connections closed before libzmq's thread serves others */

/* No descriptor is left: cm_guard_spare makes room to refuse those that wait, or libzmq would be called for ever. */
static void turn_away(int listener)
{
	struct sockaddr_storage from = { 0 };
	socklen_t size = sizeof(from);
	int fd;

	pthread_mutex_lock(&cm_guard_lock);
	if (cm_guard_spare >= 0)
		close(cm_guard_spare);
	fd = accept4(listener, (struct sockaddr *)&from, &size, SOCK_CLOEXEC | SOCK_NONBLOCK);
	if (fd >= 0) {
		struct cm_guard_peer peer =
			cm_guard_look(fd, cm_guard_place(listener)->listens, &from);

		cm_guard_refuse(&peer, CM_GUARD_DESCRIPTORS);
		close(fd);
	}
	cm_guard_spare = open("/dev/null", O_RDONLY | O_CLOEXEC);
	pthread_mutex_unlock(&cm_guard_lock);
	if (fd < 0)
		nanosleep(&(struct timespec){ .tv_nsec = 1000000 },
			  NULL); /* libzmq will call again at once */
}

static int64_t milliseconds(void)
{
	struct timespec now = { 0 };

	clock_gettime(CLOCK_MONOTONIC_COARSE, &now);
	return (int64_t)(now.tv_sec + 1) * 1000 + now.tv_nsec / 1000000;
}

/* One was taken: whether so many have waited of late that those who connect too often keep others out. */
static bool is_crowded(int listener, struct cm_guard_place *place, int64_t now_ms)
{
	struct pollfd more = { .fd = listener, .events = POLLIN };

	place->in_a_row = poll(&more, 1, 0) > 0 ? place->in_a_row + 1 : 0;
	if (place->in_a_row >= MANY)
		place->crowded_ms = now_ms + CROWDED;
	return now_ms < place->crowded_ms;
}

/* As accept() tells the caller who connected. */
static void tell(const struct sockaddr_storage *from, socklen_t size, struct sockaddr *address,
		 socklen_t *length)
{
	if (!address || !length)
		return;
	memcpy(address, from, *length < size ? *length : size);
	*length = size;
}

/* The next one that may stay; -1: none, with the errno of accept4(), or ECONNABORTED after some that may not. */
static int next(int listener, struct cm_guard_place *place, struct sockaddr *address,
		socklen_t *length, int flags)
{
	for (int refused = 0; refused < AT_ONCE; refused++) {
		struct sockaddr_storage from = { 0 };
		socklen_t size = sizeof(from);
		int fd = accept4(listener, (struct sockaddr *)&from, &size, flags);
		int64_t now_ms = milliseconds();
		struct cm_guard_peer peer;

		if (fd < 0)
			return -1;
		peer = cm_guard_look(fd, place->listens, &from);
		if (cm_guard_admit(&peer, now_ms, is_crowded(listener, place, now_ms))) {
			tell(&from, size, address, length);
			return fd;
		}
		close(fd);
	}
	errno = ECONNABORTED;
	return -1;
}

int cm_guard_accept4(int listener, struct sockaddr *address, socklen_t *length, int flags)
{
	struct cm_guard_place *place = cm_guard_place(listener);
	int fd;

	if (!place || !place->listens)
		return accept4(listener, address, length, flags);
	fd = next(listener, place, address, length, flags);
	if (fd >= 0 || (errno != EMFILE && errno != ENFILE))
		return fd;
	turn_away(listener);
	errno = ECONNABORTED; /* which libzmq ignores */
	return -1;
}

int cm_guard_accept(int listener, struct sockaddr *address, socklen_t *length)
{
	return cm_guard_accept4(listener, address, length, 0);
}

/* Not blocking, since more is taken than libzmq was told of. */
int cm_guard_listen(int fd, int backlog)
{
	struct cm_guard_place *place = cm_guard_place(fd);
	int result = listen(fd, backlog);

	if (result || !place || !cm_guard_expected)
		return result;
	place->listens = cm_guard_expected;
	place->in_a_row = 0;
	place->crowded_ms = 0;
	return fcntl(fd, F_SETFL, fcntl(fd, F_GETFL) | O_NONBLOCK);
}
