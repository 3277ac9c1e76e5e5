// SPDX-License-Identifier: GPL-2.0-only
/*
 * Exercises /dev/cm_dma against cm_plsim's loopback and source, in a virtual
 * machine.  Prints one line a check; exit status 0 where all hold.
 *
 *	smoke_dma DEBUGFS-FOLDER-OF-THE-ENGINE
 *
 * needs the channels to_pl and from_pl (a loopback) and camera (a source of
 * 4096-byte frames).
 */
#include <errno.h>
#include <fcntl.h>
#include <linux/dma-buf.h>
#include <poll.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include "cm_dma.h"
#include "smoke.h"

struct buffer {
	__u32 handle;
	int fd;
	size_t length;
	uint8_t *data;
};

static int open_channel(const char *name)
{
	char path[64];

	snprintf(path, sizeof(path), "/dev/cm_dma/%s", name);
	return open(path, O_RDWR | O_CLOEXEC);
}

static struct buffer allocate(int channel, size_t length)
{
	struct cm_buffer_alloc args = { .size = sizeof(args), .length = length };
	struct buffer buffer = {};

	if (ioctl(channel, CM_DMA_IOC_ALLOC, &args)) {
		perror("ALLOC");
		exit(1);
	}
	buffer.handle = args.handle;
	buffer.fd = args.fd;
	buffer.length = args.length;
	buffer.data = mmap(NULL, args.length, PROT_READ | PROT_WRITE, MAP_SHARED, args.fd, 0);
	if (buffer.data == MAP_FAILED) {
		perror("mmap");
		exit(1);
	}
	return buffer;
}

static void release(struct buffer *buffer)
{
	munmap(buffer->data, buffer->length);
	close(buffer->fd);
}

static int submit(int channel, __u32 handle, __u64 offset, __u64 length, __u64 cookie)
{
	struct cm_dma_submit args = { .size = sizeof(args), .handle = handle, .offset = offset,
				      .length = length, .cookie = cookie };

	return ioctl(channel, CM_DMA_IOC_SUBMIT, &args);
}

static int cancel(int channel)
{
	struct cm_dma_cancel args = { .size = sizeof(args) };

	return ioctl(channel, CM_DMA_IOC_CANCEL, &args);
}

/* status of the next completion, or 1 where none came */
static int next(int channel, struct cm_dma_completion *completion)
{
	struct pollfd waiter = { .fd = channel, .events = POLLIN };

	if (poll(&waiter, 1, 60000) != 1 ||
	    read(channel, completion, sizeof(*completion)) != sizeof(*completion))
		return 1;
	return completion->status;
}

static void test_info(int channel)
{
	struct cm_dma_info info = { .size = sizeof(info) };
	struct {
		struct cm_dma_info info;
		__u64 later;
	} longer = { .info.size = sizeof(longer) };

	CHECK(ioctl(channel, CM_DMA_IOC_INFO, &info) == 0);
	CHECK(info.direction == CM_DMA_S2MM && !strcmp((char *)info.name, "camera"));
	CHECK(info.frame_length == 4096 && info.queue_depth == 64);
	CHECK(info.caps & CM_DMA_CAP_CYCLIC && info.caps & CM_DMA_CAP_RESIDUE);
	CHECK(ioctl(channel, _IOWR(CM_IOC_MAGIC, 0, longer), &longer) == 0);
	longer.later = 1;
	CHECK(ioctl(channel, _IOWR(CM_IOC_MAGIC, 0, longer), &longer) == -1 && errno == E2BIG);
	info.flags = 1;
	CHECK(ioctl(channel, CM_DMA_IOC_INFO, &info) == -1 && errno == EINVAL);
	CHECK(ioctl(channel, _IOC(0, CM_IOC_MAGIC, 99, 0), &info) == -1 && errno == ENOTTY);
	CHECK(open_channel("camera") == -1 && errno == EBUSY);
}

