// SPDX-License-Identifier: GPL-2.0-only
/* A video frame's shape as a request. */
#include <linux/errno.h>
#include <linux/overflow.h>

#include "axidma.h"

/**
 * axidma_frame_request() - a video frame as a request
 * @frame: its shape
 * @request: lines, line_bytes and stride are filled in
 *
 * Return: 0, or -EINVAL for a shape that cannot be.
 */
int axidma_frame_request(const struct axidma_abi_frame *frame, struct cm_request *request)
{
	u32 bytes;

	if (frame->height <= 0 || frame->width <= 0 || frame->depth <= 0)
		return -EINVAL;
	if (check_mul_overflow((u32)frame->width, (u32)frame->depth, &bytes))
		return -EINVAL;
	request->lines = frame->height;
	request->line_bytes = bytes;
	request->stride = bytes;
	return 0;
}
