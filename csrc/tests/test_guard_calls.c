// SPDX-License-Identifier: Apache-2.0
/* What libzmq calls, on real connections: with and without CURVE, and from several threads. */
#include <pthread.h>
#include <stdatomic.h>
#include <sys/un.h>

#include "guard_private.h"
#include "test.h"

#define LARGE 6000 /* bytes of a frame that counts as large */
#define SEALED 33  /* of them, CURVE's own */
#define PATIENCE 10
#define FRAMES 32768

static const struct cm_guard_limits limits = {
	.connections = 64, .parts = 3, .bytes = 8000, .topics = 8
};

/* A listener of ours, and who connects to it. */
struct pair {
	int listener;
	int client;
	int server;
};

static int connected_to(const struct sockaddr_un *address, socklen_t length)
{
	int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);

	CHECK(fd >= 0);
	CHECK(!connect(fd, (const struct sockaddr *)address, length));
	return fd;
}

static int listening(struct sockaddr_un *address, socklen_t *length)
{
	int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);

	CHECK(fd >= 0);
	*address = (struct sockaddr_un){ .sun_family = AF_UNIX };
	*length = sizeof(sa_family_t); /* a name that the kernel makes up */
	CHECK(!bind(fd, (struct sockaddr *)address, *length));
	*length = sizeof(*address);
	CHECK(!getsockname(fd, (struct sockaddr *)address, length));
	cm_guard_expect(CM_GUARD_REQUESTS);
	CHECK(!cm_guard_listen(fd, 16));
	cm_guard_expect(CM_GUARD_NONE);
	return fd;
}

static struct pair paired(const char *mechanism)
{
	uint8_t greeting[64] = { 0xff, [9] = 0x7f, [10] = 3 };
	struct sockaddr_un address;
	socklen_t length;
	struct pair pair = { .listener = listening(&address, &length) };
	uint8_t got[64];

	cm_guard_limit(&limits);
	memcpy(greeting + 12, mechanism, strlen(mechanism));
	pair.client = connected_to(&address, length);
	pair.server = cm_guard_accept4(pair.listener, NULL, NULL, SOCK_CLOEXEC | SOCK_NONBLOCK);
	CHECK(pair.server >= 0);
	CHECK(write(pair.client, greeting, sizeof(greeting)) == sizeof(greeting));
	CHECK(cm_guard_recv(pair.server, got, sizeof(got), 0) == sizeof(got));
	return pair;
}

static void part(struct pair *pair)
{
	close(pair->client);
	CHECK(!cm_guard_close(pair->server));
	CHECK(!cm_guard_close(pair->listener));
}

static uint64_t refused(int cause)
{
	struct cm_guard_counts now;

	cm_guard_count(&now);
	return now.refused[cause];
}

/* A frame of @size bytes, sent and read to its end. */
static ssize_t pass(struct pair *pair, uint8_t flags, uint32_t size)
{
	uint8_t head[9] = { flags | 2, [5] = (uint8_t)(size >> 24), (uint8_t)(size >> 16),
			    (uint8_t)(size >> 8), (uint8_t)size };
	uint8_t body[LARGE + SEALED];
	ssize_t got = 0;

	CHECK(size <= sizeof(body));
	memset(body, 0, size);
	CHECK(write(pair->client, head, sizeof(head)) == sizeof(head));
	CHECK(write(pair->client, body, size) == (ssize_t)size);
	for (uint32_t left = size + (uint32_t)sizeof(head); left; left -= (uint32_t)got) {
		got = cm_guard_recv(pair->server, body, left < sizeof(body) ? left : sizeof(body),
				    0);
		if (got < 0)
			return got;
	}
	return (ssize_t)size;
}

static void drained(struct pair *pair)
{
	uint8_t rest[16384];

	while (recv(pair->server, rest, sizeof(rest), MSG_DONTWAIT) > 0)
		;
}