static void test_refusals(int channel)
{
	struct cm_dma_submit args = { .size = sizeof(args), .length = 16 };
	struct cm_buffer_free gone = { .size = sizeof(gone), .handle = 77 };
	struct buffer buffer = allocate(channel, 5000);
	struct cm_dma_completion completion;

	CHECK(buffer.length == 8192);
	CHECK(submit(channel, 99, 0, 16, 0) == -1 && errno == ENOENT);
	CHECK(submit(channel, buffer.handle, 0, 0, 0) == -1 && errno == EINVAL);
	CHECK(submit(channel, buffer.handle, 8192, 1, 0) == -1 && errno == EINVAL);
	CHECK(submit(channel, buffer.handle, ~0ULL, 16, 0) == -1 && errno == EINVAL);
	CHECK(submit(channel, buffer.handle, 0, 1ULL << 40, 0) == -1 && errno == EMSGSIZE);
	args.handle = buffer.handle;
	args.flags = 1u << 31;
	CHECK(ioctl(channel, CM_DMA_IOC_SUBMIT, &args) == -1 && errno == EINVAL);
	args.flags = CM_DMA_SUBMIT_CYCLIC;
	args.length = 100;
	args.period = 33;
	CHECK(ioctl(channel, CM_DMA_IOC_SUBMIT, &args) == -1 && errno == EINVAL);
	CHECK(ioctl(channel, CM_DMA_IOC_FREE, &gone) == -1 && errno == ENOENT);
	fcntl(channel, F_SETFL, O_NONBLOCK);
	CHECK(read(channel, &completion, sizeof(completion)) == -1 && errno == EAGAIN);
	CHECK(read(channel, &completion, 8) == -1 && errno == EINVAL);
	fcntl(channel, F_SETFL, 0);
	release(&buffer);
}

static void test_source(int channel)
{
	struct buffer buffer = allocate(channel, 65536);
	struct cm_dma_completion completion, both[2];
	struct cm_buffer_free args = { .size = sizeof(args), .handle = buffer.handle };
	uint32_t *words = (uint32_t *)buffer.data;
	struct dma_buf_sync sync = { .flags = DMA_BUF_SYNC_START | DMA_BUF_SYNC_READ };

	CHECK(submit(channel, buffer.handle, 0, 8192, 42) == 0);
	CHECK(next(channel, &completion) == 0);
	CHECK(completion.cookie == 42 && completion.length == 4096);
	CHECK(ioctl(buffer.fd, DMA_BUF_IOCTL_SYNC, &sync) == 0);
	CHECK(words[1] == words[0] + 1 && words[1023] == words[0] + 1023 && words[1024] == 0);
	fault("camera", "short_next", 100);
	CHECK(submit(channel, buffer.handle, 0, 4096, 1) == 0);
	CHECK(next(channel, &completion) == 0 && completion.length == 100);
	fault("camera", "fail_next", 1);
	CHECK(submit(channel, buffer.handle, 0, 4096, 2) == 0);
	CHECK(next(channel, &completion) == -EIO);
	fault("camera", "hang", 1);
	CHECK(submit(channel, buffer.handle, 0, 4096, 3) == 0);
	CHECK(submit(channel, buffer.handle, 4096, 4096, 4) == 0);
	CHECK(ioctl(channel, CM_DMA_IOC_FREE, &args) == -1 && errno == EBUSY);
	CHECK(cancel(channel) == 0);
	CHECK(read(channel, both, sizeof(both)) == sizeof(both));
	CHECK(both[0].status == -ECANCELED && both[0].cookie == 3);
	CHECK(both[1].status == -ECANCELED && both[1].cookie == 4);
	CHECK(both[1].sequence == both[0].sequence + 1);
	fault("camera", "hang", 0);
	CHECK(ioctl(channel, CM_DMA_IOC_FREE, &args) == 0);
	release(&buffer);
}

static void test_depth(int channel)
{
	struct buffer buffer = allocate(channel, 4096);
	struct cm_dma_completion completion;
	int i, done = 0;

	fault("camera", "hang", 1);
	for (i = 0; i < 64; i++)
		done += submit(channel, buffer.handle, 0, 4096, i) == 0;
	CHECK(done == 64);
	CHECK(submit(channel, buffer.handle, 0, 4096, 64) == -1 && errno == EBUSY);
	fault("camera", "hang", 0);
	for (i = 0; i < 64 && next(channel, &completion) == 0; i++)
		if (completion.cookie != (__u64)i)
			break;
	CHECK(i == 64);
	release(&buffer);
}

