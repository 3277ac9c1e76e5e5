// SPDX-License-Identifier: Apache-2.0
/* The data plane's thread, and the calls that other threads may make. */
#include "plane.h"

#include <errno.h>
#include <limits.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include "plane_private.h"

#define EVENTS_AT_ONCE 16
#define YIELDS_AT_ONCE 50
#define PACKETS_AT_ONCE \
	(2 *            \
	 CM_PLANE_SLOTS_MAX) /* packets of one client at once: it may send faster than they are handled */

void plane_report(struct cm_plane *plane, uint32_t kind, int id, int error)
{
	struct event *event = calloc(1, sizeof(*event));
	uint64_t one = 1;

	if (!event)
		return;
	event->event = (struct cm_plane_event){ .kind = kind, .id = id, .error = error };
	*plane->events_end = event;
	plane->events_end = &event->next;
	if (write(plane->event_fd, &one, sizeof(one)) < 0)
		return; /* full: it is readable */
}

/* Ids of streams and clients that have gone are not found. */
static void dispatch(struct cm_plane *plane, int id)
{
	struct client *client = client_find(plane, id);
	struct stream *stream = client ? NULL : stream_find(plane, id);

	if (client)
		client_readable(plane, client);
	else if (stream && !stream->lost && !stream->ending)
		stream_completed(plane, stream);
}

/*
 * A mutex is not fair: where frames come without a pause, the thread would take it again before
 * anybody whom its release wakes.  So callers announce that they wait, and the thread yields to them.
 */
static void lock(struct cm_plane *plane)
{
	atomic_fetch_add(&plane->callers, 1);
	pthread_mutex_lock(&plane->lock);
	atomic_fetch_sub(&plane->callers, 1);
}

static void let_callers_in(struct cm_plane *plane)
{
	for (int i = 0; i < YIELDS_AT_ONCE && atomic_load(&plane->callers); i++)
		sched_yield();
}

static void *run(void *argument)
{
	struct cm_plane *plane = argument;
	struct epoll_event events[EVENTS_AT_ONCE];
	bool stopping = false;

	while (!stopping) {
		int ready = epoll_wait(plane->epoll_fd, events, EVENTS_AT_ONCE, -1);

		let_callers_in(plane);
		pthread_mutex_lock(&plane->lock);
		for (int i = 0; i < ready; i++)
			dispatch(plane, (int)events[i].data.u64);
		clients_reap(plane);
		stopping = plane->stopping;
		pthread_mutex_unlock(&plane->lock);
	}
	return NULL;
}

static int watch(struct cm_plane *plane, int fd, int id)
{
	struct epoll_event event = { .events = EPOLLIN, .data.u64 = (uint64_t)id };

	return epoll_ctl(plane->epoll_fd, EPOLL_CTL_ADD, fd, &event);
}

static void free_plane(struct cm_plane *plane)
{
	if (plane->epoll_fd >= 0)
		close(plane->epoll_fd);
	if (plane->wake_fd >= 0)
		close(plane->wake_fd);
	if (plane->event_fd >= 0)
		close(plane->event_fd);
	free(plane);
}

/* Signals are for the caller's threads. */
int plane_thread(pthread_t *thread, void *(*start)(void *), void *argument)
{
	sigset_t all, before;
	int error;

	sigfillset(&all);
	pthread_sigmask(SIG_SETMASK, &all, &before);
	error = pthread_create(thread, NULL, start, argument);
	pthread_sigmask(SIG_SETMASK, &before, NULL);
	errno = error;
	return error ? -1 : 0;
}

struct cm_plane *cm_plane_new(void)
{
	struct cm_plane *plane = calloc(1, sizeof(*plane));

	if (!plane)
		return NULL;
	pthread_mutex_init(&plane->lock, NULL);
	pthread_mutex_init(&plane->generations.lock, NULL);
	plane->events_end = &plane->events;
	plane->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
	plane->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	plane->event_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	if (plane->epoll_fd < 0 || plane->wake_fd < 0 || plane->event_fd < 0 ||
	    watch(plane, plane->wake_fd, 0) || plane_thread(&plane->thread, run, plane)) {
		int error = errno;

		free_plane(plane);
		errno = error;
		return NULL;
	}
	return plane;
}

void cm_plane_close(struct cm_plane *plane)
{
	struct cm_plane_event event;
	uint64_t one = 1;

	if (!plane)
		return;
	lock(plane);
	plane->stopping = true;
	pthread_mutex_unlock(&plane->lock);
	if (write(plane->wake_fd, &one, sizeof(one)) == sizeof(one))
		pthread_join(plane->thread, NULL);
	while (plane->streams) {
		stream_stop_queueing(plane->streams);
		stream_cancel(plane->streams);
		stream_end(plane, plane->streams, 0);
	}
	for (struct client *client = plane->clients; client; client = client->next)
		client->broken = true;
	clients_reap(plane);
	while (cm_plane_take(plane, &event))
		;
	pthread_mutex_destroy(&plane->lock);
	pthread_mutex_destroy(&plane->generations.lock);
	free_plane(plane);
}