static void a_connection_is_read_no_further_until_what_waits_was_taken(const char *mechanism,
								       uint32_t extra)
{
	struct pair pair = paired(mechanism);

	for (int frame = 0; frame < 3; frame++)
		CHECK(pass(&pair, 0, LARGE + extra) > 0);
	CHECK_ERRNO(pass(&pair, 0, LARGE + extra), EAGAIN); /* 18,000 of 16,000 */
	drained(&pair);
	cm_guard_taken(pair.server, LARGE);
	CHECK(pass(&pair, 0, LARGE + extra) > 0);
	CHECK_ERRNO(pass(&pair, 0, 1), EAGAIN);
	part(&pair);
}

static void what_is_not_encrypted_waits_as_long_as_it_takes(void)
{
	a_connection_is_read_no_further_until_what_waits_was_taken("NULL", 0);
}

static void with_keys_the_seal_is_no_part_of_what_waits(void)
{
	a_connection_is_read_no_further_until_what_waits_was_taken("CURVE", SEALED);
}

static void an_encrypted_message_without_end_is_held_back_and_then_ended(void)
{
	struct pair pair = paired("CURVE");
	uint64_t before = refused(CM_GUARD_BYTES);

	for (int frame = 0; frame < 3; frame++)
		CHECK(pass(&pair, 0, LARGE + SEALED) > 0);
	CHECK_ERRNO(pass(&pair, 0, 1), EAGAIN);
	CHECK(refused(CM_GUARD_BYTES) == before);
	cm_guard_place(pair.server)->held_s -= PATIENCE + 1; /* as if that had passed */
	CHECK_ERRNO(pass(&pair, 0, 1), ECONNRESET);
	CHECK(refused(CM_GUARD_BYTES) == before + 1);
	part(&pair);
}

static void encrypted_frames_that_nobody_takes_are_parts_of_one_message(void)
{
	struct pair pair = paired("CURVE");
	uint64_t before = refused(CM_GUARD_PARTS);

	for (int frame = 0; frame < FRAMES; frame++)
		CHECK(pass(&pair, 0, 1) > 0); /* each looks like a message of its own */
	cm_guard_taken(pair.server, 0);
	for (int frame = 0; frame < FRAMES; frame++)
		CHECK(pass(&pair, 0, 1) > 0);
	CHECK_ERRNO(pass(&pair, 0, 1), ECONNRESET);
	CHECK(refused(CM_GUARD_PARTS) == before + 1);
	part(&pair);
}

static void without_keys_parts_are_counted_as_they_are(void)
{
	struct pair pair = paired("NULL");

	for (int message = 0; message < FRAMES + 10; message++)
		CHECK(pass(&pair, 0, 1) > 0);
	for (int more = 0; more < 3; more++)
		CHECK(pass(&pair, 1, 1) > 0);
	CHECK_ERRNO(pass(&pair, 0, 1), ECONNRESET);
	part(&pair);
}

static void an_encrypted_frame_is_as_long_as_a_message_may_be(void)
{
	struct pair pair = paired("CURVE");
	uint64_t before = refused(CM_GUARD_BYTES);
	static const uint8_t head[9] = { 2, [7] = 0x1f, 0x41 }; /* 8001 */
	uint8_t got[9];

	CHECK(write(pair.client, head, sizeof(head)) == sizeof(head));
	CHECK_ERRNO(cm_guard_recv(pair.server, got, sizeof(got), 0), ECONNRESET);
	CHECK(refused(CM_GUARD_BYTES) == before + 1);
	part(&pair);
}

/* Another connection has the descriptor by now: it is not held back for what the one before sent. */
static void what_is_taken_late_holds_nobody_else_back(void)
{
	struct pair pair = paired("NULL");

	cm_guard_taken(pair.server, 100 * LARGE);
	CHECK(pass(&pair, 0, LARGE) > 0);
	CHECK(pass(&pair, 0, LARGE) > 0);
	part(&pair);
}

