// SPDX-License-Identifier: GPL-2.0-only
/* Whether a channel can do what is asked of it; nothing here needs a device. */
#include <linux/ctype.h>
#include <linux/errno.h>
#include <linux/kernel.h>
#include <linux/math64.h>
#include <linux/string.h>

#include "cm_core.h"

/*
 * AXI VDMA's registers (PG020): HSIZE and the stride have 16 bits, VSIZE 13.
 * Its driver writes what it is given, and more of a stride is the frame delay.
 */
#define VDMA_LINE_MAX 0xFFFF
#define VDMA_LINES_MAX 0x1FFF

static int check_video(const struct cm_dma_info *info, const struct cm_request *request)
{
	if (!(info->caps & CM_DMA_CAP_VIDEO))
		return -EOPNOTSUPP;
	if (!request->line_bytes || request->stride < request->line_bytes)
		return -EINVAL;
	if ((request->offset | request->line_bytes | request->stride) & (info->alignment - 1))
		return -EINVAL;
	if (info->type == CM_DMA_TYPE_VDMA &&
	    (request->lines > VDMA_LINES_MAX || request->stride > VDMA_LINE_MAX))
		return -EMSGSIZE;
	return request->line_bytes > info->max_length ? -EMSGSIZE : 0;
}

static int check_cyclic(const struct cm_dma_info *info, const struct cm_request *request)
{
	u64 rest;

	if (!(info->caps & CM_DMA_CAP_CYCLIC))
		return -EOPNOTSUPP;
	if (!request->period || request->period > request->length ||
	    request->period & (info->alignment - 1))
		return -EINVAL;
	div64_u64_rem(request->length, request->period, &rest);
	if (rest)
		return -EINVAL;
	return request->period > info->max_length ? -EMSGSIZE : 0;
}

/**
 * cm_request_check() - compare a request with what a channel can do
 * @info: of the channel
 * @request: request; whether its memory is there is not looked at
 *
 * Return: 0, -EINVAL against the alignment or for a shape that cannot be,
 * -EMSGSIZE above the longest transfer, -EOPNOTSUPP.
 */
int cm_request_check(const struct cm_dma_info *info, const struct cm_request *request)
{
	if (request->lines)
		return check_video(info, request);
	if ((request->offset | request->length) & (info->alignment - 1))
		return -EINVAL;
	if (request->cyclic)
		return check_cyclic(info, request);
	if (request->period)
		return -EINVAL;
	return request->length > info->max_length ? -EMSGSIZE : 0;
}

/**
 * cm_request_footprint() - bytes from the first to the last that is touched
 * @request: request that passed cm_request_check()
 *
 * Return: the number; the shape's 32-bit members cannot overflow it.
 */
u64 cm_request_footprint(const struct cm_request *request)
{
	if (!request->lines)
		return request->length;
	return (u64)(request->lines - 1) * request->stride + request->line_bytes;
}

/**
 * cm_request_readable() - periods that can be read while one is written
 * @request: request that passed cm_request_check()
 *
 * Return: all periods of a cyclic transfer but the one that the hardware is
 * at, and at least one; 1 for a request that is not cyclic.  U32_MAX for video,
 * whose one frame is overwritten each time: its completions only count.
 */
u32 cm_request_readable(const struct cm_request *request)
{
	if (!request->cyclic)
		return 1;
	if (request->lines)
		return U32_MAX;
	return clamp_t(u64, div64_u64(request->length, request->period) - 1, 1, U32_MAX);
}

/**
 * cm_channel_name_valid() - whether a name can be that of a node
 * @name: NUL-terminated
 *
 * Return: true for 1 to CM_DMA_NAME_MAX - 1 of A-Z, a-z, 0-9, ".", "_", "-",
 * that do not begin with a dot.
 */
bool cm_channel_name_valid(const char *name)
{
	size_t length;

	for (length = 0; name[length]; length++) {
		if (!isascii(name[length]) ||
		    (!isalnum(name[length]) && !strchr("._-", name[length])))
			return false;
	}
	return length && length < CM_DMA_NAME_MAX && name[0] != '.';
}
