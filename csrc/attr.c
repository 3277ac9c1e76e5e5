// SPDX-License-Identifier: Apache-2.0
#include "attr.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/inotify.h>
#include <sys/stat.h>
#include <unistd.h>

#include "cm_node.h"
#include "message.h"
#include "path.h"

static void close_keeping_errno(int fd)
{
	int error = errno;

	close(fd);
	errno = error;
}

/* Connect to a simulated attribute and learn whether it opens. */
static int connect_attr(int path_fd)
{
	int sock = cm_path_connect(path_fd, 0), event_fd = -1;
	uint32_t offers;

	if (sock < 0)
		return -1;
	if (cm_message_greeting(sock, &event_fd, &offers)) {
		close_keeping_errno(sock);
		return -1;
	}
	if (event_fd >= 0)
		close(event_fd); /* an attribute has no events */
	return sock;
}

/* Make one request on a new connection; return the length of the reply, or -1. */
static ssize_t ask(int path_fd, uint32_t op, const void *data, size_t length, void *reply,
		   size_t room)
{
	int sock = connect_attr(path_fd), broken;
	ssize_t got = -1;

	if (sock < 0)
		return -1;
	if (!cm_message_send(sock, op, data, length, -1))
		got = cm_message_receive(sock, op, reply, room, NULL, &broken);
	close_keeping_errno(sock);
	return got;
}

static bool is_socket(int path_fd)
{
	struct stat st;

	return !fstat(path_fd, &st) && S_ISSOCK(st.st_mode);
}

static ssize_t read_all(int fd, char *data, size_t size)
{
	size_t done = 0;
	char more;

	while (done <= size) {
		bool full = done == size;
		ssize_t got = read(fd, full ? &more : data + done, full ? 1 : size - done);

		if (got < 0 && errno == EINTR)
			continue;
		if (got < 0)
			return -1;
		if (got == 0)
			return (ssize_t)done;
		done += (size_t)got;
	}
	errno = EMSGSIZE;
	return -1;
}

static int write_all(int fd, const char *data, size_t size)
{
	size_t done = 0;

	do {
		ssize_t put = write(fd, data + done, size - done);

		if (put < 0 && errno == EINTR)
			continue;
		if (put < 0)
			return -1;
		done += (size_t)put;
	} while (done < size);
	return 0;
}

static ssize_t read_file(int path_fd, void *data, size_t size)
{
	int fd = cm_path_reopen(path_fd, O_RDONLY);
	ssize_t got;

	if (fd < 0)
		return -1;
	got = read_all(fd, data, size);
	close_keeping_errno(fd);
	return got;
}

static int write_file(int path_fd, const void *data, size_t size)
{
	int fd = cm_path_reopen(path_fd, O_WRONLY);

	if (fd < 0)
		return -1;
	if (write_all(fd, data, size)) {
		close_keeping_errno(fd);
		return -1;
	}
	/* On Linux the descriptor is closed even if close() fails with EINTR. */
	return close(fd) && errno != EINTR ? -1 : 0;
}

static ssize_t read_socket(int path_fd, void *data, size_t size)
{
	char *text = malloc(CM_NODE_PAYLOAD_MAX);
	ssize_t got;

	if (!text)
		return -1;
	got = ask(path_fd, CM_NODE_OP_ATTR_READ, NULL, 0, text, CM_NODE_PAYLOAD_MAX);
	if (got > (ssize_t)size) {
		errno = EMSGSIZE;
		got = -1;
	} else if (got > 0) {
		memcpy(data, text, (size_t)got);
	}
	free(text);
	return got;
}

ssize_t cm_attr_read(const char *root, const char *path, void *data, size_t size)
{
	int path_fd = cm_path_open(root, path, O_PATH);
	ssize_t got;

	if (path_fd < 0)
		return -1;
	got = is_socket(path_fd) ? read_socket(path_fd, data, size)
				 : read_file(path_fd, data, size);
	close_keeping_errno(path_fd);
	return got;
}

int cm_attr_write(const char *root, const char *path, const void *data, size_t size)
{
	int path_fd = cm_path_open(root, path, O_PATH);
	ssize_t result;

	if (path_fd < 0)
		return -1;
	result = is_socket(path_fd) ? ask(path_fd, CM_NODE_OP_ATTR_WRITE, data, size, NULL, 0)
				    : write_file(path_fd, data, size);
	close_keeping_errno(path_fd);
	return result < 0 ? -1 : 0;
}

/* The ".node" of @folder_fd, or -1 if the folder is a real one. */
static int open_folder_node(int folder_fd)
{
	int fd = openat(folder_fd, ".node", O_PATH | O_CLOEXEC | O_NOFOLLOW);

	if (fd >= 0 && !is_socket(fd)) {
		close(fd);
		return -1;
	}
	return fd;
}

static int change_real(int folder_fd, uint32_t op, const char *name)
{
	return op == CM_NODE_OP_MKDIR ? mkdirat(folder_fd, name, 0755)
				      : unlinkat(folder_fd, name, AT_REMOVEDIR);
}

static int change_folder(const char *root, const char *folder, uint32_t op, const char *name)
{
	int folder_fd, node_fd;
	ssize_t result;

	if (!*name || *name == '.' || strchr(name, '/')) {
		errno = EINVAL;
		return -1;
	}
	folder_fd = cm_path_open(root, folder, O_RDONLY | O_DIRECTORY);
	if (folder_fd < 0)
		return -1;
	node_fd = open_folder_node(folder_fd);
	result = node_fd < 0 ? change_real(folder_fd, op, name)
			     : ask(node_fd, op, name, strlen(name), NULL, 0);
	if (node_fd >= 0)
		close_keeping_errno(node_fd);
	close_keeping_errno(folder_fd);
	return result < 0 ? -1 : 0;
}

int cm_attr_mkdir(const char *root, const char *folder, const char *name)
{
	return change_folder(root, folder, CM_NODE_OP_MKDIR, name);
}

int cm_attr_rmdir(const char *root, const char *folder, const char *name)
{
	return change_folder(root, folder, CM_NODE_OP_RMDIR, name);
}

int cm_attr_watch(const char *root, const char *folder)
{
	char *path = cm_path_join(root, folder);
	int fd;

	if (!path)
		return -1;
	fd = inotify_init1(IN_CLOEXEC | IN_NONBLOCK);
	if (fd >= 0 && inotify_add_watch(fd, path, IN_MODIFY | IN_MOVED_TO | IN_ONLYDIR) < 0) {
		close_keeping_errno(fd);
		fd = -1;
	}
	free(path);
	return fd;
}
