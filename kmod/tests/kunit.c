// SPDX-License-Identifier: GPL-2.0-only
/* KUnit suites of what needs no device: completions, verdicts, packets, pictures. */
#include <linux/module.h>

#include "suites.h"

#include "../core/queue.c"
#include "../icap/verdict.c"
#include "../plsim/configport.c"
#include "../plsim/frames.c"
#include "../plsim/source.c"

#define DEPTH 4

struct queue_fixture {
	struct cm_queue queue;
	struct cm_dma_completion ring[DEPTH + 1];
};

static int queue_init(struct kunit *test)
{
	struct queue_fixture *fixture = kunit_kzalloc(test, sizeof(*fixture), GFP_KERNEL);

	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, fixture);
	cm_queue_init(&fixture->queue, fixture->ring, DEPTH + 1);
	test->priv = fixture;
	return 0;
}

static struct cm_queue *queue_of(struct kunit *test)
{
	return &((struct queue_fixture *)test->priv)->queue;
}

static struct cm_dma_completion take(struct kunit *test, struct cm_queue *queue)
{
	struct cm_dma_completion completion = {};
	u64 index;

	KUNIT_ASSERT_TRUE(test, cm_queue_peek(queue, &index, &completion));
	cm_queue_drop(queue, index);
	return completion;
}

static void push_period(struct cm_queue *queue, u64 cookie, u32 limit)
{
	struct cm_dma_completion completion = { .cookie = cookie };

	cm_queue_push_cyclic(queue, &completion, limit);
}

static void queue_takes_as_many_as_its_depth(struct kunit *test)
{
	struct cm_queue *queue = queue_of(test);
	int i;

	for (i = 0; i < DEPTH; i++)
		KUNIT_EXPECT_EQ(test, cm_queue_reserve(queue), 0);
	KUNIT_EXPECT_EQ(test, cm_queue_reserve(queue), -EBUSY);
	cm_queue_unreserve(queue);
	KUNIT_EXPECT_EQ(test, cm_queue_reserve(queue), 0);
}

static void queue_keeps_a_place_until_it_was_read(struct kunit *test)
{
	struct cm_queue *queue = queue_of(test);
	struct cm_dma_completion completion = { .cookie = 7 };
	int i;

	for (i = 0; i < DEPTH; i++) {
		KUNIT_EXPECT_EQ(test, cm_queue_reserve(queue), 0);
		cm_queue_push(queue, &completion);
	}
	KUNIT_EXPECT_EQ(test, cm_queue_reserve(queue), -EBUSY);
	KUNIT_EXPECT_EQ(test, take(test, queue).sequence, 0ULL);
	KUNIT_EXPECT_EQ(test, cm_queue_reserve(queue), 0);
}

static void queue_numbers_completions_in_order(struct kunit *test)
{
	struct cm_queue *queue = queue_of(test);
	u64 i;

	for (i = 0; i < 20; i++) {
		struct cm_dma_completion completion = { .cookie = 100 + i }, read;

		KUNIT_ASSERT_EQ(test, cm_queue_reserve(queue), 0);
		cm_queue_push(queue, &completion);
		read = take(test, queue);
		KUNIT_EXPECT_EQ(test, read.sequence, i);
		KUNIT_EXPECT_EQ(test, read.cookie, 100 + i);
		KUNIT_EXPECT_EQ(test, read.flags, 0U);
	}
	KUNIT_EXPECT_EQ(test, cm_queue_count(queue), 0U);
}

static void queue_loses_the_oldest_period_and_says_so(struct kunit *test)
{
	struct cm_queue *queue = queue_of(test);
	struct cm_dma_completion read;
	u64 i;

	for (i = 0; i < 10; i++)
		push_period(queue, i, 3);
	KUNIT_EXPECT_EQ(test, cm_queue_count(queue), 3U);
	read = take(test, queue);
	KUNIT_EXPECT_EQ(test, read.sequence, 7ULL);
	KUNIT_EXPECT_EQ(test, read.flags, CM_DMA_COMPLETION_OVERRUN);
	read = take(test, queue);
	KUNIT_EXPECT_EQ(test, read.sequence, 8ULL);
	KUNIT_EXPECT_EQ(test, read.flags, 0U);
}

static void queue_with_one_period_keeps_the_newest(struct kunit *test)
{
	struct cm_queue *queue = queue_of(test);
	struct cm_dma_completion read;

	push_period(queue, 1, 1);
	push_period(queue, 2, 1);
	read = take(test, queue);
	KUNIT_EXPECT_EQ(test, read.cookie, 2ULL);
	KUNIT_EXPECT_EQ(test, read.flags, CM_DMA_COMPLETION_OVERRUN);
}

