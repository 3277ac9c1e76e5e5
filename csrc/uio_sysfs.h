/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What /sys/class/uio says: names and maps, by number.  Pure look-ups of plain
 * files; nothing is opened for longer than the call.
 */
#ifndef CM_SHIM_UIO_SYSFS_H
#define CM_SHIM_UIO_SYSFS_H

#include <stddef.h>
#include <stdint.h>

#define CM_UIO_MAPS_MAX 5 /* MAX_UIO_MAPS of the kernel */
#define CM_UIO_NAME_MAX 64

/**
 * struct cm_uio_map - one memory window of a UIO device
 * @address: physical address of the first register
 * @size: bytes, from @address on
 * @offset: of the first register from the start of what mmap() gives
 * @name: as the driver or the device tree calls it, may be empty
 */
struct cm_uio_map {
	uint64_t address;
	uint64_t size;
	uint64_t offset;
	char name[CM_UIO_NAME_MAX];
};

struct cm_uio_info {
	unsigned int number;
	unsigned int map_count;
	char name[CM_UIO_NAME_MAX];
	struct cm_uio_map maps[CM_UIO_MAPS_MAX];
};

/* Describe /dev/uio@number.  ENOENT if there is none, EINVAL for a malformed attribute. */
int cm_uio_describe(const char *root, unsigned int number, struct cm_uio_info *info);

/**
 * cm_uio_list() - numbers of all UIO devices, ascending
 * @numbers: room for @room of them
 *
 * Returns how many there are, which may be more than @room.  A system without
 * the class has 0.
 */
int cm_uio_list(const char *root, unsigned int *numbers, size_t room);

/*
 * The first device of that name, with or without its node's address, whichever the kernel
 * shows ("uioN" works too).  ENOENT if there is none.
 */
int cm_uio_find_name(const char *root, const char *name, struct cm_uio_info *info);

/* The device whose map @map covers [address, address + length).  ENOENT if none does. */
int cm_uio_find_address(const char *root, uint64_t address, uint64_t length,
			struct cm_uio_info *info, unsigned int *map);

#endif /* CM_SHIM_UIO_SYSFS_H */
