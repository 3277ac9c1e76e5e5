// SPDX-License-Identifier: Apache-2.0
#include "path.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>
#include <unistd.h>

char *cm_path_join(const char *root, const char *path)
{
	char *joined;

	if (asprintf(&joined, "%s/%s", root ? root : "", path) < 0) {
		errno = ENOMEM;
		return NULL;
	}
	return joined;
}

int cm_path_open(const char *root, const char *path, int flags)
{
	char *joined = cm_path_join(root, path);
	int fd, error;

	if (!joined)
		return -1;
	do {
		fd = open(joined, flags | O_CLOEXEC);
	} while (fd < 0 && errno == EINTR);
	error = errno;
	free(joined);
	errno = error;
	return fd;
}

int cm_path_reopen(int path_fd, int flags)
{
	char link[32];

	snprintf(link, sizeof(link), "proc/self/fd/%d", path_fd);
	return cm_path_open(NULL, link, flags);
}

static int connect_to(int sock, const struct sockaddr_un *address)
{
	int result;

	do {
		result = connect(sock, (const struct sockaddr *)address, sizeof(*address));
	} while (result && errno == EINTR);
	if (result && errno == ECONNREFUSED)
		errno = ENODEV;
	else if (result && errno == EAGAIN)
		errno = ETIMEDOUT; /* all places in the queue are taken */
	return result;
}

int cm_path_limit(int sock, int timeout_ms)
{
	struct timeval time = { .tv_sec = timeout_ms / 1000, .tv_usec = timeout_ms % 1000 * 1000 };

	return setsockopt(sock, SOL_SOCKET, SO_RCVTIMEO, &time, sizeof(time)) ||
	       setsockopt(sock, SOL_SOCKET, SO_SNDTIMEO, &time, sizeof(time));
}

int cm_path_connect(int path_fd, int timeout_ms)
{
	struct sockaddr_un address = { .sun_family = AF_UNIX };
	int sock = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);

	if (sock < 0)
		return -1;
	snprintf(address.sun_path, sizeof(address.sun_path), "/proc/self/fd/%d", path_fd);
	if ((timeout_ms > 0 && cm_path_limit(sock, timeout_ms)) || connect_to(sock, &address)) {
		int error = errno;

		close(sock);
		errno = error;
		return -1;
	}
	return sock;
}

int cm_path_read_text(const char *root, const char *path, char *text, size_t size)
{
	int fd = cm_path_open(root, path, O_RDONLY);
	ssize_t got;
	int error;

	if (fd < 0)
		return -1;
	do {
		got = read(fd, text, size - 1);
	} while (got < 0 && errno == EINTR);
	error = errno;
	close(fd);
	errno = error;
	if (got < 0)
		return -1;
	text[got] = '\0';
	text[strcspn(text, "\n")] = '\0';
	return 0;
}
