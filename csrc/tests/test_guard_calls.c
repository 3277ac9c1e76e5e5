// SPDX-License-Identifier: Apache-2.0
/* What libzmq calls, on real connections: with and without CURVE, and from several threads. */
#include <pthread.h>
#include <stdatomic.h>
#include <sys/un.h>

#include "guard_private.h"
#include "test.h"

#define LARGE 6000 /* bytes of a frame that counts as large */
#define SEALED 33  /* of them, CURVE's own */
#define LOOKS 10
#define STALLS 2
#define LONG 40000 /* bytes of a frame that takes a place */
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

static int listening(struct sockaddr_un *address, socklen_t *length, uint32_t kind)
{
	int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);

	CHECK(fd >= 0);
	*address = (struct sockaddr_un){ .sun_family = AF_UNIX };
	*length = sizeof(sa_family_t); /* a name that the kernel makes up */
	CHECK(!bind(fd, (struct sockaddr *)address, *length));
	*length = sizeof(*address);
	CHECK(!getsockname(fd, (struct sockaddr *)address, length));
	cm_guard_expect(kind);
	CHECK(!cm_guard_listen(fd, 16));
	cm_guard_expect(CM_GUARD_NONE);
	return fd;
}

static struct pair of_kind(const char *mechanism, uint32_t kind)
{
	uint8_t greeting[64] = { 0xff, [9] = 0x7f, [10] = 3 };
	struct sockaddr_un address;
	socklen_t length;
	struct pair pair = { .listener = listening(&address, &length, kind) };
	static const uint8_t ready[] = { 4, 6, 5, 'R', 'E', 'A', 'D', 'Y' };
	uint8_t got[64];

	cm_guard_limit(&limits);
	memcpy(greeting + 12, mechanism, strlen(mechanism));
	pair.client = connected_to(&address, length);
	pair.server = cm_guard_accept4(pair.listener, NULL, NULL, SOCK_CLOEXEC | SOCK_NONBLOCK);
	CHECK(pair.server >= 0);
	CHECK(write(pair.client, greeting, sizeof(greeting)) == sizeof(greeting));
	CHECK(cm_guard_recv(pair.server, got, sizeof(got), 0) == sizeof(got));
	for (int commands = *mechanism == 'C' ? 2 : 1; commands; commands--) {
		CHECK(write(pair.client, ready, sizeof(ready)) == sizeof(ready));
		CHECK(cm_guard_recv(pair.server, got, sizeof(got), 0) == sizeof(ready));
	}
	return pair;
}

static struct pair paired(const char *mechanism)
{
	return of_kind(mechanism, CM_GUARD_REQUESTS);
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
	uint64_t before = refused(CM_GUARD_SLOW);

	for (int frame = 0; frame < 3; frame++)
		CHECK(pass(&pair, 0, LARGE + SEALED) > 0);
	CHECK_ERRNO(pass(&pair, 0, 1), EAGAIN);
	for (int look = 0; look < STALLS; look++)
		cm_guard_look_on();
	CHECK(refused(CM_GUARD_SLOW) == before);
	cm_guard_look_on();
	CHECK(refused(CM_GUARD_SLOW) == before + 1);
	drained(&pair);
	CHECK(recv(pair.client, (uint8_t[1]){ 0 }, 1, 0) == 0);
	part(&pair);
}

/* A frame of LONG bytes begins, of which none comes. */
static void announce(struct pair *pair)
{
	static const uint8_t head[9] = { 2, [7] = LONG >> 8, LONG & 0xff };
	uint8_t got[9];

	CHECK(write(pair->client, head, sizeof(head)) == sizeof(head));
	CHECK(cm_guard_recv(pair->server, got, sizeof(got), 0) == sizeof(got));
}

static bool is_read(struct pair *pair)
{
	uint8_t got[1] = { 0 };

	CHECK(write(pair->client, got, 1) == 1 || errno == EPIPE);
	return cm_guard_recv(pair->server, got, 1, 0) >= 0;
}

