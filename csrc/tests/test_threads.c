// SPDX-License-Identifier: Apache-2.0
/* Threads that share a node; run under the thread sanitizer too. */
#include <pthread.h>
#include <unistd.h>

#include "axidma.h"
#include "fake_node.h"
#include "node.h"
#include "test.h"
#include "uio.h"

#define THREADS 4
#define ROUNDS 300

struct shared {
	char *root;
	struct fake_node *fake;
	struct cm_dma *dma;
};

static struct shared shared_make(void)
{
	struct shared shared = { .root = fake_root_make() };

	shared.fake = fake_node_start(shared.root, "dev/cm_dma/x", WELL_BEHAVED);
	shared.dma = cm_dma_open(shared.root, "x");
	CHECK(shared.dma);
	return shared;
}

static void shared_end(struct shared *shared)
{
	cm_dma_close(shared->dma);
	fake_node_stop(shared->fake);
	fake_root_remove(shared->root);
}

static void *submit_and_wait(void *arg)
{
	struct cm_dma *dma = arg;
	struct cm_dma_completion done;
	struct cm_buffer buffer;
	int i;

	for (i = 0; i < ROUNDS; i++) {
		CHECK(!cm_dma_submit(dma, 7, 0, 64, 3, 0, 0));
		CHECK(cm_dma_wait(dma, CM_WAIT_FOREVER, &done) == 1 && done.cookie == 3);
	}
	CHECK(!cm_dma_alloc(dma, 4096, &buffer));
	cm_buffer_close(&buffer);
	return NULL;
}

static void requests_of_threads_do_not_mix(void)
{
	struct shared shared = shared_make();
	pthread_t threads[THREADS];
	int i;

	for (i = 0; i < THREADS; i++)
		CHECK(!pthread_create(&threads[i], NULL, submit_and_wait, shared.dma));
	for (i = 0; i < THREADS; i++)
		pthread_join(threads[i], NULL);
	CHECK(fake_node_requests(shared.fake) == THREADS * (ROUNDS + 1));
	shared_end(&shared);
}

static void *wait_for_the_release(void *arg)
{
	struct cm_dma_completion done;

	errno = 0;
	CHECK(cm_dma_wait(arg, CM_WAIT_FOREVER, &done) < 0);
	CHECK(errno == ECANCELED || errno == EBADF);
	return NULL;
}

static void a_release_ends_the_waits_of_other_threads(void)
{
	struct shared shared = shared_make();
	pthread_t threads[THREADS];
	int i;

	for (i = 0; i < THREADS; i++)
		CHECK(!pthread_create(&threads[i], NULL, wait_for_the_release, shared.dma));
	cm_dma_release(shared.dma);
	for (i = 0; i < THREADS; i++)
		pthread_join(threads[i], NULL);
	shared_end(&shared);
}

static void *ask_until_released(void *arg)
{
	struct cm_dma_info info;

	while (!cm_dma_get_info(arg, &info))
		;
	CHECK(errno == EBADF);
	return NULL;
}

static void a_release_among_requests_ends_them_cleanly(void)
{
	struct shared shared = shared_make();
	pthread_t threads[THREADS];
	int i;

	for (i = 0; i < THREADS; i++)
		CHECK(!pthread_create(&threads[i], NULL, ask_until_released, shared.dma));
	while (fake_node_requests(shared.fake) < 100)
		;
	cm_dma_release(shared.dma);
	for (i = 0; i < THREADS; i++)
		pthread_join(threads[i], NULL);
	shared_end(&shared);
}

int main(void)
{
	RUN(requests_of_threads_do_not_mix);
	RUN(a_release_ends_the_waits_of_other_threads);
	RUN(a_release_among_requests_ends_them_cleanly);
	return 0;
}