static uint64_t frames_made(void)
{
	char path[256], text[32] = {};
	int fd;

	snprintf(path, sizeof(path), "%s/camera/frames", engine);
	fd = open(path, O_RDONLY);
	if (fd < 0 || read(fd, text, sizeof(text) - 1) < 0) {
		perror(path);
		exit(1);
	}
	close(fd);
	return strtoull(text, NULL, 0);
}

/* so many periods have ended since, however slow the machine is */
static int periods_end(int count)
{
	uint64_t end = frames_made() + count + 1; /* the last one counted may not have ended */

	for (int i = 0; i < 3000; i++) {
		if (frames_made() >= end)
			return 1;
		usleep(10000);
	}
	return 0;
}

static void test_cyclic(int channel)
{
	struct buffer buffer = allocate(channel, 4 * 4096);
	struct cm_dma_submit args = { .size = sizeof(args), .flags = CM_DMA_SUBMIT_CYCLIC,
				      .handle = buffer.handle, .length = 4 * 4096, .period = 4096,
				      .cookie = 7 };
	struct cm_dma_completion completion, waiting[8];
	__u64 sequence;

	CHECK(submit(channel, buffer.handle, 0, 4096, 6) == 0);
	CHECK(next(channel, &completion) == 0 && completion.cookie == 6);
	sequence = completion.sequence + 1;
	CHECK(ioctl(channel, CM_DMA_IOC_SUBMIT, &args) == 0);
	CHECK(submit(channel, buffer.handle, 0, 4096, 8) == -1 && errno == EBUSY);
	CHECK(next(channel, &completion) == 0 && completion.cookie == 7);
	/* a slow machine has lost some by now, and is told so */
	CHECK(completion.length == 4096 && !(completion.flags & CM_DMA_COMPLETION_OVERRUN) ==
					   (completion.sequence == sequence));
	sequence = completion.sequence;
	CHECK(periods_end(8));
	CHECK(next(channel, &completion) == 0);
	CHECK(completion.flags & CM_DMA_COMPLETION_OVERRUN && completion.sequence > sequence + 4);
	/* one that is refused changes nothing: three of four periods can be read */
	args.length = 4096;
	CHECK(ioctl(channel, CM_DMA_IOC_SUBMIT, &args) == -1 && errno == EBUSY);
	CHECK(periods_end(8));
	/* or more, where some end meanwhile */
	CHECK(read(channel, waiting, sizeof(waiting)) >= (ssize_t)(3 * sizeof(*waiting)));
	CHECK(cancel(channel) == 0);
	while (next(channel, &completion) == 0)
		;
	CHECK(completion.status == -ECANCELED);
	release(&buffer);
}

static void test_video(int channel)
{
	struct buffer buffer = allocate(channel, 65536);
	struct cm_dma_submit_video args = { .size = sizeof(args), .handle = buffer.handle,
					    .lines = 16, .line_bytes = 256, .stride = 1024,
					    .cookie = 9 };
	struct cm_dma_completion completion;
	uint32_t *words = (uint32_t *)buffer.data;

	CHECK(ioctl(channel, CM_DMA_IOC_SUBMIT_VIDEO, &args) == 0);
	CHECK(next(channel, &completion) == 0 && completion.length == 4096);
	CHECK(words[63] == words[0] + 63 && words[64] == 0 && words[256] == words[0] + 64);
	args.flags = CM_DMA_SUBMIT_CYCLIC;
	CHECK(ioctl(channel, CM_DMA_IOC_SUBMIT_VIDEO, &args) == 0);
	CHECK(next(channel, &completion) == 0 && next(channel, &completion) == 0);
	CHECK(cancel(channel) == 0);
	while (next(channel, &completion) == 0)
		;
	CHECK(completion.status == -ECANCELED);
	/* now that there is room in the queue, which a slow machine has filled */
	args.stride = 100;
	CHECK(ioctl(channel, CM_DMA_IOC_SUBMIT_VIDEO, &args) == -1 && errno == EINVAL);
	release(&buffer);
}

