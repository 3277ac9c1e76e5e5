/* SPDX-License-Identifier: GPL-2.0-only */
/* The configuration memory behind a port: frames by their address. */
#ifndef _CM_FRAMES_H
#define _CM_FRAMES_H

#include <linux/mutex.h>
#include <linux/types.h>
#include <linux/xarray.h>

#define CM_FRAME_WORDS 101 /* of 7 series (UG470, table 5-23) */
#define CM_NO_FRAME U32_MAX

/**
 * struct cm_frames - frames
 * @lock: protects all of it
 * @held: words of each frame that was written, by frame address
 * @count: how many there are
 * @order: addresses in the device's order, CM_NO_FRAME for frames of no column;
 *         NULL: each frame's address is one more than that of the one before
 * @order_count: entries of @order
 * @arriving: the port's: frame of which not all words have come
 * @buffer: the port's: frame before that; they pass through it to memory and back
 */
struct cm_frames {
	struct mutex lock; /* protects all of it */
	struct xarray held;
	u32 count;
	u32 *order;
	size_t order_count;
	u32 arriving[CM_FRAME_WORDS];
	u32 buffer[CM_FRAME_WORDS];
};

void cm_frames_init(struct cm_frames *frames);
void cm_frames_destroy(struct cm_frames *frames);
void cm_frames_store(struct cm_frames *frames, u32 far, const u32 *words);
void cm_frames_fetch(struct cm_frames *frames, u32 far, u32 *words);
size_t cm_frames_place(struct cm_frames *frames, u32 far);
u32 cm_frames_at(struct cm_frames *frames, u32 far, size_t place, u32 number);
int cm_frames_upset(struct cm_frames *frames, u32 far, u32 bit);

#endif /* _CM_FRAMES_H */
