// SPDX-License-Identifier: Apache-2.0
#include "bitstream.h"
#include "test.h"

#include <stdint.h>

#define EVENTS 16

/* A stream of one frame word by word, CRC included; as a .bit holds it. */
static const uint32_t words[] = {
	0xFFFFFFFF, 0x000000BB, 0x11220044, 0xAA995566, 0x20000000,
	0x30008001, 0x00000007, /* CMD = RCRC */
	0x30008001, 0x0000000B, /* CMD = SHUTDOWN */
	0x30000001, 0x5DA98E32, /* its CRC, from a file of Vivado */
	0x30002001, 0x00400D00, /* FAR */
	0x30004000, 0x50000003, 0x00000001, 0x00000002, 0x00000003, /* FDRI */
	0x30008001, 0x0000000D,					    /* CMD = DESYNC */
	0x20000000,
};

#define WORDS (sizeof(words) / sizeof(words[0]))

static void pack(uint8_t *to, int swapped)
{
	for (size_t i = 0; i < WORDS; i++)
		for (int byte = 0; byte < 4; byte++)
			to[4 * i + (size_t)byte] =
				(uint8_t)(words[i] >> 8 * (swapped ? byte : 3 - byte));
}

static size_t feed_all(struct cm_config_port *port, const uint8_t *data, size_t step, int swapped,
		       struct cm_config_event *events)
{
	size_t total = 0;

	for (size_t done = 0; done < WORDS;) {
		const size_t count = WORDS - done < step ? WORDS - done : step;
		size_t made = 0;

		done += cm_config_feed(port, data + 4 * done, count, swapped, events + total,
				       EVENTS - total, &made);
		total += made;
	}
	return total;
}

static void test_stream_gives_its_events(void)
{
	uint8_t data[4 * WORDS];
	struct cm_config_event events[EVENTS];
	struct cm_config_port port;
	const uint32_t expected[] = { CM_CONFIG_SYNC, CM_CONFIG_WRITE,	CM_CONFIG_WRITE,
				      CM_CONFIG_CRC,  CM_CONFIG_FRAMES, CM_CONFIG_DESYNC };

	pack(data, 0);
	cm_config_reset(&port, 0);
	CHECK(feed_all(&port, data, WORDS, 0, events) == 6);
	for (size_t i = 0; i < 6; i++)
		CHECK(events[i].kind == expected[i]);
	CHECK(events[3].value == events[3].count);
	CHECK(events[4].value == 0x00400D00 && events[4].count == 3 && events[4].word == 13);
	CHECK(cm_config_phase(&port) == 0);
}

static void test_pieces_and_byte_orders_give_the_same_events(void)
{
	uint8_t data[4 * WORDS];
	struct cm_config_event whole[EVENTS], pieces[EVENTS];
	struct cm_config_port port;

	memset(whole, 0, sizeof(whole));
	pack(data, 0);
	cm_config_reset(&port, 0);
	const size_t made = feed_all(&port, data, WORDS, 0, whole);

	for (int swapped = 0; swapped < 2; swapped++) {
		for (size_t step = 1; step < WORDS; step++) {
			pack(data, swapped);
			cm_config_reset(&port, (uint32_t)swapped);
			CHECK(feed_all(&port, data, step, swapped, pieces) == made);
			for (size_t i = 0; i < made; i++)
				CHECK(memcmp(&pieces[i], &whole[i], sizeof(whole[i])) == 0);
		}
	}
}

static void test_capture_stops_behind_each_run_and_keeps_its_words(void)
{
	uint8_t data[4 * WORDS];
	struct cm_config_event events[EVENTS];
	struct cm_config_port port;
	size_t made;

	pack(data, 0);
	cm_config_reset(&port, 1);
	CHECK(cm_config_feed(&port, data, WORDS, 0, events, EVENTS, &made) == 18);
	CHECK(events[made - 1].kind == CM_CONFIG_FRAMES);
	CHECK(port.head_count == 3 && port.head[0] == 1 && port.head[2] == 3);
}

static void test_full_event_array_stops_and_goes_on(void)
{
	uint8_t data[4 * WORDS];
	struct cm_config_event events[2];
	struct cm_config_port port;
	size_t done = 0, total = 0, made;

	pack(data, 0);
	cm_config_reset(&port, 0);
	while (done < WORDS) {
		done += cm_config_feed(&port, data + 4 * done, WORDS - done, 0, events, 2, &made);
		CHECK(made <= 2);
		total += made;
	}
	CHECK(total == 6);
}

static void test_fault_swallows_the_rest(void)
{
	const uint8_t data[] = { 0xAA, 0x99, 0x55, 0x66, 0xE0, 0, 0, 0, 0xAA, 0x99, 0x55, 0x66 };
	struct cm_config_event events[EVENTS];
	struct cm_config_port port;
	size_t made;

	cm_config_reset(&port, 0);
	CHECK(cm_config_feed(&port, data, 3, 0, events, EVENTS, &made) == 3);
	CHECK(made == 2 && events[1].kind == CM_CONFIG_FAULT && events[1].reg == CM_FAULT_TYPE);
	CHECK(cm_config_phase(&port) == 3);
}

static void test_swap_in_place(void)
{
	uint8_t data[] = { 1, 2, 3, 4, 5, 6, 7, 8 };
	const uint8_t expected[] = { 4, 3, 2, 1, 8, 7, 6, 5 };

	cm_config_swap(data, data, 2);
	CHECK(memcmp(data, expected, sizeof(data)) == 0);
}

int main(void)
{
	RUN(test_stream_gives_its_events);
	RUN(test_pieces_and_byte_orders_give_the_same_events);
	RUN(test_capture_stops_behind_each_run_and_keeps_its_words);
	RUN(test_full_event_array_stops_and_goes_on);
	RUN(test_fault_swallows_the_rest);
	RUN(test_swap_in_place);
	return 0;
}
