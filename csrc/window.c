// SPDX-License-Identifier: Apache-2.0
#include "window.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "cm_node.h"
#include "mirror.h"
#include "mmio.h"
#include "node.h"

/* What page 0 says once the grant was given back; the kernel has no such reason. */
#define RELEASED UINT32_MAX

struct cm_windows {
	struct cm_node *node;
};

struct cm_windows *cm_windows_open(const char *root)
{
	struct cm_windows *windows = calloc(1, sizeof(*windows));

	if (!windows)
		return NULL;
	windows->node = cm_node_open(root, "dev/cm_window");
	if (!windows->node) {
		cm_windows_close(windows);
		return NULL;
	}
	return windows;
}

void cm_windows_close(struct cm_windows *windows)
{
	int error = errno;

	if (!windows)
		return;
	cm_node_close(windows->node);
	free(windows);
	errno = error;
}

int cm_windows_event_fd(struct cm_windows *windows)
{
	return cm_node_event_fd(windows->node);
}

void cm_windows_release(struct cm_windows *windows)
{
	cm_node_release(windows->node);
}

int cm_windows_grant(struct cm_windows *windows, uint64_t address, uint64_t length, uint32_t flags,
		     uint32_t *id)
{
	struct cm_window_grant arg = {
		.size = sizeof(arg),
		.flags = flags,
		.address = address,
		.length = length,
		.fd = -1,
	};

	if (cm_node_request(windows->node, CM_WINDOW_IOC_GRANT, &arg, sizeof(arg), &arg.fd,
			    CM_NODE_FD_RECEIVE))
		return -1;
	*id = arg.id;
	return arg.fd;
}

static int take_back(struct cm_windows *windows, struct cm_window_revoke *arg)
{
	arg->size = sizeof(*arg);
	if (cm_node_request(windows->node, CM_WINDOW_IOC_REVOKE, arg, sizeof(*arg), NULL,
			    CM_NODE_FD_NONE))
		return -1;
	return (int)arg->count;
}

int cm_windows_revoke(struct cm_windows *windows, uint64_t address, uint64_t length)
{
	struct cm_window_revoke arg = { .address = address, .length = length };

	return take_back(windows, &arg);
}

int cm_windows_revoke_one(struct cm_windows *windows, uint32_t id)
{
	struct cm_window_revoke arg = { .id = id };

	if (!id) {
		errno = ENOENT;
		return -1;
	}
	return take_back(windows, &arg);
}

ssize_t cm_windows_take(struct cm_windows *windows, struct cm_window_event *events, size_t count)
{
	return cm_node_take(windows->node, events, sizeof(*events), count);
}

/* On a real board the registers are mapped, on a simulated one there is a connection and a mirror. */
struct cm_grant {
	const volatile struct cm_window_state *state;
	void *registers;
	uint64_t length;
	size_t page;
	bool writable;
	struct cm_node *node;
	struct cm_mirror mirror;
	uint64_t offset; /* of the grant's first byte in the mirror */
};

static void *map(int fd, size_t length, int protection, off_t offset)
{
	void *base = mmap(NULL, length, protection, MAP_SHARED, fd, offset);

	return base == MAP_FAILED ? NULL : base;
}

/* An access behind a file's end would end this process with SIGBUS; what is no file ends where it says. */
static int check_size(int fd, uint64_t length)
{
	struct stat st;

	if (fstat(fd, &st))
		return -1;
	if (!S_ISREG(st.st_mode) || (uint64_t)st.st_size >= length)
		return 0;
	errno = EPROTO;
	return -1;
}

static int map_state(struct cm_grant *grant, int fd)
{
	if (check_size(fd, grant->page))
		return -1;
	grant->state = map(fd, grant->page, PROT_READ, 0);
	if (!grant->state)
		return -1;
	grant->length = grant->state->length;
	grant->writable = grant->state->flags & CM_WINDOW_WRITE;
	return 0;
}

