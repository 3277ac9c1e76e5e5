// SPDX-License-Identifier: Apache-2.0
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdlib.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clock.h"
#include "cm_node.h"
#include "message.h"
#include "node_private.h"
#include "path.h"

/* How long close() waits for a simulated node to finish, like a driver's release(). */
#define RELEASE_TIMEOUT_MS 5000

/* CM_SIM_TIMEOUT in whole seconds, for simulators under a debugger or on a machine that is too busy. */
static int answer_timeout_ms(void)
{
	const char *text = secure_getenv("CM_SIM_TIMEOUT");
	char *end = NULL;
	long seconds = text ? strtol(text, &end, 10) : 0;

	if (seconds < 1 || seconds > CM_NODE_TIMEOUT_MAX_S || *end != '\0')
		return CM_NODE_TIMEOUT_MS;
	return (int)seconds * 1000;
}

static int greet(struct cm_node *node)
{
	if (cm_message_greeting(node->fd, &node->event_fd, &node->offers))
		return -1;
	if (node->event_fd < 0) {
		errno = EPROTO;
		return -1;
	}
	return 0;
}

static int open_kind(struct cm_node *node, int path_fd)
{
	struct stat st;

	if (fstat(path_fd, &st))
		return -1;
	if (S_ISCHR(st.st_mode)) {
		node->fd = cm_path_reopen(path_fd, O_RDWR | O_NONBLOCK);
		node->event_fd = node->fd;
		return node->fd < 0 ? -1 : 0;
	}
	if (S_ISSOCK(st.st_mode)) {
		node->simulated = true;
		node->fd = cm_path_connect(path_fd, answer_timeout_ms());
		return node->fd < 0 ? -1 : greet(node);
	}
	errno = ENXIO;
	return -1;
}

static int open_under(struct cm_node *node, const char *root, const char *path)
{
	int path_fd = cm_path_open(root, path, O_PATH);
	int result, error;

	if (path_fd < 0)
		return -1;
	result = open_kind(node, path_fd);
	error = errno;
	close(path_fd);
	errno = error;
	return result;
}

/* A node without a device yet. */
static struct cm_node *make_node(void)
{
	struct cm_node *node = calloc(1, sizeof(*node));

	if (!node)
		return NULL;
	node->fd = node->event_fd = -1;
	node->owner = getpid();
	pthread_mutex_init(&node->lock, NULL);
	pthread_rwlock_init(&node->users, NULL);
	node->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	if (node->wake_fd < 0) {
		cm_node_close(node);
		return NULL;
	}
	return node;
}

struct cm_node *cm_node_open(const char *root, const char *path)
{
	struct cm_node *node = make_node();

	if (node && open_under(node, root, path)) {
		cm_node_close(node);
		return NULL;
	}
	return node;
}

static int adopt(struct cm_node *node, int fd)
{
	struct stat st;

	node->fd = fd;
	if (fstat(fd, &st))
		return -1;
	if (!S_ISSOCK(st.st_mode)) {
		node->event_fd = fd;
		return 0;
	}
	node->simulated = true;
	return cm_path_limit(fd, answer_timeout_ms()) ? -1 : greet(node);
}

struct cm_node *cm_node_adopt(int fd)
{
	struct cm_node *node = make_node();

	if (!node) {
		int error = errno;

		close(fd);
		errno = error;
		return NULL;
	}
	if (adopt(node, fd)) {
		cm_node_close(node);
		return NULL;
	}
	return node;
}

/* Wait for the server to close its end too: then its release() is done. */
static void await_release(int fd)
{
	struct pollfd end = { .fd = fd, .events = POLLIN };
	int64_t deadline = cm_clock_ns() + RELEASE_TIMEOUT_MS * INT64_C(1000000);
	char rest[64];

	if (shutdown(fd, SHUT_WR))
		return;
	for (;;) {
		int64_t left = (deadline - cm_clock_ns()) / 1000000;
		int ready = left > 0 ? poll(&end, 1, (int)left) : 0;

		if (ready < 0 && errno == EINTR)
			continue;
		if (ready <= 0 || recv(fd, rest, sizeof(rest), MSG_DONTWAIT) <= 0)
			return;
	}
}

static void close_descriptors(struct cm_node *node)
{
	if (node->simulated && node->event_fd >= 0) {
		if (node->owner == getpid() && node->broken != ETIMEDOUT)
			await_release(node->fd);
		close(node->event_fd);
	}
	if (node->fd >= 0)
		close(node->fd);
	node->fd = node->event_fd = -1;
}

void cm_node_release(struct cm_node *node)
{
	int error = errno;

	if (!atomic_exchange(&node->released, true)) {
		/* It fails only if the counter is full, and then it is readable already. */
		(void)!eventfd_write(node->wake_fd, 1);
	}
	pthread_rwlock_wrlock(&node->users);
	close_descriptors(node);
	pthread_rwlock_unlock(&node->users);
	errno = error;
}

void cm_node_close(struct cm_node *node)
{
	int error = errno;

	if (!node)
		return;
	cm_node_release(node);
	if (node->wake_fd >= 0)
		close(node->wake_fd);
	pthread_rwlock_destroy(&node->users);
	pthread_mutex_destroy(&node->lock);
	free(node);
	errno = error;
}

int cm_node_enter(struct cm_node *node)
{
	/* Checked before the lock, so that a stream of calls cannot delay the release. */
	if (!atomic_load(&node->released)) {
		pthread_rwlock_rdlock(&node->users);
		if (node->fd >= 0)
			return 0;
		pthread_rwlock_unlock(&node->users);
	}
	errno = EBADF;
	return -1;
}

void cm_node_leave(struct cm_node *node)
{
	pthread_rwlock_unlock(&node->users);
}

bool cm_node_simulated(const struct cm_node *node)
{
	return node->simulated;
}

bool cm_node_offers(const struct cm_node *node, uint32_t offers)
{
	return (node->offers & offers) == offers;
}

bool cm_node_connected(const struct cm_node *node)
{
	struct pollfd end = { .fd = node->fd };

	return !node->simulated || poll(&end, 1, 0) == 0;
}

int cm_node_event_fd(struct cm_node *node)
{
	int fd;

	if (cm_node_enter(node))
		return -1;
	fd = node->event_fd;
	cm_node_leave(node);
	return fd;
}

void *cm_node_mmap(struct cm_node *node, size_t length, off_t offset)
{
	if (node->simulated) {
		errno = ENOTSUP;
		return MAP_FAILED;
	}
	return mmap(NULL, length, PROT_READ | PROT_WRITE, MAP_SHARED, node->fd, offset);
}
