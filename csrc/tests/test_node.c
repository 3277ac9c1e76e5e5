// SPDX-License-Identifier: Apache-2.0
/* A node that does not keep to cm_node.h, that dies, or that is not a node. */
#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "cm_dma.h"
#include "cm_node.h"
#include "fake_node.h"
#include "node.h"
#include "test.h"

#define PATH "dev/cm_dma/x"
#define MS INT64_C(1000000)

/* What is served and opened by most tests. */
struct scene {
	char *root;
	struct fake_node *fake;
	struct cm_node *node;
};

static struct scene scene_make(enum misdeed misdeed)
{
	struct scene scene = { .root = fake_root_make() };

	scene.fake = fake_node_start(scene.root, PATH, misdeed);
	scene.node = cm_node_open(scene.root, PATH);
	return scene;
}

static void scene_end(struct scene *scene)
{
	cm_node_close(scene->node);
	fake_node_stop(scene->fake);
	fake_root_remove(scene->root);
}

static int request_info(struct cm_node *node)
{
	struct cm_dma_info info = { .size = sizeof(info) };

	return cm_node_request(node, CM_DMA_IOC_INFO, &info, sizeof(info), NULL, CM_NODE_FD_NONE);
}

static int request_alloc(struct cm_node *node)
{
	struct cm_buffer_alloc arg = { .size = sizeof(arg), .length = 4096 };
	int result = cm_node_request(node, CM_DMA_IOC_ALLOC, &arg, sizeof(arg), &arg.fd,
				     CM_NODE_FD_RECEIVE);

	if (!result)
		close(arg.fd);
	return result;
}

static void a_node_that_does_not_exist_is_enoent(void)
{
	CHECK_NULL_ERRNO(cm_node_open("/nonexistent", PATH), ENOENT);
}

static void a_plain_file_is_no_node(void)
{
	char *root = fake_root_make();

	fake_file(root, PATH, "text");
	CHECK_NULL_ERRNO(cm_node_open(root, PATH), ENXIO);
	fake_root_remove(root);
}

static void a_socket_that_nobody_serves_is_enodev(void)
{
	char *root = fake_root_make();

	fake_node_stop(fake_node_start(root, PATH, WELL_BEHAVED));
	CHECK_NULL_ERRNO(cm_node_open(root, PATH), ENODEV);
	fake_root_remove(root);
}

static void a_character_device_gets_the_real_system_calls(void)
{
	struct cm_node *node = cm_node_open("/", "dev/null");

	CHECK(node && !cm_node_simulated(node));
	CHECK_ERRNO(request_info(node), ENOTTY);
	cm_node_close(node);
}

static void a_root_longer_than_a_socket_address_works(void)
{
	char *root = fake_root_make_long();
	struct fake_node *fake = fake_node_start(root, PATH, WELL_BEHAVED);
	struct cm_node *node = cm_node_open(root, PATH);

	CHECK(node && cm_node_simulated(node) && !request_info(node));
	cm_node_close(node);
	fake_node_stop(fake);
	fake_root_remove(root);
}

static void the_errno_of_a_refused_open_arrives(void)
{
	struct scene scene = scene_make(REFUSE_OPEN);

	CHECK(!scene.node && errno == EBUSY);
	scene_end(&scene);
}

static void a_greeting_that_is_none_fails_the_open(void)
{
	static const struct {
		enum misdeed misdeed;
		int error;
	} cases[] = {
		{ HANG_UP_AT_OPEN, ENODEV },
		{ GREET_WITHOUT_FD, EPROTO },
		{ GREET_WITH_WRONG_OP, EPROTO },
		{ GREET_WITH_TWO_FDS, EPROTO },
	};
	size_t i;

	for (i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		struct scene scene = scene_make(cases[i].misdeed);

		CHECK(!scene.node && errno == cases[i].error);
		scene_end(&scene);
	}
}

static void the_errno_of_a_refused_request_arrives_and_the_node_lives(void)
{
	struct scene scene = scene_make(REFUSE);

	CHECK_ERRNO(request_info(scene.node), EIO);
	CHECK_ERRNO(request_alloc(scene.node), EIO);
	CHECK(fake_node_requests(scene.fake) == 2);
	scene_end(&scene);
}

static void a_malformed_reply_breaks_the_node_for_good(void)
{
	static const enum misdeed cases[] = { SHORT_HEADER,   WRONG_OP,	     WRONG_LENGTH,
					      NEGATIVE_ERROR, SHORT_PAYLOAD, LONG_PAYLOAD,
					      UNASKED_FD };
	size_t i;

	for (i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		struct scene scene = scene_make(cases[i]);

		CHECK_ERRNO(request_info(scene.node), EPROTO);
		CHECK_ERRNO(request_info(scene.node), EPROTO);
		CHECK(fake_node_requests(scene.fake) == 1);
		scene_end(&scene);
	}
}

