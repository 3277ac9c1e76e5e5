// SPDX-License-Identifier: GPL-2.0-only
/* The configuration memory behind a port: what loads leave in it, and what turns it over. */
#include <linux/bits.h>
#include <linux/slab.h>
#include <linux/string.h>

#include "frames.h"

/* more than any 7-series device has */
#define FRAMES_MAX 131072

/**
 * cm_frames_init() - nothing is configured
 * @frames: memory
 */
void cm_frames_init(struct cm_frames *frames)
{
	mutex_init(&frames->lock);
	xa_init(&frames->held);
	frames->count = 0;
	frames->order = NULL;
	frames->order_count = 0;
}

/**
 * cm_frames_destroy() - free all
 * @frames: memory; nobody uses it any more
 */
void cm_frames_destroy(struct cm_frames *frames)
{
	unsigned long far;
	u32 *words;

	xa_for_each(&frames->held, far, words)
		kfree(words);
	xa_destroy(&frames->held);
	kvfree(frames->order);
	mutex_destroy(&frames->lock);
}

static u32 *frame_of(struct cm_frames *frames, u32 far)
{
	u32 *words = xa_load(&frames->held, far);

	if (words || frames->count == FRAMES_MAX)
		return words;
	words = kcalloc(CM_FRAME_WORDS, sizeof(*words), GFP_KERNEL);
	if (!words)
		return NULL;
	if (xa_err(xa_store(&frames->held, far, words, GFP_KERNEL))) {
		kfree(words);
		return NULL;
	}
	frames->count++;
	return words;
}

/**
 * cm_frames_store() - a frame is written
 * @frames: memory
 * @far: its address; CM_NO_FRAME for one that has no place
 * @words: CM_FRAME_WORDS words
 */
void cm_frames_store(struct cm_frames *frames, u32 far, const u32 *words)
{
	u32 *there;

	if (far == CM_NO_FRAME)
		return;
	mutex_lock(&frames->lock);
	there = frame_of(frames, far);
	if (there)
		memcpy(there, words, CM_FRAME_WORDS * sizeof(*words));
	mutex_unlock(&frames->lock);
}

/**
 * cm_frames_fetch() - a frame is read
 * @frames: memory
 * @far: its address
 * @words: filled in with CM_FRAME_WORDS words; 0 where nothing was written
 */
void cm_frames_fetch(struct cm_frames *frames, u32 far, u32 *words)
{
	const u32 *there;

	mutex_lock(&frames->lock);
	there = far == CM_NO_FRAME ? NULL : xa_load(&frames->held, far);
	if (there)
		memcpy(words, there, CM_FRAME_WORDS * sizeof(*words));
	else
		memset(words, 0, CM_FRAME_WORDS * sizeof(*words));
	mutex_unlock(&frames->lock);
}

/**
 * cm_frames_place() - where the device counts from
 * @frames: memory
 * @far: address that was written to FAR
 *
 * Return: its place in the device's order; SIZE_MAX where it is not in it.
 */
size_t cm_frames_place(struct cm_frames *frames, u32 far)
{
	size_t place = SIZE_MAX;
	size_t i;

	mutex_lock(&frames->lock);
	for (i = 0; i < frames->order_count && place == SIZE_MAX; i++) {
		if (frames->order[i] == far)
			place = i;
	}
	mutex_unlock(&frames->lock);
	return place;
}

/**
 * cm_frames_at() - the address of a frame of a run
 * @frames: memory
 * @far: where the run begins
 * @place: of @far, from cm_frames_place()
 * @number: of the frame in the run, from 0
 *
 * Return: its address, or CM_NO_FRAME.
 */
u32 cm_frames_at(struct cm_frames *frames, u32 far, size_t place, u32 number)
{
	u32 address = CM_NO_FRAME;

	mutex_lock(&frames->lock);
	if (!frames->order)
		address = far + number;
	else if (place < frames->order_count && number < frames->order_count - place)
		address = frames->order[place + number];
	mutex_unlock(&frames->lock);
	return address;
}

/**
 * cm_frames_upset() - a bit of a frame turns over
 * @frames: memory
 * @far: frame address
 * @bit: 32 times the word, and the bit in it
 *
 * Return: 0, -ENOENT for a frame that was not written, -EINVAL for a bit that
 * frames do not have.
 */
int cm_frames_upset(struct cm_frames *frames, u32 far, u32 bit)
{
	u32 *words;

	if (bit >= 32 * CM_FRAME_WORDS)
		return -EINVAL;
	mutex_lock(&frames->lock);
	words = xa_load(&frames->held, far);
	if (words)
		words[bit / 32] ^= BIT(bit % 32);
	mutex_unlock(&frames->lock);
	return words ? 0 : -ENOENT;
}
