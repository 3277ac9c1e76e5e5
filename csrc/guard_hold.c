// SPDX-License-Identifier: Apache-2.0
/*
 * Connections that are not read for a while. libzmq would try again and again, since they stay readable; so they are
 * taken out of what it waits for (epoll_ctl) meanwhile.
 */
#include <errno.h>

#include "guard_private.h"

static uint64_t turn;

/* Let libzmq wait for a connection, or not. */
static void await(struct cm_guard_place *place)
{
	struct epoll_event event = place->event;
	int before = errno;

	if (place->epoll >= 0) {
		if (atomic_load(&place->held))
			event.events &= ~(uint32_t)EPOLLIN;
		epoll_ctl(place->epoll, EPOLL_CTL_MOD, place->peer.fd, &event);
	}
	errno = before;
}

bool cm_guard_stop(struct cm_guard_place *place, uint32_t why)
{
	uint32_t held = atomic_fetch_or(&place->held, why);

	if (!held)
		await(place);
	return !(held & why);
}

bool cm_guard_go_on(struct cm_guard_place *place, uint32_t why)
{
	uint32_t held = atomic_fetch_and(&place->held, ~why);

	if (held && !(held & ~why))
		await(place);
	return held & why;
}

int cm_guard_hold(int fd, int held)
{
	struct cm_guard_place *place = cm_guard_place(fd);
	int result = -1;

	pthread_mutex_lock(&cm_guard_lock);
	if (place && atomic_load(&place->kind)) {
		(held ? cm_guard_stop : cm_guard_go_on)(place, CM_GUARD_HELD_ASKED);
		result = 0;
	}
	pthread_mutex_unlock(&cm_guard_lock);
	if (result)
		errno = ENOENT;
	return result;
}

int cm_guard_cut_slowest(uint32_t kind)
{
	struct cm_guard_place *slowest = NULL, *place;
	int result = -1;

	pthread_mutex_lock(&cm_guard_lock);
	for (int fd = cm_guard_first(); fd >= 0; fd = place->next) {
		place = cm_guard_place(fd);
		if (atomic_load(&place->kind) == kind && place->stuck && !place->ended &&
		    (!slowest || place->stuck < slowest->stuck))
			slowest = place;
	}
	if (slowest) {
		result = slowest->peer.fd;
		slowest->ended = true;
		cm_guard_refuse(&slowest->peer, CM_GUARD_UNREAD);
		shutdown(result, SHUT_RDWR);
	}
	pthread_mutex_unlock(&cm_guard_lock);
	return result;
}

/* libzmq begins or ends to wait for a connection: in the lock, so that the order of this and a hold does not matter. */
int cm_guard_epoll_ctl(int epoll, int op, int fd, struct epoll_event *event)
{
	struct cm_guard_place *place = cm_guard_place(fd);
	struct epoll_event now;
	int result;

	if (!place || !atomic_load(&place->kind))
		return epoll_ctl(epoll, op, fd, event);
	pthread_mutex_lock(&cm_guard_lock);
	place->epoll = op == EPOLL_CTL_DEL ? -1 : epoll;
	if (op != EPOLL_CTL_DEL) {
		if (!(event->events & EPOLLOUT))
			place->stuck = 0;
		else if (!place->stuck)
			place->stuck = ++turn;
		now = place->event = *event;
		if (atomic_load(&place->held))
			now.events &= ~(uint32_t)EPOLLIN;
	}
	result = epoll_ctl(epoll, op, fd, op == EPOLL_CTL_DEL ? event : &now);
	pthread_mutex_unlock(&cm_guard_lock);
	return result;
}