static void a_malformed_reply_with_a_descriptor_leaks_none(void)
{
	static const enum misdeed cases[] = { NO_FD,	     SHORT_HEADER, WRONG_OP,
					      SHORT_PAYLOAD, LONG_PAYLOAD, REFUSE };
	size_t i;

	for (i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		struct scene scene = scene_make(cases[i]);

		CHECK_ERRNO(request_alloc(scene.node), cases[i] == REFUSE ? EIO : EPROTO);
		scene_end(&scene);
	}
}

static void a_peer_that_dies_in_a_request_is_enodev_from_then_on(void)
{
	struct scene scene = scene_make(HANG_UP);

	CHECK_ERRNO(request_info(scene.node), ENODEV);
	CHECK_ERRNO(request_info(scene.node), ENODEV);
	scene_end(&scene);
}

static void a_peer_that_died_between_requests_is_enodev(void)
{
	struct scene scene = scene_make(WELL_BEHAVED);
	uint32_t event;

	CHECK(!request_info(scene.node));
	fake_node_stop(scene.fake);
	CHECK_ERRNO(request_info(scene.node), ENODEV);
	CHECK_ERRNO(cm_node_take(scene.node, &event, sizeof(event), 1), ENODEV);
	CHECK_ERRNO(cm_node_wait(scene.node, CM_WAIT_FOREVER, &event, sizeof(event)), ENODEV);
	CHECK_ERRNO(cm_node_write(scene.node, &event, sizeof(event)), ENODEV);
	cm_node_close(scene.node);
	fake_root_remove(scene.root);
}

