/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The mirror that a simulated UIO node may bring (struct cm_node_mirror): its
 * registers as a load instruction reads them, which is how a real device is read.
 */
#ifndef CM_SHIM_MIRROR_H
#define CM_SHIM_MIRROR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/**
 * struct cm_mirror - a mapped mirror; all zero: none
 * @values: what a read returns, @size bytes, and as many flags behind them
 */
struct cm_mirror {
	const volatile uint8_t *values;
	size_t size;
};

/* Map the mirror of @size bytes in memfd @fd, which stays the caller's. Errors: EPROTO, those of mmap(). */
int cm_mirror_map(struct cm_mirror *mirror, int fd, uint64_t size);

/* Unmap, if there is one. */
void cm_mirror_unmap(struct cm_mirror *mirror);

/**
 * cm_mirror_read() - read a register, if the mirror can tell its value now
 * @offset: bytes, a multiple of the width
 * @width: 8, 16, 32 or 64 bits
 *
 * False where there is no mirror, or the node has to be asked.
 */
bool cm_mirror_read(const struct cm_mirror *mirror, uint64_t offset, unsigned int width,
		    uint64_t *value);

/* cm_mirror_read() of several words; @offset and @length are multiples of 4. */
bool cm_mirror_read_block(const struct cm_mirror *mirror, uint64_t offset, void *data,
			  size_t length);

#endif /* CM_SHIM_MIRROR_H */
