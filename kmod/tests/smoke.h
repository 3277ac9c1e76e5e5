/* SPDX-License-Identifier: GPL-2.0-only */
/* What the smoke programs share: a check that prints one line, and files of the simulated engine. */
#ifndef _CM_SMOKE_H
#define _CM_SMOKE_H

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "cm_buffer.h"

static int failures;
static const char *engine; /* its folder in debugfs */

/* errno is 0 before the condition, so that it may be part of it */
#define CHECK(condition)                                                                           \
	do {                                                                                       \
		errno = 0;                                                                         \
		int ok_ = !!(condition);                                                           \
                                                                                                   \
		printf("%s %d: %s (errno %d)\n", ok_ ? "ok" : "FAIL", __LINE__, #condition,        \
		       errno);                                                                     \
		failures += !ok_;                                                                  \
	} while (0)

/* open a file of a channel of the engine; ends the program where there is none */
static inline int engine_file(const char *channel, const char *name, int flags)
{
	char path[256];
	int fd;

	snprintf(path, sizeof(path), "%s/%s/%s", engine, channel, name);
	fd = open(path, flags);
	if (fd < 0) {
		perror(path);
		exit(1);
	}
	return fd;
}

/* set a fault, or what else can be set, in debugfs */
static inline void fault(const char *channel, const char *name, unsigned int value)
{
	int fd = engine_file(channel, name, O_WRONLY);

	if (dprintf(fd, "%u", value) < 0) {
		perror(name);
		exit(1);
	}
	close(fd);
}

/* a number in debugfs */
static inline unsigned long long counter(const char *channel, const char *name)
{
	int fd = engine_file(channel, name, O_RDONLY);
	char text[32] = "";

	if (read(fd, text, sizeof(text) - 1) < 0) {
		perror(name);
		exit(1);
	}
	close(fd);
	return strtoull(text, NULL, 0);
}

#define STRUCTURE_MAX 128

/* an ioctl with a structure of so many bytes; what lies behind them must stay as it was */
static inline int call_sized(int fd, unsigned int number, void *args, __u32 size)
{
	unsigned char room[STRUCTURE_MAX];
	int ret, i;

	memset(room, 0xA5, sizeof(room));
	memcpy(room, args, size);
	memcpy(room, &size, sizeof(size));
	ret = ioctl(fd, _IOC(_IOC_READ | _IOC_WRITE, CM_IOC_MAGIC, number, size), room);
	for (i = size; i < STRUCTURE_MAX; i++) {
		if (room[i] != 0xA5) {
			printf("FAIL call 0x%x of %u bytes wrote byte %d\n", number, size, i);
			failures++;
		}
	}
	memcpy(args, room, size);
	return ret;
}

/*
 * Every size that a structure has had: each is taken, a shorter one is not, and a longer
 * one where it is zero beyond ours.  "prepare" fills in what the call is to succeed with,
 * "undo" takes back what it did; @sizes ends with 0.
 */
static inline void check_sizes(int fd, unsigned int number, const __u32 *sizes,
			       void (*prepare)(int fd, void *args), void (*undo)(int fd, void *args))
{
	unsigned char args[STRUCTURE_MAX];
	__u32 now = 0;

	for (; *sizes; sizes++) {
		if (!now) {
			memset(args, 0, sizeof(args));
			prepare(fd, args);
			CHECK(call_sized(fd, number, args, *sizes - 4) == -1 && errno == EINVAL);
			undo(fd, args);
		}
		now = *sizes;
		memset(args, 0, sizeof(args));
		prepare(fd, args);
		printf("call 0x%x of %u bytes\n", number, now);
		CHECK(call_sized(fd, number, args, now) == 0);
		undo(fd, args);
	}
	memset(args, 0, sizeof(args));
	prepare(fd, args);
	args[now + 4] = 1;
	CHECK(call_sized(fd, number, args, now + 8) == -1 && errno == E2BIG);
	args[now + 4] = 0;
	CHECK(call_sized(fd, number, args, now + 8) == 0);
	undo(fd, args);
}

static inline void nothing(int fd, void *args)
{
}

/* the calls that cm_dma and cm_icap share; @first is the number of INFO */
static __u32 made; /* handle */
static unsigned int first_call;

static inline void make_buffer(int fd, struct cm_buffer_alloc *args)
{
	*args = (struct cm_buffer_alloc){ .size = sizeof(*args), .length = 4096 };
	if (ioctl(fd, _IOWR(CM_IOC_MAGIC, first_call + 1, struct cm_buffer_alloc), args)) {
		perror("ALLOC");
		exit(1);
	}
	made = args->handle;
}

static inline void free_buffer(int fd, __u32 handle)
{
	struct cm_buffer_free args = { .size = sizeof(args), .handle = handle };

	if (handle && ioctl(fd, _IOW(CM_IOC_MAGIC, first_call + 3, struct cm_buffer_free), &args))
		perror("FREE");
}

static inline void prepare_alloc(int fd, void *args)
{
	((struct cm_buffer_alloc *)args)->length = 4096;
}

static inline void undo_alloc(int fd, void *args)
{
	struct cm_buffer_alloc *alloc = args;

	if (alloc->handle)
		close(alloc->fd);
	free_buffer(fd, alloc->handle);
}

static inline void prepare_import(int fd, void *args)
{
	struct cm_buffer_alloc alloc;

	make_buffer(fd, &alloc);
	((struct cm_buffer_import *)args)->fd = alloc.fd;
}

static inline void undo_import(int fd, void *args)
{
	struct cm_buffer_import *import = args;

	free_buffer(fd, import->handle);
	close(import->fd);
	free_buffer(fd, made);
}

static inline void prepare_free(int fd, void *args)
{
	struct cm_buffer_alloc alloc;

	make_buffer(fd, &alloc);
	close(alloc.fd);
	((struct cm_buffer_free *)args)->handle = alloc.handle;
}

/* what was refused has not freed it */
static inline void undo_free(int fd, void *args)
{
	struct cm_buffer_free again = { .size = sizeof(again), .handle = made };

	ioctl(fd, _IOW(CM_IOC_MAGIC, first_call + 3, struct cm_buffer_free), &again);
}

static inline void check_buffer_sizes(int fd, unsigned int first)
{
	static const __u32 alloc[] = { CM_BUFFER_ALLOC_SIZE_VER0, CM_BUFFER_ALLOC_SIZE_VER1, 0 };
	static const __u32 import[] = { CM_BUFFER_IMPORT_SIZE_VER0, 0 };
	static const __u32 give[] = { CM_BUFFER_FREE_SIZE_VER0, 0 };

	_Static_assert(sizeof(struct cm_buffer_alloc) == CM_BUFFER_ALLOC_SIZE_VER1, "alloc");
	_Static_assert(sizeof(struct cm_buffer_import) == CM_BUFFER_IMPORT_SIZE_VER0, "import");
	_Static_assert(sizeof(struct cm_buffer_free) == CM_BUFFER_FREE_SIZE_VER0, "free");
	first_call = first;
	check_sizes(fd, first + 1, alloc, prepare_alloc, undo_alloc);
	check_sizes(fd, first + 2, import, prepare_import, undo_import);
	check_sizes(fd, first + 3, give, prepare_free, undo_free);
}

#endif /* _CM_SMOKE_H */
