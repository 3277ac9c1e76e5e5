// SPDX-License-Identifier: Apache-2.0
#include "reads.h"

#include <errno.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "client/cm_plane_wire.h"
#include "clock.h"

#define EVENTS_AT_ONCE 16
#define BUCKETS 1024
#define TURN_NS 100000	      /* the shortest that Linux gives */
#define PATIENCE_NS 100000000 /* of cm_reads_offer(), for a read under way */

struct entry {
	struct entry *next;
	struct cm_read read;
	size_t length;
	char name[];
};

struct reader {
	struct reader *next;
	int fd;
	int owner;
};

struct cm_reads {
	pthread_t thread;
	int epoll_fd;
	int wake_fd; /* ends the thread */
	int wanted_fd;
	atomic_bool stopping;
	pthread_mutex_t table_lock; /* held over each load: who withdraws waits for its end */
	bool wanted;		    /* and said so */
	struct entry *table[BUCKETS];
	pthread_mutex_t readers_lock; /* never over a load */
	struct reader *readers;
};

/* ---- the table ---- */

/* FNV-1a, of Fowler, Noll and Vo. */
static uint32_t hash(const char *name, size_t length)
{
	uint32_t sum = 2166136261u;

	for (size_t i = 0; i < length; i++)
		sum = (sum ^ (unsigned char)name[i]) * 16777619u;
	return sum;
}

static struct entry **find(struct cm_reads *reads, const char *name, size_t length)
{
	struct entry **link = &reads->table[hash(name, length) % BUCKETS];

	while (*link && ((*link)->length != length || memcmp((*link)->name, name, length) != 0))
		link = &(*link)->next;
	return link;
}

/* The caller is told once: a table that lacks a name after that does so on purpose. */
static void want(struct cm_reads *reads)
{
	if (reads->wanted)
		return;
	reads->wanted = true;
	(void)!eventfd_write(reads->wanted_fd, 1); /* it fails only where it is readable already */
}

static bool value_of(struct cm_reads *reads, const char *name, size_t length, uint64_t *value)
{
	const struct entry *found;
	bool loaded = false;

	pthread_mutex_lock(&reads->table_lock);
	found = *find(reads, name, length);
	if (found) {
		const struct cm_read *read = &found->read;

		loaded = cm_uio_load(read->uio, read->map, read->offset, read->width, value) > 0;
		*value = (*value & read->mask) >> read->lsb;
	} else {
		want(reads);
	}
	pthread_mutex_unlock(&reads->table_lock);
	return loaded;
}

static int lock_in_time(struct cm_reads *reads)
{
	struct timespec until = cm_clock_timespec(cm_clock_deadline(PATIENCE_NS));

	errno = pthread_mutex_clocklock(&reads->table_lock, CLOCK_MONOTONIC, &until);
	return errno ? -1 : 0;
}

static int put(struct cm_reads *reads, const char *name, size_t length, const struct cm_read *read)
{
	struct entry **link = find(reads, name, length);

	if (!*link) {
		struct entry *made = calloc(1, sizeof(*made) + length);

		if (!made)
			return -1;
		made->length = length;
		memcpy(made->name, name, length);
		*link = made;
	}
	(*link)->read = *read;
	return 0;
}

int cm_reads_offer(struct cm_reads *reads, const char *name, const struct cm_read *read)
{
	size_t length = strlen(name);
	int result;

	if (length > CM_PLANE_NAME_MAX || !read->uio || read->lsb > 63) {
		errno = length > CM_PLANE_NAME_MAX ? ENAMETOOLONG : EINVAL;
		return -1;
	}
	if (lock_in_time(reads))
		return -1;
	result = put(reads, name, length, read);
	pthread_mutex_unlock(&reads->table_lock);
	return result;
}

void cm_reads_withdraw(struct cm_reads *reads)
{
	pthread_mutex_lock(&reads->table_lock);
	for (size_t i = 0; i < BUCKETS; i++) {
		while (reads->table[i]) {
			struct entry *entry = reads->table[i];

			reads->table[i] = entry->next;
			free(entry);
		}
	}
	reads->wanted = false;
	pthread_mutex_unlock(&reads->table_lock);
}

/* ---- clients ---- */

static int answer(const struct reader *reader, const struct cm_plane_descriptor *packet)
{
	return send(reader->fd, packet, sizeof(*packet), MSG_DONTWAIT | MSG_NOSIGNAL) < 0 ? -1 : 0;
}

/* Serve one packet; -1 for a client to hang up on: it has gone, broke the rules, or does not read. */
static int serve(struct cm_reads *reads, const struct reader *reader)
{
	struct {
		struct cm_plane_descriptor head;
		char name[CM_PLANE_NAME_MAX];
	} packet;
	ssize_t got = recv(reader->fd, &packet, sizeof(packet), MSG_DONTWAIT | MSG_TRUNC);
	struct cm_plane_descriptor reply = { .kind = CM_PLANE_ELSEWHERE };
	uint64_t value = 0;

	if (got < 0)
		return errno == EAGAIN || errno == EINTR ? 0 : -1;
	if (got < (ssize_t)sizeof(packet.head) || got > (ssize_t)sizeof(packet) ||
	    packet.head.kind != CM_PLANE_READ)
		return -1;
	reply.sequence = packet.head.sequence;
	if (value_of(reads, packet.name, (size_t)got - sizeof(packet.head), &value)) {
		reply.kind = CM_PLANE_VALUE;
		reply.length = value;
	}
	return answer(reader, &reply);
}

