// SPDX-License-Identifier: Apache-2.0
/* Registers that nobody answers for: SIGBUS ends the access, and not the process. */
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bus.h"
#include "fake_node.h"
#include "test.h"
#include "uio.h"
#include "uio_private.h"

#define BYTES 4096

/* Mapped, and an access is a bus error: a page behind the end of its file. */
static void *nobody(void *at)
{
	int fd = memfd_create("nobody", MFD_CLOEXEC);
	void *page =
		mmap(at, BYTES, PROT_READ | PROT_WRITE, MAP_SHARED | (at ? MAP_FIXED : 0), fd, 0);

	CHECK(page != MAP_FAILED);
	close(fd);
	return page;
}

static struct cm_uio *open_window(char *root)
{
	char path[256];
	struct cm_uio *uio;

	fake_file(root, "sys/class/uio/uio0/name", "a\n");
	fake_file(root, "sys/class/uio/uio0/maps/map0/addr", "0x1000\n");
	fake_file(root, "sys/class/uio/uio0/maps/map0/size", "0x1000\n");
	fake_file(root, "dev/there", "");
	snprintf(path, sizeof(path), "%s/dev/uio0", root);
	CHECK(!symlink("/dev/zero", path));
	uio = cm_uio_open(root, 0);
	CHECK(uio);
	return uio;
}

static void an_access_that_nobody_answers_is_eio(void)
{
	char *root = fake_root_make();
	struct cm_uio *uio = open_window(root);
	uint32_t words[4] = { 0 };
	uint64_t value;
	int i;

	CHECK(!cm_uio_write(uio, 0, 8, 32, 5));
	nobody(uio->windows[0].base);
	for (i = 0; i < 3; i++) {
		CHECK_ERRNO(cm_uio_read(uio, 0, 8, 32, &value), EIO);
		CHECK_ERRNO(cm_uio_read32(uio, 0, 8, 8), EIO);
		CHECK_ERRNO(cm_uio_write(uio, 0, 8, 64, 1), EIO);
		CHECK_ERRNO(cm_uio_read_block(uio, 0, 0, words, sizeof(words)), EIO);
		CHECK_ERRNO(cm_uio_write_block(uio, 0, 0, words, sizeof(words)), EIO);
	}
	/* and when somebody is there again */
	CHECK(mmap(uio->windows[0].base, BYTES, PROT_READ | PROT_WRITE,
		   MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1, 0) != MAP_FAILED);
	CHECK(!cm_uio_read(uio, 0, 8, 32, &value) && value == 0);
	cm_uio_close(uio);
	fake_root_remove(root);
}

static void *read_often(void *page)
{
	uint64_t value;
	int i;

	for (i = 0; i < 1000; i++)
		CHECK_ERRNO(cm_bus_read(page, 32, &value), EIO);
	return NULL;
}

static void threads_meet_it_each_for_themselves(void)
{
	pthread_t threads[4];
	void *page = nobody(NULL);
	int i;

	CHECK(!cm_bus_watch());
	for (i = 0; i < 4; i++)
		CHECK(!pthread_create(&threads[i], NULL, read_often, page));
	for (i = 0; i < 4; i++)
		CHECK(!pthread_join(threads[i], NULL));
	munmap(page, BYTES);
}

/* How a child ends that does something of its own that is a bus error. */
static int end_of(void (*what)(void))
{
	int status;
	pid_t child = fork();

	CHECK(child >= 0);
	if (!child) {
		what();
		_exit(0);
	}
	CHECK(waitpid(child, &status, 0) == child);
	return WIFSIGNALED(status) ? WTERMSIG(status) : -1;
}

static void touch(void)
{
	CHECK(!cm_bus_watch());
	*(volatile char *)nobody(NULL) = 1;
}

static void be_told(void)
{
	CHECK(!cm_bus_watch());
	kill(getpid(), SIGBUS);
	pause();
}

static void what_is_not_ours_ends_the_process_as_before(void)
{
	signal(SIGBUS, SIG_DFL); /* a sanitizer has a handler of its own */
	CHECK(end_of(touch) == SIGBUS);
	CHECK(end_of(be_told) == SIGBUS);
}

int main(void)
{
	RUN(what_is_not_ours_ends_the_process_as_before);
	RUN(an_access_that_nobody_answers_is_eio);
	RUN(threads_meet_it_each_for_themselves);
	return 0;
}