static void queue_has_room_for_the_end_of_a_cyclic_transfer(struct kunit *test)
{
	struct cm_queue *queue = queue_of(test);
	struct cm_dma_completion end = { .cookie = 99, .status = -ECANCELED };
	u64 i;

	KUNIT_ASSERT_EQ(test, cm_queue_reserve(queue), 0);
	for (i = 0; i < 10; i++)
		push_period(queue, i, 100);
	cm_queue_push(queue, &end);
	KUNIT_EXPECT_EQ(test, cm_queue_count(queue), DEPTH + 1U);
	for (i = 0; i < DEPTH; i++)
		KUNIT_EXPECT_EQ(test, take(test, queue).status, 0);
	KUNIT_EXPECT_EQ(test, take(test, queue).status, -ECANCELED);
}

static void queue_does_not_drop_what_was_not_read(struct kunit *test)
{
	struct cm_queue *queue = queue_of(test);
	struct cm_dma_completion read;
	u64 index;

	push_period(queue, 1, 1);
	KUNIT_ASSERT_TRUE(test, cm_queue_peek(queue, &index, &read));
	push_period(queue, 2, 1);
	cm_queue_drop(queue, index);
	KUNIT_EXPECT_EQ(test, take(test, queue).cookie, 2ULL);
}

static struct kunit_case queue_cases[] = {
	KUNIT_CASE(queue_takes_as_many_as_its_depth),
	KUNIT_CASE(queue_keeps_a_place_until_it_was_read),
	KUNIT_CASE(queue_numbers_completions_in_order),
	KUNIT_CASE(queue_loses_the_oldest_period_and_says_so),
	KUNIT_CASE(queue_with_one_period_keeps_the_newest),
	KUNIT_CASE(queue_has_room_for_the_end_of_a_cyclic_transfer),
	KUNIT_CASE(queue_does_not_drop_what_was_not_read),
	{}
};

static struct kunit_suite queue_suite = {
	.name = "cm_queue",
	.init = queue_init,
	.test_cases = queue_cases,
};

static void verdict_names_the_cause(struct kunit *test)
{
	KUNIT_EXPECT_EQ(test, cm_icap_verdict(0), 0);
	KUNIT_EXPECT_EQ(test, cm_icap_verdict(CM_ICAP_ERR_CRC), -EILSEQ);
	KUNIT_EXPECT_EQ(test, cm_icap_verdict(CM_ICAP_ERR_ID), -ENODEV);
	KUNIT_EXPECT_EQ(test, cm_icap_verdict(CM_ICAP_ERR_DMA), -EIO);
	KUNIT_EXPECT_EQ(test, cm_icap_verdict(CM_ICAP_ERR_TIMEOUT), -ETIMEDOUT);
	KUNIT_EXPECT_EQ(test, cm_icap_verdict(CM_ICAP_ERR_NOSYNC), -EIO);
	KUNIT_EXPECT_EQ(test, cm_icap_verdict(CM_ICAP_ERR_CRC | CM_ICAP_ERR_TIMEOUT), -EILSEQ);
}

static struct kunit_case verdict_cases[] = {
	KUNIT_CASE(verdict_names_the_cause),
	{}
};

static struct kunit_suite verdict_suite = {
	.name = "cm_icap_verdict",
	.test_cases = verdict_cases,
};

#define TEST_IDCODE 0x03727093

static void feed(struct cm_configport *port, const u32 *words, size_t count)
{
	size_t i;

	cm_configport_begin(port);
	for (i = 0; i < count; i++)
		cm_configport_word(port, words[i]);
}

static void port_needs_a_sync_word(struct kunit *test)
{
	static const u32 words[] = { 0xFFFFFFFF, 0x20000000, 0x30018001, 0x12345678 };
	struct cm_configport port = { .idcode = TEST_IDCODE };

	feed(&port, words, ARRAY_SIZE(words));
	KUNIT_EXPECT_EQ(test, cm_configport_end(&port), CM_ICAP_ERR_NOSYNC);
}

static void port_compares_the_idcode_without_revision(struct kunit *test)
{
	u32 words[] = { SYNC_WORD, 0x30018001, TEST_IDCODE | 0xF0000000, 0x30008001, CMD_DESYNC };
	struct cm_configport port = { .idcode = TEST_IDCODE };

	feed(&port, words, ARRAY_SIZE(words));
	KUNIT_EXPECT_EQ(test, cm_configport_end(&port), 0U);
	words[2] = TEST_IDCODE ^ 0x1000;
	feed(&port, words, ARRAY_SIZE(words));
	KUNIT_EXPECT_EQ(test, cm_configport_end(&port), CM_ICAP_ERR_ID);
}

