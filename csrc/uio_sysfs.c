// SPDX-License-Identifier: Apache-2.0
#include "uio_sysfs.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "path.h"

#define CLASS "sys/class/uio"
#define DEVICES_MAX 256

static int read_number(const char *root, const char *folder, const char *leaf, uint64_t *value)
{
	char path[128], text[64], *end;

	snprintf(path, sizeof(path), "%s/%s", folder, leaf);
	if (cm_path_read_text(root, path, text, sizeof(text)))
		return -1;
	errno = 0;
	*value = strtoull(text, &end, 0);
	if (errno || end == text || *end) {
		errno = EINVAL;
		return -1;
	}
	return 0;
}

/*
 * A window that does not begin at a page: sysfs has the address and the size of
 * the pages, and where in them the device begins (uio_pdrv_genirq.c).
 */
static void begin_at_device(struct cm_uio_map *map)
{
	if (map->offset >= map->size)
		return;
	map->address += map->offset;
	map->size -= map->offset;
}

static int read_map(const char *root, unsigned int number, unsigned int index,
		    struct cm_uio_map *map)
{
	char folder[96], path[128];

	snprintf(folder, sizeof(folder), CLASS "/uio%u/maps/map%u", number, index);
	if (read_number(root, folder, "addr", &map->address) ||
	    read_number(root, folder, "size", &map->size))
		return -1;
	if (read_number(root, folder, "offset", &map->offset))
		map->offset = 0; /* kernels before 2.6.38 do not have it */
	begin_at_device(map);
	snprintf(path, sizeof(path), "%s/name", folder);
	if (cm_path_read_text(root, path, map->name, sizeof(map->name)))
		map->name[0] = '\0';
	return 0;
}

int cm_uio_describe(const char *root, unsigned int number, struct cm_uio_info *info)
{
	char path[96];

	memset(info, 0, sizeof(*info));
	info->number = number;
	snprintf(path, sizeof(path), CLASS "/uio%u/name", number);
	if (cm_path_read_text(root, path, info->name, sizeof(info->name)))
		return -1;
	while (info->map_count < CM_UIO_MAPS_MAX) {
		if (read_map(root, number, info->map_count, &info->maps[info->map_count]))
			return errno == ENOENT ? 0 : -1;
		info->map_count++;
	}
	return 0;
}

/* Parse "uioN". */
static bool parse_node(const char *text, unsigned int *number)
{
	unsigned long value;
	char *end;

	if (strncmp(text, "uio", 3) || text[3] < '0' || text[3] > '9')
		return false;
	value = strtoul(text + 3, &end, 10);
	*number = (unsigned int)value;
	return !*end && value < UINT32_MAX;
}

static int ascending(const void *a, const void *b)
{
	unsigned int left = *(const unsigned int *)a, right = *(const unsigned int *)b;

	return (left > right) - (left < right);
}

static DIR *open_class(const char *root)
{
	int fd = cm_path_open(root, CLASS, O_RDONLY | O_DIRECTORY);
	DIR *dir;

	if (fd < 0)
		return NULL;
	dir = fdopendir(fd);
	if (!dir)
		close(fd);
	return dir;
}

int cm_uio_list(const char *root, unsigned int *numbers, size_t room)
{
	DIR *dir = open_class(root);
	struct dirent *entry;
	size_t count = 0;

	if (!dir)
		return errno == ENOENT ? 0 : -1;
	while ((entry = readdir(dir))) {
		unsigned int number;

		if (!parse_node(entry->d_name, &number))
			continue;
		if (count < room)
			numbers[count] = number;
		count++;
	}
	closedir(dir);
	qsort(numbers, count < room ? count : room, sizeof(*numbers), ascending);
	return (int)count;
}

/* Which map of @info covers the range, or -1. */
static int covering_map(const struct cm_uio_info *info, uint64_t address, uint64_t length)
{
	unsigned int i;

	for (i = 0; i < info->map_count; i++) {
		const struct cm_uio_map *map = &info->maps[i];

		if (address >= map->address && length <= map->size &&
		    address - map->address <= map->size - length)
			return (int)i;
	}
	return -1;
}

struct query {
	const char *name; /* NULL: by address */
	uint64_t address, length;
};

/*
 * uio_pdrv_genirq and cm_window call a device as its node without the address ("filter");
 * uio_pdrv_genirq from 6.12 on with it ("filter@43c00000").  Both are taken for either.
 */
static bool named(const char *wanted, const struct cm_uio_info *info)
{
	size_t length = strcspn(wanted, "@");

	if (!strcmp(wanted, info->name))
		return true;
	if (strncmp(wanted, info->name, length) || (wanted[length] && info->name[length]))
		return false;
	if (!wanted[length])
		return info->name[length] == '@';
	return info->map_count && strtoull(wanted + length + 1, NULL, 16) == info->maps[0].address;
}

static bool answers(const struct query *query, const struct cm_uio_info *info, unsigned int *map)
{
	int found;

	if (query->name)
		return named(query->name, info);
	found = covering_map(info, query->address, query->length);
	*map = (unsigned int)found;
	return found >= 0;
}

static int find(const char *root, const struct query *query, struct cm_uio_info *info,
		unsigned int *map)
{
	unsigned int numbers[DEVICES_MAX];
	int count = cm_uio_list(root, numbers, DEVICES_MAX), i;

	if (count < 0)
		return -1;
	for (i = 0; i < count && i < DEVICES_MAX; i++) {
		/* A device may disappear between listing and reading: not an error. */
		if (!cm_uio_describe(root, numbers[i], info) && answers(query, info, map))
			return 0;
	}
	errno = ENOENT;
	return -1;
}

int cm_uio_find_name(const char *root, const char *name, struct cm_uio_info *info)
{
	struct query query = { .name = name };
	unsigned int number, map;

	if (parse_node(name, &number))
		return cm_uio_describe(root, number, info);
	return find(root, &query, info, &map);
}

int cm_uio_find_address(const char *root, uint64_t address, uint64_t length,
			struct cm_uio_info *info, unsigned int *map)
{
	struct query query = { .address = address, .length = length };

	return find(root, &query, info, map);
}
