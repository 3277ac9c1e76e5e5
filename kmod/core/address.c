// SPDX-License-Identifier: GPL-2.0-only
/* Where a part of a buffer lies for the device. */
#include <linux/errno.h>
#include <linux/scatterlist.h>

#include "cm_compat.h"
#include "cm_core.h"

/* the range must lie in one piece: one request is one descriptor */
static int imported_address(struct cm_buffer *buffer, u64 offset, u64 length, dma_addr_t *address)
{
	struct scatterlist *sg;
	dma_addr_t next = 0;
	u64 start = 0, have = 0;
	int i;

	for_each_sgtable_dma_sg(buffer->table, sg, i) {
		u64 end = start + sg_dma_len(sg);

		if (have && sg_dma_address(sg) != next)
			return -EINVAL;
		if (!have && offset < end) {
			*address = sg_dma_address(sg) + (offset - start);
			have = end - offset;
		} else if (have) {
			have += sg_dma_len(sg);
		}
		if (have >= length)
			return 0;
		next = sg_dma_address(sg) + sg_dma_len(sg);
		start = end;
	}
	return -EINVAL;
}

/**
 * cm_buffer_address() - the device's address of a range
 * @buffer: buffer
 * @offset: first byte
 * @length: bytes, > 0
 * @address: filled in
 *
 * Return: 0, or -EINVAL where the range is empty, lies outside the buffer, or
 * is not contiguous for the device.
 */
int cm_buffer_address(struct cm_buffer *buffer, u64 offset, u64 length, dma_addr_t *address)
{
	if (!length || offset > buffer->length || length > buffer->length - offset)
		return -EINVAL;
	if (buffer->kind == CM_BUFFER_IMPORTED)
		return imported_address(buffer, offset, length, address);
	*address = buffer->dma + offset;
	return 0;
}
EXPORT_SYMBOL_CM(cm_buffer_address);