int cm_plane_event_fd(struct cm_plane *plane)
{
	return plane->event_fd;
}

int cm_plane_take(struct cm_plane *plane, struct cm_plane_event *event)
{
	struct event *first;
	uint64_t count;

	lock(plane);
	first = plane->events;
	if (first) {
		*event = first->event;
		plane->events = first->next;
		if (!plane->events)
			plane->events_end = &plane->events;
	} else if (read(plane->event_fd, &count, sizeof(count)) < 0) {
		/* it was not readable either */
	}
	pthread_mutex_unlock(&plane->lock);
	free(first);
	return first != NULL;
}

/* Numbers begin anew after 2^31, with those that are not in use. */
static int new_id(struct cm_plane *plane)
{
	int id = plane->last_id;

	do
		id = id == INT_MAX ? 1 : id + 1;
	while (client_find(plane, id) || stream_find(plane, id));
	return id;
}

static struct stream *new_stream(struct cm_plane *plane, struct cm_dma *dma,
				 const struct cm_plane_setup *setup)
{
	struct stream *stream = calloc(1, sizeof(*stream));

	if (!stream)
		return NULL;
	stream->plane = plane;
	stream->id = plane->last_id = new_id(plane);
	stream->epoch = ++plane->last_epoch;
	stream->dma = dma;
	stream->setup = *setup;
	stream->slots = setup->lent;
	stream->cycling = -1;
	stream->event_fd = dma ? cm_dma_event_fd(dma) : -1;
	if (dma && (stream->event_fd < 0 || watch(plane, stream->event_fd, stream->id))) {
		free(stream);
		return NULL;
	}
	stream->next = plane->streams;
	plane->streams = stream;
	return stream;
}

int cm_plane_start(struct cm_plane *plane, struct cm_dma *dma, const struct cm_plane_setup *setup)
{
	struct stream *stream;
	int id;

	lock(plane);
	stream = new_stream(plane, dma, setup);
	id = stream ? stream->id : -1;
	pthread_mutex_unlock(&plane->lock);
	return id;
}

static int add_slot(struct cm_plane *plane, struct stream *stream, int fd, uint32_t handle)
{
	uint32_t number = stream->slots;

	if (number == CM_PLANE_SLOTS_MAX) {
		errno = ENOSPC;
		return -1;
	}
	stream->slot[number] = (struct slot){ .fd = fd, .handle = handle };
	stream->slots++;
	for (struct client *client = plane->clients; client; client = client->next)
		if (client->stream == stream)
			client_send_slots(client, stream, number);
	if (!stream->setup.write)
		stream_queue(plane, stream, number);
	return (int)number;
}

/* A stream that is about to end takes no more clients. */
static struct stream *find_live(struct cm_plane *plane, int id)
{
	struct stream *stream = stream_find(plane, id);

	if (!stream || !stream->ending)
		return stream;
	errno = ENOENT;
	return NULL;
}

int cm_plane_add_slot(struct cm_plane *plane, int id, int fd, uint32_t handle)
{
	struct stream *stream;
	int result = -1;

	lock(plane);
	stream = find_live(plane, id);
	if (stream)
		result = add_slot(plane, stream, fd, handle);
	clients_reap(plane);
	pthread_mutex_unlock(&plane->lock);
	return result;
}

int cm_plane_stop(struct cm_plane *plane, int id, int error)
{
	struct stream *stream;

	lock(plane);
	stream = find_live(plane, id);
	if (stream)
		stream_stop_queueing(stream);
	pthread_mutex_unlock(&plane->lock);
	if (!stream)
		return -1;
	/* without the lock: a driver may need seconds, and the other streams go on */
	stream_cancel(stream);
	lock(plane);
	stream_end(plane, stream, error);
	clients_reap(plane);
	pthread_mutex_unlock(&plane->lock);
	return 0;
}

int cm_plane_adopt(struct cm_plane *plane, int fd)
{
	struct client *client = calloc(1, sizeof(*client));
	struct ucred peer = { .uid = (uid_t)-1 };
	socklen_t size = sizeof(peer);
	int id = -1;

	if (!client)
		return -1;
	getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &size);
	client->user = peer.uid;
	lock(plane);
	client->fd = fd;
	client->id = new_id(plane);
	if (!watch(plane, fd, client->id)) {
		id = plane->last_id = client->id;
		client->next = plane->clients;
		plane->clients = client;
	}
	pthread_mutex_unlock(&plane->lock);
	if (id < 0)
		free(client);
	return id;
}

static uint32_t free_slots(const struct stream *stream)
{
	uint32_t count = 0;

	for (uint32_t i = 0; i < stream->slots; i++)
		count += !stream->slot[i].owner && !stream->slot[i].queued;
	return count;
}

