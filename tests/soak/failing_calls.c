// SPDX-License-Identifier: Apache-2.0
// Fails one of the calls by which a process writes below a folder, or all from there on; for LD_PRELOAD.
//
// FAIL_BELOW: the folder. FAIL_AT: the number of the call, from 1 (0: none). FAIL_LASTING: set for all from there on.
// FAIL_ERRNO: its error (0: the process is killed before it). FAIL_LOG: a file that gets a line for each call that counts.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

static atomic_int calls;

static long (*real_syscall)(long, ...);

static int fails(const char *name, const char *path)
{
	const char *below = getenv("FAIL_BELOW"), *at = getenv("FAIL_AT"),
		   *log = getenv("FAIL_LOG");

	if (!below || !at || strncmp(path, below, strlen(below)))
		return 0;
	int number = atomic_fetch_add(&calls, 1) + 1, wanted = atoi(at);
	int failing = wanted && (number == wanted || (number > wanted && getenv("FAIL_LASTING")));
	char line[600];
	int length = snprintf(line, sizeof(line), "%d %s %s%s\n", number, name,
			      path + strlen(below), failing ? " fails" : "");
	int fd = log ? open(log, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600) : -1;
	if (fd >= 0) {
		real_syscall(SYS_write, fd, line, (long)length);
		close(fd);
	}
	if (failing && !(errno = atoi(getenv("FAIL_ERRNO"))))
		kill(getpid(), SIGKILL);
	return failing;
}

static int fails_at(const char *name, int folder, const char *path)
{
	char link[64], place[PATH_MAX * 2];

	if (path[0] == '/')
		return fails(name, path);
	snprintf(link, sizeof(link), folder == AT_FDCWD ? "/proc/self/cwd" : "/proc/self/fd/%d",
		 folder);
	ssize_t length = readlink(link, place, PATH_MAX);
	if (length < 0)
		return 0;
	snprintf(place + length, sizeof(place) - (size_t)length, "/%s", path);
	return fails(name, place);
}

static int fails_on(const char *name, int fd)
{
	char link[64], path[PATH_MAX];

	snprintf(link, sizeof(link), "/proc/self/fd/%d", fd);
	ssize_t length = readlink(link, path, sizeof(path) - 1);
	if (length < 0)
		return 0;
	path[length] = 0;
	return fails(name, path);
}

__attribute__((constructor)) static void begin(void)
{
	real_syscall = dlsym(RTLD_NEXT, "syscall");
}

#define CALL(type, name, parameters, failing, arguments)      \
	type name parameters                                  \
	{                                                     \
		static type(*real) parameters;                \
		if (!real)                                    \
			real = dlsym(RTLD_NEXT, #name);       \
		return failing ? (type) - 1 : real arguments; \
	}

CALL(ssize_t, write, (int fd, const void *data, size_t length), fails_on("write", fd),
     (fd, data, length))
CALL(ssize_t, pwrite, (int fd, const void *data, size_t length, off_t at), fails_on("pwrite", fd),
     (fd, data, length, at))
CALL(ssize_t, pwrite64, (int fd, const void *data, size_t length, off64_t at),
     fails_on("pwrite", fd), (fd, data, length, at))
CALL(int, fsync, (int fd), fails_on("fsync", fd), (fd))
CALL(int, fdatasync, (int fd), fails_on("fsync", fd), (fd))
CALL(int, ftruncate, (int fd, off_t length), fails_on("ftruncate", fd), (fd, length))
CALL(int, ftruncate64, (int fd, off64_t length), fails_on("ftruncate", fd), (fd, length))
CALL(int, rename, (const char *from, const char *to), fails_at("rename", AT_FDCWD, to), (from, to))
CALL(int, unlink, (const char *path), fails_at("unlink", AT_FDCWD, path), (path))
CALL(int, unlinkat, (int folder, const char *path, int flags), fails_at("unlink", folder, path),
     (folder, path, flags))
CALL(int, renameat, (int a, const char *from, int b, const char *to), fails_at("rename", b, to),
     (a, from, b, to))

long syscall(long number, ...)
{
	long a[6];
	va_list rest;

	va_start(rest, number);
	for (int i = 0; i < 6; i++)
		a[i] = va_arg(rest, long);
	va_end(rest);
	if (number == SYS_renameat2 && fails_at("rename", (int)a[2], (const char *)a[3]))
		return -1;
	return real_syscall(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}