static void of_long_messages_a_peer_sends_two_at_a_time(void)
{
	static const struct cm_guard_limits longer = { .connections = 64, .bytes = 50000 };
	struct pair pairs[4] = { paired("NULL"), paired("CURVE"), paired("NULL"), paired("CURVE") };
	uint8_t body[LONG] = { 0 };

	cm_guard_limit(&longer);
	for (int i = 0; i < 4; i++)
		announce(&pairs[i]);
	CHECK(is_read(&pairs[0]) && is_read(&pairs[1]));
	CHECK(!is_read(&pairs[2]) && !is_read(&pairs[3]));
	CHECK(write(pairs[0].client, body, LONG - 1) == LONG - 1);
	CHECK(cm_guard_recv(pairs[0].server, body, LONG - 1, 0) == LONG - 1);
	CHECK(!is_read(&pairs[2])); /* it is whole, but nobody took it */
	cm_guard_taken(pairs[0].server, LONG);
	CHECK(is_read(&pairs[2]) && !is_read(&pairs[3])); /* who waits longest */
	part(&pairs[1]);
	CHECK(is_read(&pairs[3])); /* and when one goes */
	part(&pairs[0]);
	part(&pairs[2]);
	part(&pairs[3]);
}

static void who_keeps_others_waiting_with_half_a_message_is_ended(void)
{
	static const struct cm_guard_limits longer = { .connections = 64, .bytes = 50000 };
	struct pair pairs[3] = { paired("NULL"), paired("NULL"), paired("NULL") };
	uint64_t before = refused(CM_GUARD_SLOW);

	cm_guard_limit(&longer);
	announce(&pairs[0]);
	announce(&pairs[1]);
	for (int look = 0; look < 2 * LOOKS; look++)
		cm_guard_look_on();
	CHECK(refused(CM_GUARD_SLOW) == before); /* nobody waits */
	announce(&pairs[2]);
	CHECK(!is_read(&pairs[2]));
	cm_guard_look_on();
	CHECK(refused(CM_GUARD_SLOW) == before + 2);
	part(&pairs[0]);
	CHECK(is_read(&pairs[2]));
	part(&pairs[1]);
	part(&pairs[2]);
}

static void who_is_slow_has_longer_than_who_stands_still(void)
{
	static const struct cm_guard_limits longer = { .connections = 64, .bytes = 1 << 20 };
	static uint8_t body[64 << 10];
	struct pair pairs[3] = { paired("NULL"), paired("NULL"), paired("NULL") };
	uint64_t before = refused(CM_GUARD_SLOW);

	cm_guard_limit(&longer);
	for (int i = 0; i < 3; i++) {
		static const uint8_t head[9] = { 2, [6] = 0xf };

		CHECK(write(pairs[i].client, head, sizeof(head)) == sizeof(head));
		CHECK(cm_guard_recv(pairs[i].server, body, sizeof(body), 0) == sizeof(head));
	}
	for (int look = 0; look <= STALLS; look++) {
		CHECK(refused(CM_GUARD_SLOW) == before);
		for (size_t left = sizeof(body); left;) {
			CHECK(write(pairs[0].client, body, 4096) == 4096);
			left -= (size_t)cm_guard_recv(pairs[0].server, body, 4096, 0);
		}
		cm_guard_look_on();
	}
	CHECK(refused(CM_GUARD_SLOW) == before + 1); /* the other one */
	CHECK(recv(pairs[0].client, body, 1, MSG_DONTWAIT) < 0);
	CHECK(recv(pairs[1].client, body, 1, 0) == 0);
	for (int i = 0; i < 3; i++)
		part(&pairs[i]);
}

static void who_is_held_is_not_read_until_it_is_let_go_or_has_gone(void)
{
	struct pair pair = paired("NULL");
	uint8_t got[8];

	CHECK(!cm_guard_hold(pair.server, 1));
	CHECK(!is_read(&pair));
	CHECK(!cm_guard_hold(pair.server, 0));
	CHECK(is_read(&pair));
	CHECK(!cm_guard_hold(pair.server, 1));
	close(pair.client);
	CHECK(cm_guard_recv(pair.server, got, sizeof(got), 0) == 1); /* what it sent before */
	CHECK(cm_guard_recv(pair.server, got, sizeof(got), 0) == 0);
	CHECK(!cm_guard_close(pair.server));
	CHECK(!cm_guard_close(pair.listener));
	CHECK_ERRNO(cm_guard_hold(pair.server, 1), ENOENT);
}

