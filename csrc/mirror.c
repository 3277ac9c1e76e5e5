// SPDX-License-Identifier: Apache-2.0
#include "mirror.h"

#include <errno.h>
#include <stdatomic.h>
#include <sys/mman.h>
#include <sys/stat.h>

#include "mmio.h"

int cm_mirror_map(struct cm_mirror *mirror, int fd, uint64_t size)
{
	struct stat st;
	void *base;

	/* A shorter file would end this process with SIGBUS. */
	if (fstat(fd, &st))
		return -1;
	if (!size || size > SIZE_MAX / 2 || (uint64_t)st.st_size < 2 * size) {
		errno = EPROTO;
		return -1;
	}
	base = mmap(NULL, 2 * (size_t)size, PROT_READ, MAP_SHARED, fd, 0);
	if (base == MAP_FAILED)
		return -1;
	mirror->values = base;
	mirror->size = (size_t)size;
	return 0;
}

void cm_mirror_unmap(struct cm_mirror *mirror)
{
	if (mirror->values)
		munmap((void *)(uintptr_t)mirror->values, 2 * mirror->size);
	mirror->values = NULL;
	mirror->size = 0;
}

bool cm_mirror_read(const struct cm_mirror *mirror, uint64_t offset, unsigned int width,
		    uint64_t *value)
{
	const volatile uint8_t *at = mirror->values + offset;
	const volatile uint8_t *flags = at + mirror->size;

	if (offset + width / 8 > mirror->size || cm_mmio_read(flags, width))
		return false;
	atomic_thread_fence(memory_order_acquire);
	*value = cm_mmio_read(at, width);
	atomic_thread_fence(memory_order_acquire);
	return !cm_mmio_read(flags, width); /* otherwise it was withdrawn meanwhile */
}

/* Whether none of the bytes has a flag. */
static bool unflagged(const volatile uint8_t *flags, size_t length)
{
	const volatile uint32_t *word = (const volatile uint32_t *)(uintptr_t)flags;
	uint32_t any = 0;
	size_t i;

	for (i = 0; i < length / 4; i++)
		any |= word[i];
	return !any;
}

bool cm_mirror_read_block(const struct cm_mirror *mirror, uint64_t offset, void *data,
			  size_t length)
{
	const volatile uint8_t *at = mirror->values + offset;

	if (offset + length > mirror->size || !unflagged(at + mirror->size, length))
		return false;
	atomic_thread_fence(memory_order_acquire);
	cm_mmio_read_block(at, data, length);
	atomic_thread_fence(memory_order_acquire);
	return unflagged(at + mirror->size, length);
}
