// SPDX-License-Identifier: Apache-2.0
/*
 * copies SIZE: the floor for a frame of SIZE bytes that is moved once each way.
 *
 * Two processes share memory and two eventfds. One rings; the other copies the
 * frame out of its slot and into the slot of the way back, and rings in turn.
 * For each line with a number on standard input, so many round trips are made
 * and their durations printed, in nanoseconds, one on each line.
 */
#define _GNU_SOURCE
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

struct ends {
	unsigned char *there, *back; /* shared slots */
	int bell_there, bell_back;
	size_t size;
};

static void fail(const char *what)
{
	perror(what);
	exit(1);
}

static void ring(int fd)
{
	uint64_t one = 1;

	if (write(fd, &one, sizeof(one)) != sizeof(one))
		fail("eventfd write");
}

static void await(int fd)
{
	uint64_t count;

	if (read(fd, &count, sizeof(count)) != sizeof(count))
		fail("eventfd read");
}

static void set_up(struct ends *e)
{
	unsigned char *all = mmap(NULL, 2 * e->size, PROT_READ | PROT_WRITE,
				  MAP_SHARED | MAP_ANONYMOUS | MAP_POPULATE, -1, 0);

	e->bell_there = eventfd(0, EFD_CLOEXEC);
	e->bell_back = eventfd(0, EFD_CLOEXEC);
	if (all == MAP_FAILED || e->bell_there < 0 || e->bell_back < 0)
		fail("copies");
	e->there = all;
	e->back = all + e->size;
	memset(all, 0x5a, 2 * e->size);
}

static void far_end(const struct ends *e)
{
	unsigned char *own = malloc(e->size);

	prctl(PR_SET_PDEATHSIG, SIGKILL);
	if (!own)
		fail("malloc");
	memset(own, 0, e->size);
	for (;;) {
		await(e->bell_there);
		memcpy(own, e->there, e->size);
		memcpy(e->back, own, e->size);
		ring(e->bell_back);
	}
}

static int64_t now(void)
{
	struct timespec t;

	clock_gettime(CLOCK_MONOTONIC, &t);
	return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static void trips(const struct ends *e, long left)
{
	while (left-- > 0) {
		int64_t before = now();

		ring(e->bell_there);
		await(e->bell_back);
		printf("%lld\n", (long long)(now() - before));
	}
	fflush(stdout);
}

int main(int argc, char **argv)
{
	struct ends e = { .size = argc == 2 ? strtoul(argv[1], NULL, 10) : 0 };
	char line[32];
	pid_t child;

	if (!e.size) {
		fprintf(stderr, "usage: copies SIZE\n");
		return 2;
	}
	set_up(&e);
	child = fork();
	if (child < 0)
		fail("fork");
	if (!child)
		far_end(&e);
	while (fgets(line, sizeof(line), stdin))
		trips(&e, atol(line));
	kill(child, SIGKILL);
	return 0;
}
