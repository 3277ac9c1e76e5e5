/* SPDX-License-Identifier: Apache-2.0 */
/* The smallest thing that finds tests, runs them and says what failed where. */
#ifndef CM_TEST_H
#define CM_TEST_H

#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define CHECK(condition)                                                                      \
	do {                                                                                  \
		if (!(condition)) {                                                           \
			fprintf(stderr, "%s:%d: %s: not true: %s (errno %d, %s)\n", __FILE__, \
				__LINE__, __func__, #condition, errno, strerror(errno));      \
			abort();                                                              \
		}                                                                             \
	} while (0)

/* @call fails with this errno. */
#define CHECK_ERRNO(call, expected)         \
	do {                                \
		errno = 0;                  \
		CHECK((call) < 0);          \
		CHECK(errno == (expected)); \
	} while (0)

/* @call returns NULL with this errno. */
#define CHECK_NULL_ERRNO(call, expected)    \
	do {                                \
		errno = 0;                  \
		CHECK((call) == NULL);      \
		CHECK(errno == (expected)); \
	} while (0)

/* A test that hangs ends its process. */
#define TEST_SECONDS 300

#define RUN(test)                                    \
	do {                                         \
		int before = open_descriptors();     \
                                                     \
		test();                              \
		CHECK(open_descriptors() == before); \
		printf("ok %s\n", #test);            \
	} while (0)

/* Descriptors of this process; each test leaves as many as it found. */
static inline int open_descriptors(void)
{
	DIR *dir = opendir("/proc/self/fd");
	int count = 0;

	CHECK(dir);
	while (readdir(dir))
		count++;
	closedir(dir);
	return count;
}

#endif /* CM_TEST_H */
