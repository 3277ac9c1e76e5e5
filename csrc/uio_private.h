/* SPDX-License-Identifier: Apache-2.0 */
/* The inside of a UIO device, shared by uio.c and uio_block.c only. */
#ifndef CM_SHIM_UIO_PRIVATE_H
#define CM_SHIM_UIO_PRIVATE_H

#include "mirror.h"
#include "node.h"
#include "uio.h"

struct cm_uio {
	struct cm_node *node;
	struct cm_uio_info info;
	struct {
		void *base;
		size_t length;
	} windows[CM_UIO_MAPS_MAX];
	struct cm_mirror mirror; /* of a simulated node's window 0 */
};

/* Where a register of a real device is mapped; the caller has checked map and offset. */
static inline volatile void *cm_uio_at(const struct cm_uio *uio, unsigned int map, uint64_t offset)
{
	return (char *)uio->windows[map].base + uio->info.maps[map].offset + offset;
}

#endif /* CM_SHIM_UIO_PRIVATE_H */