static void nothing_waits_for_a_connection_that_is_held(void)
{
	struct pair pair = paired("NULL");
	int epoll = epoll_create1(EPOLL_CLOEXEC);
	struct epoll_event event = { .events = 0 }, found;

	CHECK(!cm_guard_epoll_ctl(epoll, EPOLL_CTL_ADD, pair.server, &event));
	event.events = EPOLLIN;
	CHECK(!cm_guard_epoll_ctl(epoll, EPOLL_CTL_MOD, pair.server, &event));
	CHECK(write(pair.client, "a", 1) == 1);
	CHECK(epoll_wait(epoll, &found, 1, 0) == 1);
	CHECK(!cm_guard_hold(pair.server, 1));
	CHECK(epoll_wait(epoll, &found, 1, 0) == 0);
	event.events =
		EPOLLIN | EPOLLOUT; /* libzmq wants to write as well, and knows nothing of it */
	CHECK(!cm_guard_epoll_ctl(epoll, EPOLL_CTL_MOD, pair.server, &event));
	CHECK(epoll_wait(epoll, &found, 1, 0) == 1 && found.events == EPOLLOUT);
	CHECK(!cm_guard_hold(pair.server, 0));
	CHECK(epoll_wait(epoll, &found, 1, 0) == 1 && found.events == (EPOLLIN | EPOLLOUT));
	CHECK(!cm_guard_epoll_ctl(epoll, EPOLL_CTL_DEL, pair.server, NULL));
	CHECK(!cm_guard_hold(pair.server, 1));
	CHECK(!close(epoll));
	part(&pair);
}

static void want_to_write(int epoll, struct pair *pair, bool much)
{
	struct epoll_event event = { .events = EPOLLIN | (much ? EPOLLOUT : 0) };

	CHECK(!cm_guard_epoll_ctl(epoll, EPOLL_CTL_MOD, pair->server, &event));
}

static void of_those_who_do_not_read_who_began_first_is_ended(void)
{
	struct pair pairs[3] = { paired("NULL"), paired("NULL"), paired("NULL") };
	int epoll = epoll_create1(EPOLL_CLOEXEC);
	struct epoll_event event = { .events = 0 };

	for (int i = 0; i < 3; i++)
		CHECK(!cm_guard_epoll_ctl(epoll, EPOLL_CTL_ADD, pairs[i].server, &event));
	CHECK(cm_guard_cut_slowest(CM_GUARD_REQUESTS) == -1); /* all read */
	for (int i = 0; i < 3; i++)
		want_to_write(epoll, &pairs[i], true);
	want_to_write(epoll, &pairs[0], false); /* which has read, */
	want_to_write(epoll, &pairs[0], true);	/* and is behind again */
	want_to_write(epoll, &pairs[1], true);
	CHECK(cm_guard_cut_slowest(CM_GUARD_TOPICS) == -1);
	CHECK(cm_guard_cut_slowest(CM_GUARD_REQUESTS) == pairs[1].server);
	CHECK(cm_guard_cut_slowest(CM_GUARD_REQUESTS) == pairs[2].server);
	CHECK(cm_guard_cut_slowest(CM_GUARD_REQUESTS) == pairs[0].server);
	CHECK(cm_guard_cut_slowest(CM_GUARD_REQUESTS) == -1); /* they are ended, and close soon */
	CHECK(!close(epoll));
	for (int i = 0; i < 3; i++)
		part(&pairs[i]);
}

static void encrypted_frames_that_nobody_takes_are_parts_of_one_message(void)
{
	static const struct cm_guard_limits longer = { .connections = 64, .bytes = 8 << 20 };
	struct pair pair = paired("CURVE");
	uint64_t before = refused(CM_GUARD_PARTS);

	cm_guard_limit(&longer);
	for (int frame = 0; frame < FRAMES; frame++)
		CHECK(pass(&pair, 0, 1) > 0); /* each looks like a message of its own */
	cm_guard_taken(pair.server, 0);
	for (int frame = 0; frame < FRAMES; frame++)
		CHECK(pass(&pair, 0, 1) > 0);
	CHECK_ERRNO(pass(&pair, 0, 1), ECONNRESET);
	CHECK(refused(CM_GUARD_PARTS) == before + 1);
	part(&pair);
}