static void test_loopback(void)
{
	int tx = open_channel("to_pl"), rx = open_channel("from_pl");
	struct buffer out = allocate(tx, 1 << 20), in = allocate(rx, 1 << 20);
	struct cm_buffer_import import = { .size = sizeof(import) };
	struct cm_dma_completion completion;
	size_t i;

	for (i = 0; i < out.length; i++)
		out.data[i] = i * 7;
	CHECK(submit(rx, in.handle, 0, 1 << 20, 1) == 0);
	CHECK(submit(tx, out.handle, 0, 1 << 20, 2) == 0);
	CHECK(next(tx, &completion) == 0 && completion.cookie == 2);
	CHECK(next(rx, &completion) == 0 && completion.length == 1 << 20);
	CHECK(!memcmp(out.data, in.data, 1 << 20));
	CHECK(submit(tx, out.handle, 4, 1000, 3) == 0);
	CHECK(submit(rx, in.handle, 0, 4096, 4) == 0);
	CHECK(next(rx, &completion) == 0 && completion.length == 1000);
	CHECK(!memcmp(out.data + 4, in.data, 1000) && next(tx, &completion) == 0);
	/* what was received goes out again without a copy */
	import.fd = in.fd;
	CHECK(ioctl(tx, CM_DMA_IOC_IMPORT, &import) == 0);
	CHECK(import.handle && import.length == in.length);
	CHECK(submit(tx, import.handle, 0, 1000, 5) == 0);
	CHECK(submit(rx, in.handle, 8192, 1000, 6) == 0);
	CHECK(next(rx, &completion) == 0 && !memcmp(in.data, in.data + 8192, 1000));
	import.fd = 0;
	CHECK(ioctl(tx, CM_DMA_IOC_IMPORT, &import) == -1 && errno == EINVAL);
	close(tx);
	close(rx);
	CHECK(in.data[0] == out.data[4]);
	release(&in);
	release(&out);
}

static void test_death(void)
{
	pid_t child = fork();
	int status, channel;

	if (!child) {
		struct buffer buffer;

		channel = open_channel("camera");
		buffer = allocate(channel, 1 << 20);
		fault("camera", "delay_us", 20000);
		for (int i = 0; i < 64; i++)
			submit(channel, buffer.handle, i * 4096, 4096, i);
		raise(9);
	}
	waitpid(child, &status, 0);
	fault("camera", "delay_us", 0);
	channel = open_channel("camera");
	CHECK(channel >= 0);
	close(channel);
}

/* handles can be guessed: another process frees them while they are made */
static void test_guessed_handles(int channel)
{
	pid_t guesser = fork();
	int status, made = 0;

	if (!guesser) {
		struct cm_buffer_free args = { .size = sizeof(args) };

		for (;;) {
			args.handle = args.handle % 8 + 1;
			ioctl(channel, CM_DMA_IOC_FREE, &args);
		}
	}
	for (int i = 0; i < 2000; i++) {
		struct cm_buffer_alloc args = { .size = sizeof(args), .length = 4096 };

		if (ioctl(channel, CM_DMA_IOC_ALLOC, &args))
			continue;
		made++;
		/* the memory is there, whatever became of the handle */
		if (lseek(args.fd, 0, SEEK_END) != (off_t)args.length)
			made = -1000000;
		if (i % 4 == 0) {
			struct cm_buffer_import import = { .size = sizeof(import), .fd = args.fd };

			ioctl(channel, CM_DMA_IOC_IMPORT, &import);
		}
		close(args.fd);
	}
	kill(guesser, SIGKILL);
	waitpid(guesser, &status, 0);
	CHECK(made == 2000);
}

