// SPDX-License-Identifier: Apache-2.0
/* Connections that wait to be taken: those of who connects without end, and those of others behind them. */
#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/un.h>
#include <sys/wait.h>

#include "guard_private.h"
#include "test.h"

#define FLOOD 200 /* connections that wait */
#define MANY 64	  /* of them that are taken before it counts that others wait */
#define AT_ONCE 64

/* One may connect once a second: so that how long a test takes makes next to no difference. */
static const struct cm_guard_limits limits = { .each = 1 };

static uint64_t refused(void)
{
	struct cm_guard_counts now;

	cm_guard_count(&now);
	return now.refused[CM_GUARD_OFTEN];
}

/* A listener, and where it listens. */
struct place {
	struct sockaddr_storage address;
	socklen_t length;
	int listener;
};

static struct place listening(int family)
{
	struct place place = { .length =
				       sizeof(sa_family_t) }; /* a name that the kernel makes up */
	struct sockaddr_in *address = (struct sockaddr_in *)&place.address;

	place.address.ss_family = (sa_family_t)family;
	if (family == AF_INET) {
		place.length = sizeof(*address);
		address->sin_addr.s_addr = htonl(INADDR_ANY);
	}
	place.listener = socket(family, SOCK_STREAM | SOCK_CLOEXEC, 0);
	CHECK(!bind(place.listener, (struct sockaddr *)&place.address, place.length));
	place.length = sizeof(place.address);
	CHECK(!getsockname(place.listener, (struct sockaddr *)&place.address, &place.length));
	if (family == AF_INET)
		address->sin_addr.s_addr = htonl(INADDR_LOOPBACK);
	cm_guard_expect(CM_GUARD_REQUESTS);
	CHECK(!cm_guard_listen(place.listener, 2 * FLOOD));
	cm_guard_expect(CM_GUARD_NONE);
	return place;
}

/* Over TCP from 127.0.0.@host. */
static int connected_to(const struct place *place, uint32_t host)
{
	struct sockaddr_in from = { .sin_family = AF_INET };
	int fd = socket(place->address.ss_family, SOCK_STREAM | SOCK_CLOEXEC, 0);

	CHECK(fd >= 0);
	from.sin_addr.s_addr = htonl(0x7f000000 | host);
	if (place->address.ss_family == AF_INET)
		CHECK(!bind(fd, (struct sockaddr *)&from, sizeof(from)));
	CHECK(!connect(fd, (const struct sockaddr *)&place->address, place->length));
	return fd;
}

/* Another process, or address, connects so often. */
static void flood(const struct place *place)
{
	pid_t child = fork();
	int status;

	CHECK(child >= 0);
	if (!child) {
		for (int i = 0; i < FLOOD; i++)
			close(connected_to(place, 2));
		_exit(0);
	}
	CHECK(waitpid(child, &status, 0) == child && !status);
}

/* Whether a connection that was taken is one of ours. */
static bool is_ours(int fd)
{
	struct cm_guard_peer peer;

	CHECK(!cm_guard_peer(fd, &peer));
	return peer.pid ? peer.pid == getpid() : peer.address[15] == 3;
}

/* Take until one of ours comes; how many others were, and how often none was. */
static void take_ours(const struct place *place, int *others, int *times)
{
	bool ours = false;

	for (*others = *times = 0; !ours; *others += !ours) {
		struct sockaddr_storage address;
		socklen_t length = sizeof(address);
		int fd = cm_guard_accept4(place->listener, (struct sockaddr *)&address, &length,
					  SOCK_CLOEXEC);

		if (fd < 0) {
			CHECK(errno == ECONNABORTED);
			(*times)++;
			*others -= 1;
			continue;
		}
		CHECK(address.ss_family == place->address.ss_family);
		ours = is_ours(fd);
		CHECK(!cm_guard_close(fd));
	}
}

static void who_connects_without_end_is_closed_and_another_is_let_in(int family)
{
	struct place place = listening(family);
	uint64_t before = refused();
	int others, times, client;

	flood(&place);
	client = connected_to(&place, 3);
	take_ours(&place, &others, &times);
	CHECK(others >= MANY - 1 && others < FLOOD / 2); /* from when on it counts that many wait */
	CHECK(refused() == before + FLOOD - (uint64_t)others);
	CHECK(times <= FLOOD / AT_ONCE);
	close(client);
	CHECK(!cm_guard_close(place.listener));
}

static void over_ipc_a_process_is_let_in_before_the_rest_of_anothers(void)
{
	who_connects_without_end_is_closed_and_another_is_let_in(AF_UNIX);
}

static void over_tcp_an_address_is_let_in_before_the_rest_of_anothers(void)
{
	who_connects_without_end_is_closed_and_another_is_let_in(AF_INET);
}

static void where_nobody_waits_one_may_connect_as_often_as_it_can(void)
{
	struct place place = listening(AF_UNIX);
	uint64_t before = refused();

	for (int i = 0; i < 2 * FLOOD; i++) {
		int client = connected_to(&place, 0);
		int fd = cm_guard_accept(place.listener, NULL, NULL);

		CHECK(fd >= 0);
		CHECK(!cm_guard_close(fd));
		close(client);
	}
	CHECK(refused() == before);
	CHECK_ERRNO(cm_guard_accept(place.listener, NULL, NULL),
		    EAGAIN); /* and nobody waits for one */
	CHECK(!cm_guard_close(place.listener));
}

static void without_a_bound_nobody_connects_too_often(void)
{
	const struct cm_guard_limits none = { 0 };
	struct place place = listening(AF_UNIX);
	uint64_t before = refused();

	cm_guard_limit(&none);
	flood(&place);
	for (int i = 0; i < FLOOD; i++) {
		int fd = cm_guard_accept4(place.listener, NULL, NULL, SOCK_CLOEXEC);

		CHECK(fd >= 0);
		CHECK(!cm_guard_close(fd));
	}
	CHECK(refused() == before);
	cm_guard_limit(&limits);
	CHECK(!cm_guard_close(place.listener));
}

static int times(const struct cm_guard_peer *peer, int64_t now_ms)
{
	int count = 0;

	while (count < 1000 && cm_guard_connects(peer, 100, now_ms))
		count++;
	return count;
}

static void what_was_spent_on_connecting_is_back_within_a_second(void)
{
	struct cm_guard_peer one = { .pid = 1 }, other = { .pid = 2 };
	int64_t now = 5000;
	int count = 0;

	CHECK(times(&one, now) == 100);
	CHECK(times(&other, now) == 100);
	CHECK(times(&one, now + 250) == 25);
	for (int64_t ms = 251; ms < 1250; ms++) /* less than one at a time adds up as well */
		count += times(&one, now + ms);
	CHECK(count == 99);
	CHECK(times(&one, now + 9000) == 100);
	CHECK(times(&one, now) == 0); /* a clock that goes back */
}

int main(void)
{
	alarm(TEST_SECONDS);
	cm_guard_limit(&limits); /* which opens the spare descriptor */
	RUN(over_ipc_a_process_is_let_in_before_the_rest_of_anothers);
	RUN(over_tcp_an_address_is_let_in_before_the_rest_of_anothers);
	RUN(where_nobody_waits_one_may_connect_as_often_as_it_can);
	RUN(without_a_bound_nobody_connects_too_often);
	RUN(what_was_spent_on_connecting_is_back_within_a_second);
	return 0;
}