/* Nobody takes a ping: those of years do not end a connection, nor hold it back. */
static void pings_are_forgotten_with_time(void)
{
	struct pair pair = paired("CURVE");

	for (int second = 0; second < FRAMES + 10; second++) {
		CHECK(pass(&pair, 0, SEALED + 23) > 0);
		cm_guard_look_on();
	}
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

/* What libzmq has read waits there, held or not: so it reads little of short messages. */
static void short_messages_are_read_a_few_at_a_time(void)
{
	struct pair pair = paired("NULL");
	uint8_t many[4096] = { 0 }; /* 2048 empty messages */
	ssize_t got;

	CHECK(write(pair.client, many, sizeof(many)) == sizeof(many));
	got = cm_guard_recv(pair.server, many, sizeof(many), 0);
	CHECK(got > 0 && got < 1024);
	drained(&pair);
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

/* Whether a subscriber that connects anew may send so many topics at once. */
static bool subscribes(uint32_t topics)
{
	struct pair pair = of_kind("NULL", CM_GUARD_TOPICS);
	uint64_t before = refused(CM_GUARD_RATE);
	uint8_t all[24], got[24];
	uint32_t size = topics * 3;

	CHECK(size <= sizeof(all));
	for (uint32_t at = 0; at < size; at += 3)
		memcpy(all + at, "\0\1\1", 3);
	CHECK(write(pair.client, all, size) == (ssize_t)size);
	CHECK((cm_guard_recv(pair.server, got, sizeof(got), 0) == (ssize_t)size) ==
	      (refused(CM_GUARD_RATE) == before));
	part(&pair);
	return refused(CM_GUARD_RATE) == before;
}

static void who_connects_again_may_subscribe_no_more_often(void)
{
	struct cm_guard_peer other = { .pid = 1 };
	int64_t now = 1000;
	int times = 0;

	while (times < 1000 && subscribes(8))
		times++;
	CHECK(times >= 4 && times < 1000); /* each as often as one connection may */
	for (int i = 0; i < 4; i++)
		CHECK(cm_guard_pay(&other, 8, 8, now)); /* and another peer no less */
	CHECK(!cm_guard_pay(&other, 1, 8, now));
	CHECK(cm_guard_pay(&other, 4, 8, now + 2)); /* an eighth comes back in two seconds */
	CHECK(!cm_guard_pay(&other, 1, 8, now + 2));
	CHECK(cm_guard_pay(&other, 32, 8, now + 100));
	for (int32_t pid = 2; pid < 500; pid++) { /* who came long ago is forgotten */
		struct cm_guard_peer one = { .pid = pid };

		CHECK(cm_guard_pay(&one, 32, 8, now + 200));
		CHECK(!cm_guard_pay(&one, 1, 8, now + 200));
	}
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
			if (!cm_guard_hold(peers[i].fd, 1))
				cm_guard_hold(peers[i].fd, 0);
			if (!cm_guard_peer(peers[i].fd, &peer) && cm_guard_serial(peers[i].fd))
				CHECK(peer.fd == peers[i].fd);
		}
		others.topics = others.topics % 100 + 1;
		cm_guard_limit(&others);
		cm_guard_look_on();
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
		int listener = listening(&address, &length, CM_GUARD_REQUESTS), clients[8],
		    servers[8];
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

			CHECK(size == 69 || size == 0 || errno == ECONNRESET || errno == EAGAIN);
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
	RUN(of_long_messages_a_peer_sends_two_at_a_time);
	RUN(who_keeps_others_waiting_with_half_a_message_is_ended);
	RUN(who_is_slow_has_longer_than_who_stands_still);
	RUN(who_is_held_is_not_read_until_it_is_let_go_or_has_gone);
	RUN(nothing_waits_for_a_connection_that_is_held);
	RUN(of_those_who_do_not_read_who_began_first_is_ended);
	RUN(encrypted_frames_that_nobody_takes_are_parts_of_one_message);
	RUN(pings_are_forgotten_with_time);
	RUN(without_keys_parts_are_counted_as_they_are);
	RUN(an_encrypted_frame_is_as_long_as_a_message_may_be);
	RUN(short_messages_are_read_a_few_at_a_time);
	RUN(what_is_taken_late_holds_nobody_else_back);
	RUN(who_connects_again_may_subscribe_no_more_often);
	RUN(limits_that_change_count_from_then_on);
	RUN(connections_come_and_go_while_others_ask_for_them);
	return 0;
}