static void drop(struct cm_reads *reads, struct reader *reader)
{
	struct reader **link = &reads->readers;

	pthread_mutex_lock(&reads->readers_lock);
	while (*link != reader)
		link = &(*link)->next;
	*link = reader->next;
	pthread_mutex_unlock(&reads->readers_lock);
	epoll_ctl(reads->epoll_fd, EPOLL_CTL_DEL, reader->fd, NULL); /* there may be a duplicate */
	close(reader->fd);
	free(reader);
}

/*
 * An answer takes some µs, so this thread needs no longer turns: with short ones it gets them at once beside
 * threads that compute (Linux 6.12; before, the request changes nothing).
 */
static void take_short_turns(void)
{
	struct {
		uint32_t size, policy;
		uint64_t flags;
		int32_t nice;
		uint32_t priority;
		uint64_t runtime, deadline, period;
	} wanted = { .size = sizeof(wanted),
		     .runtime = TURN_NS }; /* struct sched_attr, SCHED_OTHER */

	errno = 0;
	wanted.nice = getpriority(PRIO_PROCESS, 0); /* of this thread, on Linux */
	if (!errno)
		(void)!syscall(SYS_sched_setattr, 0, &wanted, 0);
}

/* One packet of each client in turn, however many one of them has sent. */
static void *run(void *argument)
{
	struct cm_reads *reads = argument;
	struct epoll_event events[EVENTS_AT_ONCE];

	take_short_turns();
	while (!atomic_load(&reads->stopping)) {
		int ready = epoll_wait(reads->epoll_fd, events, EVENTS_AT_ONCE, -1);

		for (int i = 0; i < ready; i++) {
			struct reader *reader = events[i].data.ptr;

			if (reader && serve(reads, reader))
				drop(reads, reader);
		}
	}
	return NULL;
}

static int watch(struct cm_reads *reads, int fd, struct reader *reader)
{
	struct epoll_event event = { .events = EPOLLIN, .data.ptr = reader };

	return epoll_ctl(reads->epoll_fd, EPOLL_CTL_ADD, fd, &event);
}

static int check_room(const struct cm_reads *reads, int owner)
{
	unsigned int own = 0, all = 0;

	for (const struct reader *other = reads->readers; other; other = other->next) {
		own += other->owner == owner;
		all++;
	}
	errno = EUSERS;
	return own < CM_READS_EACH && all < CM_READS_MOST ? 0 : -1;
}

static int add(struct cm_reads *reads, struct reader *reader)
{
	struct cm_plane_descriptor greeting = { .kind = CM_PLANE_REGISTERS };

	if (check_room(reads, reader->owner) || answer(reader, &greeting) ||
	    watch(reads, reader->fd, reader))
		return -1;
	reader->next = reads->readers;
	reads->readers = reader;
	return 0;
}

int cm_reads_adopt(struct cm_reads *reads, int fd, int owner)
{
	struct reader *reader = calloc(1, sizeof(*reader));
	int result, error;

	if (!reader)
		return -1;
	*reader = (struct reader){ .fd = fd, .owner = owner };
	/* the thread cannot drop it before it is listed */
	pthread_mutex_lock(&reads->readers_lock);
	result = add(reads, reader);
	error = errno;
	pthread_mutex_unlock(&reads->readers_lock);
	if (result)
		free(reader);
	errno = error;
	return result;
}

int cm_reads_wanted_fd(struct cm_reads *reads)
{
	return reads->wanted_fd;
}

/* ---- life ---- */

/* Signals are for the caller's threads, but for those that an instruction of ours raises: bus.c catches SIGBUS. */
static int start(struct cm_reads *reads)
{
	sigset_t all, before;
	int error;

	sigfillset(&all);
	sigdelset(&all, SIGBUS);
	sigdelset(&all, SIGSEGV);
	pthread_sigmask(SIG_SETMASK, &all, &before);
	error = pthread_create(&reads->thread, NULL, run, reads);
	pthread_sigmask(SIG_SETMASK, &before, NULL);
	errno = error;
	return error ? -1 : 0;
}

static void free_reads(struct cm_reads *reads)
{
	int error = errno;

	while (reads->readers)
		drop(reads, reads->readers);
	cm_reads_withdraw(reads);
	if (reads->epoll_fd >= 0)
		close(reads->epoll_fd);
	if (reads->wake_fd >= 0)
		close(reads->wake_fd);
	if (reads->wanted_fd >= 0)
		close(reads->wanted_fd);
	pthread_mutex_destroy(&reads->table_lock);
	pthread_mutex_destroy(&reads->readers_lock);
	free(reads);
	errno = error;
}

struct cm_reads *cm_reads_new(void)
{
	struct cm_reads *reads = calloc(1, sizeof(*reads));

	if (!reads)
		return NULL;
	pthread_mutex_init(&reads->table_lock, NULL);
	pthread_mutex_init(&reads->readers_lock, NULL);
	reads->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
	reads->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	reads->wanted_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	if (reads->epoll_fd < 0 || reads->wake_fd < 0 || reads->wanted_fd < 0 ||
	    watch(reads, reads->wake_fd, NULL) || start(reads)) {
		free_reads(reads);
		return NULL;
	}
	return reads;
}

void cm_reads_close(struct cm_reads *reads)
{
	if (!reads)
		return;
	atomic_store(&reads->stopping, true);
	if (!eventfd_write(reads->wake_fd, 1))
		pthread_join(reads->thread, NULL);
	free_reads(reads);
}
