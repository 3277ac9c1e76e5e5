// SPDX-License-Identifier: GPL-2.0-only
/* KUnit suites of /dev/axidma: shapes of frames, and frames in turn on an engine one can hold. */
#include <linux/sched.h>
#include <linux/slab.h>

#include "axidma.h"
#include "suites.h"

#define FRAMES 3
#define SUBMISSIONS 32

/**
 * struct fake_engine - what stands for a channel
 * @video: frames under test
 * @starter: who submits them first, and sees every worker run in between
 * @eager: frames of @starter end at once
 * @refuse: number of the submission that is refused
 * @submitted: submissions so far
 * @order: frames in the order in which they were submitted
 * @ended: submissions that have ended, the oldest first
 */
static struct fake_engine {
	struct axidma_video *video;
	struct task_struct *starter;
	bool eager;
	int refuse;
	int submitted;
	int order[SUBMISSIONS];
	int ended;
} engine;

static int fake_submit(struct cm_channel *channel, const struct cm_request *request);
static int fake_cancel(struct cm_channel *channel);

#define cm_channel_submit fake_submit
#define cm_channel_cancel fake_cancel
#define cm_buffer_put(buffer) ((void)(buffer))
#define axidma_channel_find(file, id, direction) ((struct axidma_channel *)NULL)
#define axidma_region_find(file, address, length, offset) ((struct cm_buffer *)NULL)

#include "../axidma/frame.c"
#include "../axidma/video.c"

static void end_oldest(int status)
{
	struct cm_request *request = &engine.video->slots[engine.order[engine.ended++]].request;
	struct cm_result result = { .status = status, .last = true };

	local_bh_disable();
	request->done(request->context, &result);
	local_bh_enable();
}

static int fake_submit(struct cm_channel *channel, const struct cm_request *request)
{
	struct axidma_slot *slot = request->context;

	if (current == engine.starter)
		flush_work(&engine.video->work);
	if (engine.submitted == engine.refuse || engine.submitted == SUBMISSIONS)
		return -EIO;
	engine.order[engine.submitted++] = slot - engine.video->slots;
	if (current == engine.starter && engine.eager)
		end_oldest(0);
	return 0;
}

static int fake_cancel(struct cm_channel *channel)
{
	while (engine.ended < engine.submitted)
		end_oldest(-ECANCELED);
	return 0;
}

static void frame_is_lines_without_gaps(struct kunit *test)
{
	struct axidma_abi_frame frame = { .height = 48, .width = 64, .depth = 4 };
	struct cm_request request = {};

	KUNIT_EXPECT_EQ(test, axidma_frame_request(&frame, &request), 0);
	KUNIT_EXPECT_EQ(test, request.lines, 48U);
	KUNIT_EXPECT_EQ(test, request.line_bytes, 256U);
	KUNIT_EXPECT_EQ(test, request.stride, 256U);
}

static void frame_that_cannot_be_is_refused(struct kunit *test)
{
	static const struct axidma_abi_frame frames[] = {
		{ 0, 64, 4 }, { 48, 0, 4 }, { 48, 64, 0 }, { -1, 64, 4 }, { 48, -64, 4 },
		{ 48, 64, -4 }, { 48, INT_MIN, 4 }, { 48, 1 << 30, 4 }, { 48, INT_MAX, INT_MAX },
	};
	struct cm_request request = {};
	int i;

	for (i = 0; i < ARRAY_SIZE(frames); i++)
		KUNIT_EXPECT_EQ(test, axidma_frame_request(&frames[i], &request), -EINVAL);
	KUNIT_EXPECT_EQ(test, request.lines, 0U);
}

static struct kunit_case frame_cases[] = {
	KUNIT_CASE(frame_is_lines_without_gaps),
	KUNIT_CASE(frame_that_cannot_be_is_refused),
	{}
};

struct kunit_suite cm_axidma_frame_suite = {
	.name = "cm_axidma_frame",
	.test_cases = frame_cases,
};

static int video_init(struct kunit *test)
{
	struct axidma_video *video = kzalloc(struct_size(video, slots, FRAMES), GFP_KERNEL);
	int i;

	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, video);
	video->count = FRAMES;
	spin_lock_init(&video->lock);
	INIT_WORK(&video->work, video_work);
	for (i = 0; i < FRAMES; i++) {
		video->slots[i].video = video;
		video->slots[i].request.done = slot_done;
		video->slots[i].request.context = &video->slots[i];
	}
	engine = (struct fake_engine){ .video = video, .starter = current, .refuse = -1 };
	return 0;
}

/* frees the frames, as the end of a file does it */
static void video_exit(struct kunit *test)
{
	struct axidma_channel channel = { .video = engine.video };

	axidma_video_end(&channel);
}

static void expect_turns(struct kunit *test, int submitted)
{
	int i;

	flush_work(&engine.video->work);
	KUNIT_ASSERT_EQ(test, engine.submitted, submitted);
	for (i = 0; i < submitted; i++)
		KUNIT_EXPECT_EQ(test, engine.order[i], i % FRAMES);
}

static void frames_are_submitted_in_turn(struct kunit *test)
{
	int i;

	KUNIT_ASSERT_EQ(test, video_begin(engine.video), 0);
	expect_turns(test, FRAMES);
	for (i = 1; i <= 5; i++) {
		end_oldest(0);
		expect_turns(test, FRAMES + i);
	}
	end_oldest(0);
	end_oldest(0);
	expect_turns(test, FRAMES + 7);
}

/* a slow caller: each frame has ended before the next is submitted, and the worker has run */
static void every_frame_comes_once_before_any_comes_twice(struct kunit *test)
{
	engine.eager = true;
	KUNIT_ASSERT_EQ(test, video_begin(engine.video), 0);
	engine.eager = false;
	expect_turns(test, 2 * FRAMES);
}

static void frames_stop_at_an_error(struct kunit *test)
{
	KUNIT_ASSERT_EQ(test, video_begin(engine.video), 0);
	end_oldest(-EIO);
	end_oldest(0);
	expect_turns(test, FRAMES);
}

static void an_error_before_all_are_submitted_stops_them(struct kunit *test)
{
	engine.eager = true;
	engine.refuse = 2;
	KUNIT_EXPECT_EQ(test, video_begin(engine.video), -EIO);
	expect_turns(test, 2);
}

static void nothing_is_submitted_after_the_end(struct kunit *test)
{
	struct axidma_channel channel = { .video = engine.video };

	KUNIT_ASSERT_EQ(test, video_begin(engine.video), 0);
	end_oldest(0);
	/* the worker may have run or not; what is under way ends as cancelled */
	axidma_video_end(&channel);
	KUNIT_EXPECT_EQ(test, engine.ended, engine.submitted);
	KUNIT_EXPECT_LE(test, engine.submitted, FRAMES + 1);
	KUNIT_EXPECT_PTR_EQ(test, channel.video, NULL);
	engine.video = NULL;
}

static struct kunit_case video_cases[] = {
	KUNIT_CASE(frames_are_submitted_in_turn),
	KUNIT_CASE(every_frame_comes_once_before_any_comes_twice),
	KUNIT_CASE(frames_stop_at_an_error),
	KUNIT_CASE(an_error_before_all_are_submitted_stops_them),
	KUNIT_CASE(nothing_is_submitted_after_the_end),
	{}
};

struct kunit_suite cm_axidma_video_suite = {
	.name = "cm_axidma_video",
	.init = video_init,
	.exit = video_exit,
	.test_cases = video_cases,
};