static int64_t now_ms(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* One of some times: a busy machine may take its time. */
static bool refused_at_once(struct cm_node *node)
{
	for (int i = 0; i < 5; i++) {
		int64_t begun = now_ms();

		CHECK_ERRNO(request_info(node), ETIMEDOUT);
		if (now_ms() - begun < CM_NODE_TIMEOUT_MS / 2)
			return true;
	}
	return false;
}

static void a_silent_peer_is_etimedout_until_it_has_answered(void)
{
	struct scene scene = scene_make(ANSWER_LATE);
	int64_t begun = now_ms();

	CHECK_ERRNO(request_alloc(scene.node), ETIMEDOUT);
	CHECK(now_ms() - begun >= CM_NODE_TIMEOUT_MS - 50);
	CHECK(refused_at_once(scene.node));
	fake_node_speak(scene.fake);
	while (request_info(scene.node))
		usleep(1000);
	CHECK(!request_alloc(scene.node));
	CHECK(fake_node_requests(scene.fake) == 3);
	scene_end(&scene);
}

static void a_silent_peer_that_dies_is_enodev(void)
{
	struct scene scene = scene_make(ANSWER_LATE);

	CHECK_ERRNO(request_info(scene.node), ETIMEDOUT);
	fake_node_speak(scene.fake);
	while (request_info(scene.node))
		usleep(1000);
	fake_node_stop(scene.fake);
	CHECK_ERRNO(request_info(scene.node), ENODEV);
	scene.fake = fake_node_start(scene.root, "dev/another", WELL_BEHAVED);
	scene_end(&scene);
}

static void a_payload_above_the_limit_is_refused_before_it_is_sent(void)
{
	struct scene scene = scene_make(WELL_BEHAVED);
	static char much[CM_NODE_PAYLOAD_MAX + 1];

	CHECK_ERRNO(cm_node_request(scene.node, CM_DMA_IOC_INFO, much, sizeof(much), NULL,
				    CM_NODE_FD_NONE),
		    EMSGSIZE);
	CHECK(!request_info(scene.node));
	scene_end(&scene);
}

static void a_wait_ends_with_its_time(void)
{
	struct scene scene = scene_make(WELL_BEHAVED);
	uint32_t event;

	CHECK(cm_node_take(scene.node, &event, sizeof(event), 1) == 0);
	CHECK_ERRNO(cm_node_wait(scene.node, 2 * MS, &event, sizeof(event)), ETIMEDOUT);
	CHECK_ERRNO(cm_node_wait(scene.node, -1, &event, sizeof(event)), ETIMEDOUT);
	CHECK_ERRNO(cm_node_wait(scene.node, INT64_MIN, &event, sizeof(event)), ETIMEDOUT);
	scene_end(&scene);
}

static void an_event_of_another_size_is_eproto(void)
{
	struct scene scene = scene_make(WELL_BEHAVED);
	uint32_t on = 1;
	unsigned char event[3];

	CHECK(!cm_node_write(scene.node, &on, sizeof(on)));
	CHECK_ERRNO(cm_node_wait(scene.node, 5000 * MS, event, sizeof(event)), EPROTO);
	scene_end(&scene);
}

static void a_released_node_refuses_and_may_be_released_again(void)
{
	struct scene scene = scene_make(WELL_BEHAVED);
	uint32_t event;

	cm_node_release(scene.node);
	cm_node_release(scene.node);
	CHECK_ERRNO(request_info(scene.node), EBADF);
	CHECK_ERRNO(cm_node_take(scene.node, &event, sizeof(event), 1), EBADF);
	CHECK_ERRNO(cm_node_wait(scene.node, 0, &event, sizeof(event)), EBADF);
	CHECK_ERRNO(cm_node_write(scene.node, &event, sizeof(event)), EBADF);
	CHECK_ERRNO(cm_node_event_fd(scene.node), EBADF);
	scene_end(&scene);
}

static int kept_on_exec(void)
{
	int fd, count = 0;

	for (fd = 0; fd < 256; fd++) {
		int flags = fcntl(fd, F_GETFD);

		count += flags >= 0 && !(flags & FD_CLOEXEC);
	}
	return count;
}

static void every_descriptor_is_close_on_exec(void)
{
	int before = kept_on_exec();
	struct scene scene = scene_make(WELL_BEHAVED);
	struct cm_buffer_alloc arg = { .size = sizeof(arg), .length = 4096 };

	CHECK(!cm_node_request(scene.node, CM_DMA_IOC_ALLOC, &arg, sizeof(arg), &arg.fd,
			       CM_NODE_FD_RECEIVE));
	CHECK(kept_on_exec() == before);
	close(arg.fd);
	scene_end(&scene);
}

static void a_child_that_closes_leaves_the_node_to_its_parent(void)
{
	struct scene scene = scene_make(WELL_BEHAVED);
	pid_t child = fork();
	int status;

	CHECK(child >= 0);
	if (!child) {
		cm_node_close(scene.node);
		_exit(0);
	}
	CHECK(waitpid(child, &status, 0) == child && status == 0);
	CHECK(!request_info(scene.node));
	scene_end(&scene);
}

static void device_memory_of_a_simulated_node_cannot_be_mapped(void)
{
	struct scene scene = scene_make(WELL_BEHAVED);

	CHECK(cm_node_mmap(scene.node, 4096, 0) == MAP_FAILED && errno == ENOTSUP);
	scene_end(&scene);
}

static void on_signal(int signal)
{
	(void)signal;
}

static void signal_every(long us)
{
	static timer_t timer;				       /* alarm() is the test's own limit */
	struct sigaction action = { .sa_handler = on_signal }; /* no SA_RESTART */
	struct sigevent event = { .sigev_notify = SIGEV_SIGNAL, .sigev_signo = SIGUSR1 };
	struct itimerspec period = {
		.it_interval.tv_nsec = us * 1000,
		.it_value.tv_nsec = us * 1000,
	};

	if (!us) {
		CHECK(!timer_delete(timer));
		return;
	}
	CHECK(!sigaction(SIGUSR1, &action, NULL) && !timer_create(CLOCK_MONOTONIC, &event, &timer));
	CHECK(!timer_settime(timer, 0, &period, NULL));
}

static void signals_do_not_end_requests(void)
{
	struct scene scene = scene_make(WELL_BEHAVED);
	int i;

	signal_every(50);
	for (i = 0; i < 2000; i++)
		CHECK(!request_info(scene.node));
	signal_every(0);
	scene_end(&scene);
}

static void a_signal_ends_a_wait_with_eintr(void)
{
	struct scene scene = scene_make(WELL_BEHAVED);
	uint32_t event;

	signal_every(1000);
	CHECK_ERRNO(cm_node_wait(scene.node, CM_WAIT_FOREVER, &event, sizeof(event)), EINTR);
	signal_every(0);
	scene_end(&scene);
}

int main(void)
{
	RUN(a_node_that_does_not_exist_is_enoent);
	RUN(a_plain_file_is_no_node);
	RUN(a_socket_that_nobody_serves_is_enodev);
	RUN(a_character_device_gets_the_real_system_calls);
	RUN(a_root_longer_than_a_socket_address_works);
	RUN(the_errno_of_a_refused_open_arrives);
	RUN(a_greeting_that_is_none_fails_the_open);
	RUN(the_errno_of_a_refused_request_arrives_and_the_node_lives);
	RUN(a_malformed_reply_breaks_the_node_for_good);
	RUN(a_malformed_reply_with_a_descriptor_leaks_none);
	RUN(a_peer_that_dies_in_a_request_is_enodev_from_then_on);
	RUN(a_peer_that_died_between_requests_is_enodev);
	RUN(a_silent_peer_is_etimedout_until_it_has_answered);
	RUN(a_silent_peer_that_dies_is_enodev);
	RUN(a_payload_above_the_limit_is_refused_before_it_is_sent);
	RUN(a_wait_ends_with_its_time);
	RUN(an_event_of_another_size_is_eproto);
	RUN(a_released_node_refuses_and_may_be_released_again);
	RUN(every_descriptor_is_close_on_exec);
	RUN(a_child_that_closes_leaves_the_node_to_its_parent);
	RUN(device_memory_of_a_simulated_node_cannot_be_mapped);
	RUN(signals_do_not_end_requests);
	RUN(a_signal_ends_a_wait_with_eintr);
	return 0;
}
