// SPDX-License-Identifier: Apache-2.0
#include "uio.h"

#include <errno.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

#include "bus.h"
#include "cm_node.h"
#include "uio_private.h"

/* Interrupts that are taken at once; a real device merges them into one. */
#define TAKE_AT_ONCE 16

/* uio_mmap() chooses the window by the page offset. */
static int map_windows(struct cm_uio *uio)
{
	size_t page = (size_t)sysconf(_SC_PAGESIZE);
	unsigned int i;

	if (cm_bus_watch())
		return -1;
	for (i = 0; i < uio->info.map_count; i++) {
		const struct cm_uio_map *map = &uio->info.maps[i];
		size_t length = (size_t)(map->offset + map->size + page - 1) & ~(page - 1);
		void *base = cm_node_mmap(uio->node, length, (off_t)(i * page));

		if (base == MAP_FAILED)
			return -1;
		uio->windows[i].base = base;
		uio->windows[i].length = length;
	}
	return 0;
}

/* Without a mirror every read is a request, which is slower but otherwise the same. */
static void map_mirror(struct cm_uio *uio)
{
	struct cm_node_mirror mirror = { .map = 0, .fd = -1 };

	if (!cm_node_offers(uio->node, CM_NODE_OFFERS_MIRROR) ||
	    cm_node_request(uio->node, CM_NODE_OP_MIRROR, &mirror, sizeof(mirror), &mirror.fd,
			    CM_NODE_FD_RECEIVE))
		return;
	cm_mirror_map(&uio->mirror, mirror.fd, mirror.size);
	close(mirror.fd);
}

static int map_memory(struct cm_uio *uio)
{
	if (!cm_node_simulated(uio->node))
		return map_windows(uio);
	map_mirror(uio);
	return 0;
}

static struct cm_uio *open_described(const char *root, const struct cm_uio_info *info)
{
	struct cm_uio *uio = calloc(1, sizeof(*uio));
	char path[32];

	if (!uio)
		return NULL;
	uio->info = *info;
	snprintf(path, sizeof(path), "dev/uio%u", info->number);
	uio->node = cm_node_open(root, path);
	if (!uio->node || map_memory(uio)) {
		cm_uio_close(uio);
		return NULL;
	}
	return uio;
}

struct cm_uio *cm_uio_open(const char *root, unsigned int number)
{
	struct cm_uio_info info;

	return cm_uio_describe(root, number, &info) ? NULL : open_described(root, &info);
}

struct cm_uio *cm_uio_open_by_name(const char *root, const char *name)
{
	struct cm_uio_info info;

	return cm_uio_find_name(root, name, &info) ? NULL : open_described(root, &info);
}

struct cm_uio *cm_uio_open_by_address(const char *root, uint64_t address)
{
	struct cm_uio_info info;
	unsigned int map;

	return cm_uio_find_address(root, address, 1, &info, &map) ? NULL
								  : open_described(root, &info);
}

void cm_uio_close(struct cm_uio *uio)
{
	int error = errno, i;

	if (!uio)
		return;
	for (i = 0; i < CM_UIO_MAPS_MAX; i++) {
		if (uio->windows[i].base)
			munmap(uio->windows[i].base, uio->windows[i].length);
	}
	cm_mirror_unmap(&uio->mirror);
	cm_node_close(uio->node);
	free(uio);
	errno = error;
}

const struct cm_uio_info *cm_uio_get_info(const struct cm_uio *uio)
{
	return &uio->info;
}

int cm_uio_event_fd(struct cm_uio *uio)
{
	return cm_node_event_fd(uio->node);
}

void cm_uio_release(struct cm_uio *uio)
{
	cm_node_release(uio->node);
}

static int check_access(const struct cm_uio *uio, unsigned int map, uint64_t offset,
			unsigned int width)
{
	uint64_t bytes = width / 8, size;

	if (map >= uio->info.map_count || (width != 8 && width != 16 && width != 32 && width != 64))
		goto invalid;
	size = uio->info.maps[map].size;
	if (offset % bytes || bytes > size || offset > size - bytes)
		goto invalid;
	return 0;
invalid:
	errno = EINVAL;
	return -1;
}