static int map_pages(struct cm_grant *grant, int fd)
{
	int protection = PROT_READ;

	if (map_state(grant, fd))
		return -1;
	if (!grant->length || grant->length > SIZE_MAX - grant->page) {
		errno = EINVAL;
		return -1;
	}
	if (check_size(fd, grant->page + grant->length))
		return -1;
	if (grant->writable)
		protection |= PROT_WRITE;
	grant->registers = map(fd, (size_t)grant->length, protection, (off_t)grant->page);
	return grant->registers ? 0 : -1;
}

static int ask_for_state(struct cm_grant *grant)
{
	struct cm_node_grant answer = { .fd = -1 };
	int result;

	if (cm_node_request(grant->node, CM_NODE_OP_GRANT, &answer, sizeof(answer), &answer.fd,
			    CM_NODE_FD_RECEIVE))
		return -1;
	grant->offset = answer.offset;
	result = map_state(grant, answer.fd);
	close(answer.fd);
	return result;
}

/* Without a mirror every read is a request, which is slower but otherwise the same. */
static void ask_for_mirror(struct cm_grant *grant)
{
	struct cm_node_mirror mirror = { .map = 0, .fd = -1 };

	if (!cm_node_offers(grant->node, CM_NODE_OFFERS_MIRROR) ||
	    cm_node_request(grant->node, CM_NODE_OP_MIRROR, &mirror, sizeof(mirror), &mirror.fd,
			    CM_NODE_FD_RECEIVE))
		return;
	cm_mirror_map(&grant->mirror, mirror.fd, mirror.size);
	close(mirror.fd);
}

static int map_simulated(struct cm_grant *grant, int fd)
{
	int own = fcntl(fd, F_DUPFD_CLOEXEC, 0);

	if (own < 0)
		return -1;
	grant->node = cm_node_adopt(own);
	if (!grant->node || ask_for_state(grant))
		return -1;
	ask_for_mirror(grant);
	return 0;
}

struct cm_grant *cm_grant_map(int fd)
{
	struct cm_grant *grant;
	struct stat st;

	if (fstat(fd, &st))
		return NULL;
	grant = calloc(1, sizeof(*grant));
	if (!grant)
		return NULL;
	grant->page = (size_t)sysconf(_SC_PAGESIZE);
	if (S_ISSOCK(st.st_mode) ? map_simulated(grant, fd) : map_pages(grant, fd)) {
		cm_grant_unmap(grant);
		return NULL;
	}
	return grant;
}

void cm_grant_unmap(struct cm_grant *grant)
{
	int error = errno;

	if (!grant)
		return;
	if (grant->state)
		munmap((void *)(uintptr_t)grant->state, grant->page);
	if (grant->registers)
		munmap(grant->registers, (size_t)grant->length);
	cm_mirror_unmap(&grant->mirror);
	cm_node_close(grant->node);
	free(grant);
	errno = error;
}

/* In one step for those who read there: memory of ones in place of what was mapped. */
static void replace(void *at, size_t length)
{
	void *ones = mmap(NULL, length, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);

	if (ones == MAP_FAILED)
		return;
	memset(ones, 0xff, length);
	if (mremap(ones, length, length, MREMAP_MAYMOVE | MREMAP_FIXED, at) == MAP_FAILED)
		munmap(ones, length);
}

void cm_grant_release(struct cm_grant *grant)
{
	int error = errno;

	replace((void *)(uintptr_t)grant->state, grant->page);
	if (grant->registers)
		replace(grant->registers, (size_t)grant->length);
	if (grant->node)
		cm_node_release(grant->node);
	errno = error;
}

uint64_t cm_grant_length(const struct cm_grant *grant)
{
	return grant->length;
}

int cm_grant_writable(const struct cm_grant *grant)
{
	return grant->writable;
}

int cm_grant_revoked(const struct cm_grant *grant)
{
	uint32_t revoked = grant->state->revoked;

	if (revoked != RELEASED)
		return (int)revoked;
	errno = EBADF;
	return -1;
}

/* After an access: whether it was one of the register. */
static inline int stands(const struct cm_grant *grant)
{
	uint32_t revoked = grant->state->revoked;

	if (!revoked)
		return 0;
	errno = revoked == RELEASED ? EBADF : ESTALE;
	return -1;
}

