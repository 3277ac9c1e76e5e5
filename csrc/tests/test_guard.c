// SPDX-License-Identifier: Apache-2.0
/* Bounds on what a ZMTP peer sends, however its bytes are cut into pieces. */
#include "guard_private.h"
#include "test.h"

static const struct cm_guard_limits limits = { .parts = 3, .bytes = 1000, .topics = 2 };
static const char greeting[64] = "\xff\0\0\0\0\0\0\0\0\x7f\x03\0NULL";
static const char ready[8] = "\4\6\5READY";

/* The cause that ends @size bytes behind a handshake, in pieces of @piece. */
static int cause_of(const char *bytes, size_t size, uint32_t kind, size_t piece)
{
	struct cm_guard_stream stream = { 0 };
	char all[4096];
	int cause = -1;

	memcpy(all, greeting, sizeof(greeting));
	memcpy(all + sizeof(greeting), ready, sizeof(ready));
	memcpy(all + sizeof(greeting) + sizeof(ready), bytes, size);
	size += sizeof(greeting) + sizeof(ready);
	for (size_t at = 0; at < size && cause < 0; at += piece)
		cause = cm_guard_follow(&stream, kind, &limits, (uint8_t *)all + at,
					size - at < piece ? size - at : piece, 1);
	return cause;
}

static void check(const char *bytes, size_t size, uint32_t kind, int cause)
{
	for (size_t piece = 1; piece < 80; piece++)
		CHECK(cause_of(bytes, size, kind, piece) == cause);
	CHECK(cause_of(bytes, size, kind, 4096) == cause);
}

static void parts_are_counted_within_one_message(void)
{
	check("\1\1a\1\1b\0\1c\1\0\1\0\0\0", 16, CM_GUARD_REQUESTS, -1);
	check("\1\0\1\0\1\0\0\0", 8, CM_GUARD_REQUESTS, CM_GUARD_PARTS);
	check("\4\5READY\1\0\4\0\4\0\1\0\0\0", 17, CM_GUARD_REQUESTS,
	      -1); /* commands are not parts */
}

static void bytes_are_counted_over_all_parts_and_when_they_are_announced(void)
{
	char parts[1024] = { 1, (char)255 };

	check("\2\0\0\0\0\0\0\3\xe8", 9, CM_GUARD_REQUESTS, -1);
	check("\2\0\0\0\0\0\0\3\xe9", 9, CM_GUARD_REQUESTS, CM_GUARD_BYTES);
	check("\2\xff\xff\xff\xff\xff\xff\xff\xff", 9, CM_GUARD_REQUESTS, CM_GUARD_BYTES);
	memcpy(parts + 257, "\3\0\0\0\0\0\0\2\xe9", 9); /* 255 and 745 are 1000 */
	check(parts, 266, CM_GUARD_REQUESTS, -1);
	parts[265]++;
	check(parts, 266, CM_GUARD_REQUESTS, CM_GUARD_BYTES);
}

static void subscriptions_at_once_are_counted(void)
{
	check("\0\2\1a\0\2\1b", 8, CM_GUARD_TOPICS, -1);
	check("\0\2\1a\0\2\1b\0\2\1c", 12, CM_GUARD_TOPICS, CM_GUARD_RATE);
}

static int follow(struct cm_guard_stream *stream, const char *bytes, size_t size)
{
	return cm_guard_follow(stream, CM_GUARD_REQUESTS, &limits, (const uint8_t *)bytes, size, 1);
}

static void a_subscription_comes_back_with_time(void)
{
	struct cm_guard_stream stream = { 0 };

	CHECK(follow(&stream, greeting, sizeof(greeting)) < 0);
	CHECK(follow(&stream, ready, sizeof(ready)) < 0);
	for (int64_t second = 1; second < 100; second += 8)
		CHECK(cm_guard_follow(&stream, CM_GUARD_TOPICS, &limits, (const uint8_t *)"\0\1\1",
				      3, second) < 0);
}

static void older_protocols_are_told_apart(void)
{
	struct cm_guard_stream stream = { 0 };
	uint8_t old[64];

	memcpy(old, greeting, sizeof(old));
	old[10] = 1;
	CHECK(cm_guard_follow(&stream, CM_GUARD_REQUESTS, &limits, old, 64, 1) ==
	      CM_GUARD_PROTOCOL);
	stream = (struct cm_guard_stream){ 0 };
	CHECK(cm_guard_follow(&stream, CM_GUARD_REQUESTS, &limits, (const uint8_t *)"\1", 1, 1) ==
	      CM_GUARD_PROTOCOL);
}

static void before_hands_are_shaken_there_are_short_commands_only(void)
{
	struct cm_guard_stream stream = { 0 };

	CHECK(follow(&stream, greeting, sizeof(greeting)) < 0);
	CHECK(follow(&stream, "\0\1a", 3) == CM_GUARD_PROTOCOL);
	stream = (struct cm_guard_stream){ 0 };
	CHECK(follow(&stream, greeting, sizeof(greeting)) < 0);
	CHECK(follow(&stream, "\6\0\0\0\0\0\0\x10\1", 9) == CM_GUARD_BYTES); /* 4097 */
	stream = (struct cm_guard_stream){ 0 };
	CHECK(follow(&stream, "\xff\0\0\0\0\0\0\0\0\x7f\x03\0CURVE", 17) < 0);
	CHECK(follow(&stream, (const char[47]){ 0 }, 47) < 0);
	CHECK(follow(&stream, ready, sizeof(ready)) < 0);
	CHECK(follow(&stream, "\0\1a", 3) == CM_GUARD_PROTOCOL); /* it takes two of them */
	check("\6\0\0\0\0\0\0\x10\1", 9, CM_GUARD_REQUESTS,
	      CM_GUARD_BYTES); /* and later ones, too */
}

/* So that what is told of messages that were taken is the same, whatever frames stand before them there. */
static void what_counts_of_a_message_is_known_when_it_is_whole(void)
{
	struct cm_guard_stream stream = { 0 };
	struct cm_guard_limits many = { .parts = 300, .bytes = 100000 };
	char frame[512] = { 3, [7] = 1 }; /* 256 bytes */

	CHECK(follow(&stream, greeting, sizeof(greeting)) < 0);
	CHECK(follow(&stream, ready, sizeof(ready)) < 0);
	CHECK(follow(&stream, "\1\0", 2) < 0 && follow(&stream, frame, 9 + 256) < 0);
	CHECK(stream.came == 0);
	CHECK(follow(&stream, "\0\xff", 2) < 0 && follow(&stream, frame, 255) < 0);
	CHECK(stream.came == 256); /* the frame of 255 is none that counts */
	for (int part = 0; part < 16; part++)
		CHECK(cm_guard_follow(&stream, CM_GUARD_REQUESTS, &many, (const uint8_t *)"\1\0", 2,
				      1) < 0);
	CHECK(cm_guard_follow(&stream, CM_GUARD_REQUESTS, &many, (const uint8_t *)"\0\0", 2, 1) <
	      0);
	CHECK(stream.came == 256 + 17 * CM_GUARD_SMALL);
}

int main(void)
{
	RUN(parts_are_counted_within_one_message);
	RUN(bytes_are_counted_over_all_parts_and_when_they_are_announced);
	RUN(subscriptions_at_once_are_counted);
	RUN(a_subscription_comes_back_with_time);
	RUN(older_protocols_are_told_apart);
	RUN(before_hands_are_shaken_there_are_short_commands_only);
	RUN(what_counts_of_a_message_is_known_when_it_is_whole);
	return 0;
}
