/* SPDX-License-Identifier: GPL-2.0-only */
/* What the smoke programs share: a check that prints one line, and files of the simulated engine. */
#ifndef _CM_SMOKE_H
#define _CM_SMOKE_H

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

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

#endif /* _CM_SMOKE_H */