static void port_compares_the_crc(struct kunit *test)
{
	u32 words[] = { SYNC_WORD, 0x30008001, CMD_RCRC, 0x30004000, 0x50000002, 1, 2,
			0x30000001, 0, 0x30008001, CMD_DESYNC };
	struct cm_configport port = {};

	words[8] = cm_configport_crc(cm_configport_crc(0, REG_FDRI, 1), REG_FDRI, 2);
	feed(&port, words, ARRAY_SIZE(words));
	KUNIT_EXPECT_EQ(test, cm_configport_end(&port), 0U);
	KUNIT_EXPECT_EQ(test, port.frame_words, 2ULL);
	KUNIT_EXPECT_EQ(test, port.crc_checks, 1U);
	words[6] ^= 1;
	feed(&port, words, ARRAY_SIZE(words));
	KUNIT_EXPECT_EQ(test, cm_configport_end(&port), CM_ICAP_ERR_CRC);
}

static void port_waits_for_the_rest_of_a_packet(struct kunit *test)
{
	static const u32 words[] = { SYNC_WORD, 0x30004000, 0x50000010, 1, 2, 3 };
	static const u32 good[] = { SYNC_WORD, 0x30008001, CMD_DESYNC };
	struct cm_configport port = {};

	feed(&port, words, ARRAY_SIZE(words));
	KUNIT_EXPECT_EQ(test, cm_configport_end(&port), CM_ICAP_ERR_TIMEOUT);
	feed(&port, good, ARRAY_SIZE(good));
	KUNIT_EXPECT_EQ(test, cm_configport_end(&port), 0U);
	KUNIT_EXPECT_FALSE(test, port.synced);
}

static void port_goes_on_after_desync(struct kunit *test)
{
	static const u32 words[] = { SYNC_WORD, 0x30008001, CMD_DESYNC, 0xFFFFFFFF, SYNC_WORD,
				     0x30004001, 5, 0x30008001, CMD_DESYNC };
	struct cm_configport port = {};

	feed(&port, words, ARRAY_SIZE(words));
	KUNIT_EXPECT_EQ(test, cm_configport_end(&port), 0U);
	KUNIT_EXPECT_EQ(test, port.frame_words, 1ULL);
}

static void put_frames(struct cm_configport *port, u32 far, u32 first, u32 count)
{
	const u32 head[] = { SYNC_WORD, 0x30002001, far, 0x30004000,
			     0x50000000 | count * CM_FRAME_WORDS };
	u32 i;

	feed(port, head, ARRAY_SIZE(head));
	for (i = 0; i < count * CM_FRAME_WORDS; i++)
		cm_configport_word(port, first + i / CM_FRAME_WORDS);
	cm_configport_word(port, 0x30008001);
	cm_configport_word(port, CMD_DESYNC);
}

/* the first word of a frame, behind the frame of padding */
static u32 get_frame(struct cm_configport *port, u32 far)
{
	const u32 ask[] = { SYNC_WORD, 0x30008001, CMD_RCFG, 0x30002001, far, 0x28006000,
			    0x48000000 | 2 * CM_FRAME_WORDS, 0x20000000 };
	static const u32 closing[] = { 0x30008001, CMD_DESYNC };
	u32 word = 0;
	u32 i;

	feed(port, ask, ARRAY_SIZE(ask));
	for (i = 0; i <= CM_FRAME_WORDS; i++)
		word = cm_configport_answer(port);
	feed(port, closing, ARRAY_SIZE(closing));
	return word;
}