static void limits_that_change_count_from_then_on(void)
{
	struct pair pair = paired("NULL");
	struct cm_guard_limits fewer = limits;

	CHECK(pass(&pair, 1, 1) > 0 && pass(&pair, 1, 1) > 0 && pass(&pair, 0, 1) > 0);
	fewer.parts = 2;
	cm_guard_limit(&fewer);
	CHECK(pass(&pair, 1, 1) > 0 && pass(&pair, 1, 1) > 0);
	CHECK_ERRNO(pass(&pair, 0, 1), ECONNRESET);
	part(&pair);
}

/* ---- threads: libzmq's accepts, reads and closes; the manager's asks and changes limits meanwhile ---- */

static _Atomic bool done;

static void *asks(void *unused)
{
	struct cm_guard_limits others = limits;
	struct cm_guard_peer peers[64], peer;
	struct cm_guard_counts now;

	while (!atomic_load(&done)) {
		int count = cm_guard_peers(peers, 64);

		for (int i = 0; i < count; i++) {
			cm_guard_taken(peers[i].fd, LARGE);
			CHECK(peers[i].kind == CM_GUARD_REQUESTS);
			if (!cm_guard_peer(peers[i].fd, &peer) && cm_guard_serial(peers[i].fd))
				CHECK(peer.fd == peers[i].fd);
		}
		others.topics = others.topics % 100 + 1;
		cm_guard_limit(&others);
		cm_guard_count(&now);
		CHECK(now.connections <= limits.connections);
	}
	return unused;
}

static void *cuts(void *unused)
{
	struct cm_guard_peer peers[4];

	while (!atomic_load(&done))
		for (int i = 0, count = cm_guard_peers(peers, 4); i < count; i++)
			cm_guard_cut(peers[i].fd);
	return unused;
}

static void connections_come_and_go_while_others_ask_for_them(void)
{
	pthread_t threads[2];

	atomic_store(&done, false);
	CHECK(!pthread_create(&threads[0], NULL, asks, NULL));
	CHECK(!pthread_create(&threads[1], NULL, cuts, NULL));
	for (int turn = 0; turn < 300; turn++) {
		struct sockaddr_un address;
		socklen_t length;
		int listener = listening(&address, &length), clients[8], servers[8];
		static const uint8_t sent[80] = { 0xff, [9] = 0x7f, 3, [64] = 1, 1, 0, 0, 1 };
		uint8_t got[80];

		for (int i = 0; i < 8; i++) {
			clients[i] = connected_to(&address, length);
			servers[i] = cm_guard_accept4(listener, NULL, NULL, SOCK_NONBLOCK);
			CHECK(servers[i] >= 0);
			CHECK(send(clients[i], sent, 69, MSG_NOSIGNAL) == 69 || errno == EPIPE);
		}
		for (int i = 0; i < 8; i++) {
			ssize_t size = cm_guard_recv(servers[i], got, sizeof(got), 0);

			CHECK(size == 69 || size == 0 || errno == ECONNRESET);
			CHECK(!cm_guard_close(servers[i]));
			close(clients[i]);
		}
		CHECK(!cm_guard_close(listener));
	}
	atomic_store(&done, true);
	for (int i = 0; i < 2; i++)
		CHECK(!pthread_join(threads[i], NULL));
}

int main(void)
{
	alarm(4 * TEST_SECONDS);
	cm_guard_limit(&limits); /* which opens the spare descriptor */
	RUN(what_is_not_encrypted_waits_as_long_as_it_takes);
	RUN(with_keys_the_seal_is_no_part_of_what_waits);
	RUN(an_encrypted_message_without_end_is_held_back_and_then_ended);
	RUN(encrypted_frames_that_nobody_takes_are_parts_of_one_message);
	RUN(without_keys_parts_are_counted_as_they_are);
	RUN(an_encrypted_frame_is_as_long_as_a_message_may_be);
	RUN(what_is_taken_late_holds_nobody_else_back);
	RUN(limits_that_change_count_from_then_on);
	RUN(connections_come_and_go_while_others_ask_for_them);
	return 0;
}