/* Read by a load instruction; 0 if the node has to be asked, -1 if nobody answered. */
static int load(const struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width,
		uint64_t *value)
{
	if (cm_node_simulated(uio->node))
		return map == 0 && uio->mirror.values &&
		       cm_mirror_read(&uio->mirror, offset, width, value) &&
		       cm_node_connected(uio->node);
	return cm_bus_read(cm_uio_at(uio, map, offset), width, value) ? -1 : 1;
}

int cm_uio_load(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width,
		uint64_t *value)
{
	int loaded;

	if (check_access(uio, map, offset, width) || cm_node_enter(uio->node))
		return -1;
	loaded = load(uio, map, offset, width, value);
	cm_node_leave(uio->node);
	return loaded;
}

bool cm_uio_loads(const struct cm_uio *uio, unsigned int map)
{
	return !cm_node_simulated(uio->node) || (map == 0 && uio->mirror.values);
}

int cm_uio_read(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width,
		uint64_t *value)
{
	struct cm_node_reg reg = { .map = map, .width = width, .offset = offset };
	int loaded = cm_uio_load(uio, map, offset, width, value);

	if (loaded)
		return loaded < 0 ? -1 : 0;
	if (cm_node_request(uio->node, CM_NODE_OP_REG_READ, &reg, sizeof(reg), NULL,
			    CM_NODE_FD_NONE))
		return -1;
	*value = width == 64 ? reg.value : reg.value & ((UINT64_C(1) << width) - 1);
	return 0;
}

int64_t cm_uio_read32(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width)
{
	uint64_t value;

	if (width > 32) {
		errno = EINVAL;
		return -1;
	}
	return cm_uio_read(uio, map, offset, width, &value) ? -1 : (int64_t)value;
}

int cm_uio_write(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width,
		 uint64_t value)
{
	struct cm_node_reg reg = { .map = map, .width = width, .offset = offset, .value = value };
	int result;

	if (check_access(uio, map, offset, width))
		return -1;
	if (width < 64 && value >> width) {
		errno = ERANGE;
		return -1;
	}
	if (!cm_node_simulated(uio->node)) {
		if (cm_node_enter(uio->node))
			return -1;
		result = cm_bus_write(cm_uio_at(uio, map, offset), width, value);
		cm_node_leave(uio->node);
		return result;
	}
	return cm_node_request(uio->node, CM_NODE_OP_REG_WRITE, &reg, sizeof(reg), NULL,
			       CM_NODE_FD_NONE);
}

int cm_uio_enable_interrupt(struct cm_uio *uio)
{
	uint32_t on = 1;

	return cm_node_write(uio->node, &on, sizeof(on));
}

/*
 * A real device returns the newest count and forgets those between; on a
 * simulated one each interrupt is a packet, so look for the newest.
 */
int cm_uio_take(struct cm_uio *uio, uint32_t *count)
{
	size_t room = cm_node_simulated(uio->node) ? TAKE_AT_ONCE : 1;
	uint32_t counts[TAKE_AT_ONCE];
	ssize_t got, all = 0;

	do {
		got = cm_node_take(uio->node, counts, sizeof(counts[0]), room);
		if (got > 0) {
			*count = counts[got - 1];
			all += got;
		}
	} while (got == TAKE_AT_ONCE);
	return got < 0 && !all ? -1 : all > 0;
}

int cm_uio_wait(struct cm_uio *uio, int64_t timeout_ns, uint32_t *count)
{
	uint32_t newer;

	if (cm_node_wait(uio->node, timeout_ns, count, sizeof(*count)) < 0)
		return -1;
	if (cm_node_simulated(uio->node) && cm_uio_take(uio, &newer) > 0)
		*count = newer;
	return 1;
}