static void test_bad_answers(int channel)
{
	struct cm_buffer_alloc args = { .size = sizeof(args), .length = 4096 };
	struct cm_buffer_free give = { .size = sizeof(give) };
	size_t page = sysconf(_SC_PAGESIZE);
	struct buffer buffer = allocate(channel, 4096);
	void *fixed = mmap(NULL, page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);

	/* where the answer cannot be written, neither handle nor descriptor is left */
	memcpy(fixed, &args, sizeof(args));
	mprotect(fixed, page, PROT_READ);
	CHECK(ioctl(channel, CM_DMA_IOC_ALLOC, fixed) == -1 && errno == EFAULT);
	give.handle = buffer.handle + 1;
	CHECK(ioctl(channel, CM_DMA_IOC_FREE, &give) == -1 && errno == ENOENT);
	/* a private mapping would be a copy */
	CHECK(mmap(NULL, page, PROT_READ, MAP_PRIVATE, buffer.fd, 0) == MAP_FAILED);
	munmap(fixed, page);
	release(&buffer);
}

static void prepare_submit(int fd, void *args)
{
	struct cm_dma_submit *submit = args;
	struct cm_buffer_alloc alloc;

	make_buffer(fd, &alloc);
	close(alloc.fd);
	submit->handle = alloc.handle;
	submit->length = 4096;
}

static void prepare_video(int fd, void *args)
{
	struct cm_dma_submit_video *submit = args;
	struct cm_buffer_alloc alloc;

	make_buffer(fd, &alloc);
	close(alloc.fd);
	submit->handle = alloc.handle;
	submit->lines = 4;
	submit->line_bytes = 256;
	submit->stride = 256;
}

static void undo_submit(int fd, void *args)
{
	struct cm_dma_cancel cancel = { .size = sizeof(cancel) };
	struct cm_dma_completion completion;

	ioctl(fd, CM_DMA_IOC_CANCEL, &cancel);
	while (read(fd, &completion, sizeof(completion)) > 0)
		;
	free_buffer(fd, made);
}

static void test_sizes(void)
{
	static const __u32 info[] = { CM_DMA_INFO_SIZE_VER0, 0 };
	static const __u32 submit[] = { CM_DMA_SUBMIT_SIZE_VER0, 0 };
	static const __u32 video[] = { CM_DMA_SUBMIT_VIDEO_SIZE_VER0, 0 };
	static const __u32 cancel[] = { CM_DMA_CANCEL_SIZE_VER0, 0 };
	int channel = open_channel("vcam");

	_Static_assert(sizeof(struct cm_dma_info) == CM_DMA_INFO_SIZE_VER0, "info");
	_Static_assert(sizeof(struct cm_dma_submit) == CM_DMA_SUBMIT_SIZE_VER0, "submit");
	_Static_assert(sizeof(struct cm_dma_submit_video) == CM_DMA_SUBMIT_VIDEO_SIZE_VER0, "video");
	_Static_assert(sizeof(struct cm_dma_cancel) == CM_DMA_CANCEL_SIZE_VER0, "cancel");
	CHECK(channel >= 0);
	fcntl(channel, F_SETFL, O_NONBLOCK);
	check_buffer_sizes(channel, 0);
	check_sizes(channel, 0, info, nothing, nothing);
	check_sizes(channel, 4, submit, prepare_submit, undo_submit);
	check_sizes(channel, 5, video, prepare_video, undo_submit);
	check_sizes(channel, 6, cancel, nothing, nothing);
	close(channel);
}

int main(int argc, char **argv)
{
	int channel;

	if (argc != 2) {
		fprintf(stderr, "usage: %s DEBUGFS-FOLDER\n", argv[0]);
		return 2;
	}
	engine = argv[1];
	setvbuf(stdout, NULL, _IOLBF, 0);
	CHECK(open_channel("nothing") == -1 && errno == ENOENT);
	channel = open_channel("camera");
	CHECK(channel >= 0);
	test_info(channel);
	test_refusals(channel);
	test_source(channel);
	test_depth(channel);
	test_cyclic(channel);
	test_video(channel);
	test_bad_answers(channel);
	test_guessed_handles(channel);
	close(channel);
	test_loopback();
	test_death();
	test_sizes();
	printf("%s: %d failures\n", failures ? "FAIL" : "PASS", failures);
	return failures != 0;
}