static void port_keeps_frames(struct kunit *test)
{
	static const u32 order[] = { 4, 5, CM_NO_FRAME, 9 };
	struct cm_frames *frames = kunit_kzalloc(test, sizeof(*frames), GFP_KERNEL);
	struct cm_configport port = { .frames = frames };

	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, frames);
	cm_frames_init(frames);
	put_frames(&port, 4, 100, 4);
	KUNIT_EXPECT_EQ(test, get_frame(&port, 4), 100U);
	KUNIT_EXPECT_EQ(test, get_frame(&port, 6), 102U);
	/* the last one stayed in the buffer */
	KUNIT_EXPECT_EQ(test, get_frame(&port, 7), 0U);
	KUNIT_EXPECT_EQ(test, cm_configport_end(&port), 0U);
	KUNIT_EXPECT_FALSE(test, port.synced);
	KUNIT_EXPECT_EQ(test, cm_frames_upset(frames, 6, 3), 0);
	KUNIT_EXPECT_EQ(test, get_frame(&port, 6), 102U ^ 8);
	KUNIT_EXPECT_EQ(test, cm_frames_upset(frames, 7, 3), -ENOENT);
	KUNIT_EXPECT_EQ(test, cm_frames_upset(frames, 6, 32 * CM_FRAME_WORDS), -EINVAL);
	frames->order = kmemdup(order, sizeof(order), GFP_KERNEL);
	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, frames->order);
	frames->order_count = ARRAY_SIZE(order);
	put_frames(&port, 4, 200, 5);
	KUNIT_EXPECT_EQ(test, get_frame(&port, 5), 201U);
	KUNIT_EXPECT_EQ(test, get_frame(&port, 9), 203U);
	KUNIT_EXPECT_EQ(test, frames->count, 4U);
	cm_frames_destroy(frames);
}

static struct kunit_case port_cases[] = {
	KUNIT_CASE(port_needs_a_sync_word),
	KUNIT_CASE(port_compares_the_idcode_without_revision),
	KUNIT_CASE(port_compares_the_crc),
	KUNIT_CASE(port_waits_for_the_rest_of_a_packet),
	KUNIT_CASE(port_goes_on_after_desync),
	KUNIT_CASE(port_keeps_frames),
	{}
};

static struct kunit_suite port_suite = {
	.name = "cm_configport",
	.test_cases = port_cases,
};

static void pattern_counts_up_from_the_frame(struct kunit *test)
{
	static const u8 wanted[] = { 0xff, 0xff, 0, 0, 0, 0, 1, 0, 0x01, 0, 0x5a, 0x5a };
	u8 data[12] __aligned(4);

	memset(data, 0x5a, sizeof(data));
	plsim_pattern(data, 10, 0xffff);
	KUNIT_EXPECT_EQ(test, memcmp(data, wanted, sizeof(wanted)), 0);
}

static void frame_on_demand_has_the_next_number(struct kunit *test)
{
	struct plsim_chan chan = { .frame_length = 8 };
	struct plsim_packet *packet;
	u32 i;

	for (i = 0; i < 3; i++) {
		packet = plsim_source_frame(&chan);
		KUNIT_ASSERT_NOT_ERR_OR_NULL(test, packet);
		KUNIT_EXPECT_EQ(test, packet->length, (size_t)8);
		KUNIT_EXPECT_EQ(test, le32_to_cpup((__le32 *)packet->data), i);
		kvfree(packet);
	}
	KUNIT_EXPECT_EQ(test, chan.frames, 3ULL);
	KUNIT_EXPECT_EQ(test, chan.lost, 0ULL);
}

static void frames_nobody_took_in_time_are_lost(struct kunit *test)
{
	struct plsim_chan chan = { .frame_length = 8, .interval_us = 1000000 };
	struct plsim_packet *packet;

	/* five and a half intervals late */
	chan.next_frame = ktime_get_ns() - 5500000000ULL;
	packet = plsim_source_frame(&chan);
	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, packet);
	KUNIT_EXPECT_EQ(test, le32_to_cpup((__le32 *)packet->data), 5U);
	KUNIT_EXPECT_EQ(test, chan.lost, 5ULL);
	kvfree(packet);
	/* the next one is not due yet */
	KUNIT_EXPECT_PTR_EQ(test, plsim_source_frame(&chan), NULL);
	KUNIT_EXPECT_EQ(test, chan.frames, 6ULL);
}

static struct kunit_case source_cases[] = {
	KUNIT_CASE(pattern_counts_up_from_the_frame),
	KUNIT_CASE(frame_on_demand_has_the_next_number),
	KUNIT_CASE(frames_nobody_took_in_time_are_lost),
	{}
};

static struct kunit_suite source_suite = {
	.name = "cm_source",
	.test_cases = source_cases,
};

kunit_test_suites(&queue_suite, &verdict_suite, &port_suite, &source_suite, &cm_request_suite,
		  &cm_address_suite, &cm_axidma_frame_suite, &cm_axidma_video_suite,
		  &cm_engine_suite, &cm_stop_suite, &cm_polled_suite, &cm_axi_intc_suite);

MODULE_DESCRIPTION("KUnit suites of the configuration manager's modules");
MODULE_LICENSE("GPL");