static void grant(struct client *client, struct stream *stream)
{
	uint32_t left = client->depth;

	for (uint32_t i = 0; i < stream->slots && left; i++) {
		struct slot *slot = &stream->slot[i];

		if (slot->owner || slot->queued)
			continue;
		slot->owner = client;
		client_grant(client, stream, slot);
		left--;
	}
}

static int attach(struct client *client, struct stream *stream, uint32_t depth, const void *packet,
		  size_t size)
{
	union {
		struct cm_plane_descriptor head;
		char bytes[CM_PLANE_PACKET_MAX];
	} geometry;

	if (size < sizeof(geometry.head) || size > sizeof(geometry)) {
		errno = EINVAL;
		return -1;
	}
	if (stream->setup.write && free_slots(stream) < depth) {
		errno = EAGAIN;
		return -1;
	}
	memcpy(geometry.bytes, packet, size);
	geometry.head.flags = stream->epoch;
	client->depth = depth;
	client->stream = stream;
	client->frames = 0;
	client->dropped = 0;
	client->generation = 0;
	client->failed = 0;
	if (client_send(client, geometry.bytes, size) || client_send_slots(client, stream, 0))
		return 0; /* the thread disconnects it, and reports that */
	if (stream->setup.write)
		grant(client, stream);
	return 0;
}

int cm_plane_attach(struct cm_plane *plane, int client_id, int stream_id, uint32_t depth,
		    const void *packet, size_t size)
{
	struct client *client;
	struct stream *stream;
	int result = -1;

	lock(plane);
	client = client_find(plane, client_id);
	stream = find_live(plane, stream_id);
	if (client && stream && !client->stream)
		result = attach(client, stream, depth, packet, size);
	else if (client && stream)
		errno = EISCONN;
	clients_reap(plane);
	pthread_mutex_unlock(&plane->lock);
	return result;
}

int cm_plane_tell(struct cm_plane *plane, int id, const void *packet, size_t size)
{
	struct stream *stream;

	lock(plane);
	stream = stream_find(plane, id);
	for (struct client *client = plane->clients; stream && client; client = client->next)
		if (client->stream == stream)
			client_send(client, packet, size);
	clients_reap(plane);
	pthread_mutex_unlock(&plane->lock);
	return stream ? 0 : -1;
}

void cm_plane_settle(struct cm_plane *plane)
{
	lock(plane);
	for (struct client *client = plane->clients; client; client = client->next)
		for (int i = 0; i < PACKETS_AT_ONCE && client_readable(plane, client); i++)
			;
	clients_reap(plane);
	pthread_mutex_unlock(&plane->lock);
}

int cm_plane_drop(struct cm_plane *plane, int id)
{
	struct client *client;

	lock(plane);
	client = client_find(plane, id);
	if (client)
		client->broken = true;
	clients_reap(plane);
	pthread_mutex_unlock(&plane->lock);
	return client ? 0 : -1;
}

static void fill(const struct stream *stream, struct cm_plane_stats *stats)
{
	*stats = stream->stats;
	stats->queued = stream->under_way + (stream->cycling >= 0);
	stats->count =
		stream->recent < CM_PLANE_RECENT ? (uint32_t)stream->recent : CM_PLANE_RECENT;
	for (uint32_t i = 0; i < stream->slots; i++)
		stats->held += stream->slot[i].holders > 0 || stream->slot[i].owner;
	for (uint32_t i = 0; i < stats->count; i++) {
		uint64_t place = (stream->recent - stats->count + i) % CM_PLANE_RECENT;

		stats->at_ns[i] = stream->stats.at_ns[place];
		stats->latency_ns[i] = stream->stats.latency_ns[place];
	}
}

int cm_plane_get_stats(struct cm_plane *plane, int id, struct cm_plane_stats *stats)
{
	struct stream *stream;

	lock(plane);
	stream = stream_find(plane, id);
	if (stream)
		fill(stream, stats);
	pthread_mutex_unlock(&plane->lock);
	return stream ? 0 : -1;
}

static uint32_t under_way(const struct client *client)
{
	const struct stream *stream = client->stream;
	uint32_t count = client->held_count;

	for (uint32_t i = 0; stream && i < stream->slots; i++)
		count += stream->slot[i].owner == client && stream->slot[i].queued;
	return count;
}

int cm_plane_get_client_stats(struct cm_plane *plane, int id, struct cm_plane_client_stats *stats)
{
	const struct client *client;

	lock(plane);
	client = client_find(plane, id);
	if (client)
		*stats = (struct cm_plane_client_stats){
			.frames = client->frames,
			.dropped = client->dropped,
			.depth = client->depth,
			.held = under_way(client),
		};
	pthread_mutex_unlock(&plane->lock);
	return client ? 0 : -1;
}