static inline int check_access(const struct cm_grant *grant, uint64_t offset, unsigned int width)
{
	uint64_t bytes = width / 8;

	if ((width == 32 || width == 8 || width == 16 || width == 64) && offset % bytes == 0 &&
	    offset < grant->length && bytes <= grant->length - offset)
		return 0;
	errno = EINVAL;
	return -1;
}

/* The simulator may have ended, or taken the grant back, instead of answering. */
static int ask(struct cm_grant *grant, uint32_t op, struct cm_node_reg *reg)
{
	int result = stands(grant);

	if (!result)
		result = cm_node_request(grant->node, op, reg, sizeof(*reg), NULL, CM_NODE_FD_NONE);
	return result ? -1 : stands(grant);
}

static int read_simulated(struct cm_grant *grant, uint64_t offset, unsigned int width,
			  uint64_t *value)
{
	struct cm_node_reg reg = { .width = width, .offset = offset };

	if (grant->mirror.values &&
	    cm_mirror_read(&grant->mirror, grant->offset + offset, width, value))
		return stands(grant);
	if (ask(grant, CM_NODE_OP_REG_READ, &reg))
		return -1;
	*value = width == 64 ? reg.value : reg.value & ((UINT64_C(1) << width) - 1);
	return 0;
}

int cm_grant_read(struct cm_grant *grant, uint64_t offset, unsigned int width, uint64_t *value)
{
	if (check_access(grant, offset, width))
		return -1;
	if (grant->node)
		return read_simulated(grant, offset, width, value);
	*value = cm_mmio_read((const char *)grant->registers + offset, width);
	return stands(grant);
}

int64_t cm_grant_read32(struct cm_grant *grant, uint64_t offset, unsigned int width)
{
	uint64_t value;

	if (width > 32) {
		errno = EINVAL;
		return -1;
	}
	return cm_grant_read(grant, offset, width, &value) ? -1 : (int64_t)value;
}

static int check_write(const struct cm_grant *grant)
{
	if (grant->writable)
		return 0;
	errno = EACCES;
	return -1;
}

int cm_grant_write(struct cm_grant *grant, uint64_t offset, unsigned int width, uint64_t value)
{
	struct cm_node_reg reg = { .width = width, .offset = offset, .value = value };

	if (check_access(grant, offset, width) || check_write(grant))
		return -1;
	if (width < 64 && value >> width) {
		errno = ERANGE;
		return -1;
	}
	if (grant->node)
		return ask(grant, CM_NODE_OP_REG_WRITE, &reg);
	cm_mmio_write((char *)grant->registers + offset, width, value);
	return stands(grant);
}

static int check_block(const struct cm_grant *grant, uint64_t offset, size_t length)
{
	if (offset % 4 == 0 && length % 4 == 0 && length <= grant->length &&
	    offset <= grant->length - length)
		return 0;
	errno = EINVAL;
	return -1;
}

int cm_grant_read_block(struct cm_grant *grant, uint64_t offset, void *data, size_t length)
{
	size_t done;

	if (check_block(grant, offset, length))
		return -1;
	if (!grant->node) {
		cm_mmio_read_block((const char *)grant->registers + offset, data, length);
		return stands(grant);
	}
	for (done = 0; done < length; done += 4) {
		uint64_t value;
		uint32_t word;

		if (read_simulated(grant, offset + done, 32, &value))
			return -1;
		word = (uint32_t)value;
		memcpy((char *)data + done, &word, sizeof(word));
	}
	return stands(grant);
}

int cm_grant_write_block(struct cm_grant *grant, uint64_t offset, const void *data, size_t length)
{
	size_t done;

	if (check_block(grant, offset, length) || check_write(grant))
		return -1;
	if (!grant->node) {
		cm_mmio_write_block((char *)grant->registers + offset, data, length);
		return stands(grant);
	}
	for (done = 0; done < length; done += 4) {
		uint32_t word;

		memcpy(&word, (const char *)data + done, sizeof(word));
		if (cm_grant_write(grant, offset + done, 32, word))
			return -1;
	}
	return 0;
}
