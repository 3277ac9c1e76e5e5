// SPDX-License-Identifier: GPL-2.0-only
/* KUnit suite of the end of what a channel has under way; no engine, and no memory. */
#include "channel.h"
#include "cm_compat.h"
#include "suites.h"

static void finish(struct cm_active *active, u64 length, int status);

#define dmaengine_synchronize(chan) ((void)(chan))
#define dmaengine_terminate_sync(chan) ((void)(chan))
#define cm_active_finish finish
#define cm_buffer_written(buffer, offset, length) ((void)(buffer))
#define cm_channel_feed(channel, own) ((void)(channel))

#include "../core/stop.c"

#define TOLD_MAX 4

/**
 * struct told - what a client was told, in order
 * @count: results
 * @results: results
 */
struct told {
	int count;
	struct cm_result results[TOLD_MAX];
};

static void tell(void *context, const struct cm_result *result)
{
	struct told *told = context;

	if (told->count < TOLD_MAX)
		told->results[told->count++] = *result;
}

static void finish(struct cm_active *active, u64 length, int status)
{
	struct cm_result result = { .length = length, .status = status, .last = true };

	active->request.done(active->request.context, &result);
}

static struct cm_channel *channel_with(struct kunit *test, struct cm_active *active)
{
	struct cm_channel *channel = kunit_kzalloc(test, sizeof(*channel), GFP_KERNEL);

	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, channel);
	channel->traits = kunit_kzalloc(test, sizeof(*channel->traits), GFP_KERNEL);
	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, channel->traits);
	spin_lock_init(&channel->active_lock);
	INIT_LIST_HEAD(&channel->active);
	list_add_tail(&active->node, &channel->active);
	active->channel = channel;
	active->request.lines = 2;
	active->request.line_bytes = 64;
	active->request.stride = 64;
	active->request.done = tell;
	return channel;
}

static void stop_tells_a_frame_that_is_over_as_itself(struct kunit *test)
{
	struct told told = {};
	struct cm_active active = { .length = 128, .request.context = &told };
	struct cm_channel *channel = channel_with(test, &active);

	channel->over = &active;
	cm_channel_stop(channel);
	KUNIT_ASSERT_EQ(test, told.count, 1);
	KUNIT_EXPECT_EQ(test, told.results[0].status, 0);
	KUNIT_EXPECT_TRUE(test, told.results[0].last);
	KUNIT_EXPECT_TRUE(test, list_empty(&channel->active));
}

/* the frame has arrived, and what asked for it again and again is cancelled */
static void stop_tells_a_repeated_frame_that_is_over_and_the_cancel(struct kunit *test)
{
	struct told told = {};
	struct cm_active active = { .length = 128,
				    .request = { .context = &told, .cyclic = true } };
	struct cm_channel *channel = channel_with(test, &active);

	channel->over = &active;
	cm_channel_stop(channel);
	KUNIT_ASSERT_EQ(test, told.count, 2);
	KUNIT_EXPECT_EQ(test, told.results[0].status, 0);
	KUNIT_EXPECT_FALSE(test, told.results[0].last);
	KUNIT_EXPECT_EQ(test, told.results[0].length, 128ULL);
	KUNIT_EXPECT_EQ(test, told.results[1].status, -ECANCELED);
	KUNIT_EXPECT_TRUE(test, told.results[1].last);
	KUNIT_EXPECT_PTR_EQ(test, channel->over, NULL);
	KUNIT_EXPECT_EQ(test, channel->stats.cancelled, 1ULL);
}

static struct kunit_case stop_cases[] = {
	KUNIT_CASE(stop_tells_a_frame_that_is_over_as_itself),
	KUNIT_CASE(stop_tells_a_repeated_frame_that_is_over_and_the_cancel),
	{}
};

struct kunit_suite cm_stop_suite = {
	.name = "cm_stop",
	.test_cases = stop_cases,
};
