// SPDX-License-Identifier: GPL-2.0-only
/*
 * A program in libaxidma's manner against /dev/axidma, in a virtual machine.
 * The structures are written as C programs have them, with bool, enum, int and
 * pointers, so that a difference in layout shows.
 *
 *	smoke_axidma DEBUGFS-FOLDER-OF-THE-ENGINE [FIRST-ID]
 *
 * With FIRST-ID the channels come from a device tree, where that is the
 * lowest of their numbers; without it they are those of cm_dma, from 0.
 */
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include "cm_dma.h"
#include "smoke.h"

enum direction { TO_PL, FROM_PL };
enum type { PLAIN, VIDEO };

struct frame {
	int height;
	int width;
	int depth;
};

struct channel {
	enum direction direction;
	enum type type;
	int id;
	const char *name;
	void *chan;
};

struct counts {
	int all, dma_tx, dma_rx, vdma_tx, vdma_rx;
};

struct channels {
	struct channel *array;
};

struct registered {
	int fd;
	size_t size;
	void *address;
};

struct transfer {
	bool wait;
	int id;
	void *buffer;
	size_t length;
	union {
		struct frame frame;
	};
};

struct two_way {
	bool wait;
	int tx_id;
	void *tx;
	size_t tx_length;
	struct frame tx_frame;
	int rx_id;
	void *rx;
	size_t rx_length;
	struct frame rx_frame;
};

struct video {
	int id;
	int count;
	void **frames;
	struct frame frame;
};

#define GET_COUNTS _IOW('W', 0, struct counts)
#define GET_CHANNELS _IOR('W', 1, struct channels)
#define SET_SIGNAL _IO('W', 2)
#define REGISTER _IOR('W', 3, struct registered)
#define DMA_READ _IOR('W', 4, struct transfer)
#define DMA_WRITE _IOR('W', 5, struct transfer)
#define DMA_TWO_WAY _IOR('W', 6, struct two_way)
#define VIDEO_READ _IOR('W', 7, struct video)
#define STOP _IOR('W', 9, struct channel)
#define UNREGISTER _IO('W', 10)

#define LENGTH 65536

static volatile sig_atomic_t told, last_id = -1;

static void on_signal(int number, siginfo_t *info, void *context)
{
	(void)number;
	(void)context;
	told++;
	last_id = info->si_int;
}

static void *memory(int device, size_t length)
{
	return mmap(NULL, length, PROT_READ | PROT_WRITE, MAP_SHARED, device, 0);
}

static void await_signals(int count)
{
	for (int i = 0; told < count && i < 6000; i++)
		usleep(10000);
}

int main(int argc, char **argv)
{
	struct sigaction action = { .sa_sigaction = on_signal, .sa_flags = SA_RESTART | SA_SIGINFO };
	struct channel all[16];
	struct channels channels = { .array = all };
	struct cm_buffer_alloc alloc = { .size = sizeof(alloc), .length = LENGTH };
	struct registered registered = { .size = LENGTH };
	struct counts counts;
	struct transfer one = { .wait = true };
	struct two_way both = { .wait = true };
	struct video video = { .count = 2, .frame = { 16, 64, 4 } };
	struct channel stop = { 0 };
	int tx = -1, rx = -1, device, other, source = -1, first_id;
	bool tree = argc == 3;
	uint8_t *out, *in, *frames;
	uint64_t made, newest;
	void *addresses[2];

	if (argc != 2 && argc != 3)
		return 2;
	engine = argv[1];
	first_id = tree ? atoi(argv[2]) : 0;
	setvbuf(stdout, NULL, _IOLBF, 0);
	video.id = -1;
	device = open("/dev/axidma", O_RDWR | O_EXCL);
	CHECK(device >= 0);
	CHECK(open("/dev/axidma", O_RDWR | O_EXCL) == -1 && errno == EBUSY);
	if (!tree)
		CHECK(open("/dev/cm_dma/to_pl", O_RDWR) == -1 && errno == EBUSY);
	CHECK(ioctl(device, GET_COUNTS, &counts) == 0);
	CHECK(counts.all == 5 && counts.dma_tx == 2 && counts.dma_rx == 2 && counts.vdma_rx == 1);
	memset(all, 0xff, sizeof(all));
	CHECK(ioctl(device, GET_CHANNELS, &channels) == 0);
	for (int i = 0; i < counts.all; i++) {
		CHECK(!all[i].name && !all[i].chan && all[i].id == first_id + i);
		if (all[i].type == VIDEO)
			video.id = all[i].id;
		else if (all[i].direction == TO_PL && tx < 0)
			tx = all[i].id;
		else if (all[i].direction == FROM_PL && rx < 0)
			rx = all[i].id;
		else if (all[i].direction == FROM_PL)
			source = all[i].id;
	}
	CHECK(tx >= 0 && rx >= 0 && source >= 0 && video.id >= 0);

	out = memory(device, LENGTH);
	in = memory(device, LENGTH);
	CHECK(out != MAP_FAILED && in != MAP_FAILED);
	for (int i = 0; i < LENGTH; i++)
		out[i] = i * 31;
	both.tx_id = tx;
	both.tx = out;
	both.tx_length = LENGTH;
	both.rx_id = rx;
	both.rx = in;
	both.rx_length = LENGTH;
	CHECK(ioctl(device, DMA_TWO_WAY, &both) == 0 && !memcmp(out, in, LENGTH));

	sigaction(SIGRTMIN, &action, NULL);
	CHECK(ioctl(device, SET_SIGNAL, 5) == -1 && errno == EINVAL);
	CHECK(ioctl(device, SET_SIGNAL, SIGRTMIN) == 0);
	told = 0;
	one.wait = false;
	one.id = rx;
	one.buffer = in + 4096;
	one.length = 1000;
	CHECK(ioctl(device, DMA_READ, &one) == 0);
	one.wait = true;
	one.id = tx;
	one.buffer = out;
	CHECK(ioctl(device, DMA_WRITE, &one) == 0);
	await_signals(1);
	CHECK(told == 1 && last_id == rx && !memcmp(out, in + 4096, 1000));

	one.length = LENGTH + 1;
	CHECK(ioctl(device, DMA_WRITE, &one) == -1 && errno == EFAULT);
	one.length = SIZE_MAX;
	CHECK(ioctl(device, DMA_WRITE, &one) == -1 && errno == EFAULT);
	one.buffer = &one;
	one.length = 16;
	CHECK(ioctl(device, DMA_WRITE, &one) == -1 && errno == EFAULT);
	one.buffer = out;
	one.id = rx;
	CHECK(ioctl(device, DMA_WRITE, &one) == -1 && errno == ENODEV);
	one.id = 99;
	CHECK(ioctl(device, DMA_WRITE, &one) == -1 && errno == ENODEV);
	CHECK(ioctl(device, DMA_WRITE, NULL) == -1 && errno == EFAULT);
	CHECK(ioctl(device, GET_CHANNELS, (void *)8) == -1 && errno == EFAULT);

	fault("camera", "fail_next", 1);
	one.id = source;
	one.length = 4096;
	one.buffer = in;
	CHECK(ioctl(device, DMA_READ, &one) == -1 && errno == EIO);
	CHECK(ioctl(device, DMA_READ, &one) == 0);

	/* memory unmapped during a transfer stays until it has ended */
	fault("camera", "hang", 1);
	frames = memory(device, LENGTH);
	one.wait = false;
	one.buffer = frames;
	CHECK(ioctl(device, DMA_READ, &one) == 0 && munmap(frames, LENGTH) == 0);
	fault("camera", "hang", 0);
	usleep(50000);
	CHECK(ioctl(device, DMA_READ, &one) == -1 && errno == EFAULT);
	fault("camera", "hang", 1);
	one.buffer = in;
	CHECK(ioctl(device, DMA_READ, &one) == 0);
	stop.id = source;
	CHECK(ioctl(device, STOP, &stop) == 0);
	fault("camera", "hang", 0);

	/* two frames in turn; a source without an interval makes one when it is asked */
	fault("vcam", "interval_us", 0);
	frames = memory(device, LENGTH);
	addresses[0] = frames;
	addresses[1] = frames + 4096;
	video.frames = addresses;
	made = counter("vcam", "frames");
	CHECK(ioctl(device, VIDEO_READ, &video) == 0);
	CHECK(ioctl(device, VIDEO_READ, &video) == -1 && errno == EBUSY);
	for (int i = 0; counter("vcam", "frames") < made + 10 && i < 3000; i++)
		usleep(10000);
	stop.id = video.id;
	CHECK(ioctl(device, STOP, &stop) == 0);
	newest = counter("vcam", "frames") - 1;
	CHECK(newest >= made + 9);
	usleep(50000);
	CHECK(counter("vcam", "frames") == newest + 1);
	/* the last two, each whole, in either order */
	for (int i = 0; i < 2; i++) {
		const uint32_t *words = (uint32_t *)(frames + 4096 * i);
		int wrong = 0;

		for (int k = 0; k < 1024; k++)
			wrong += words[k] != words[0] + k;
		CHECK(!wrong);
		CHECK(words[0] == newest || words[0] == newest - 1);
	}
	CHECK(((uint32_t *)frames)[0] != ((uint32_t *)frames)[1024]);
	fault("vcam", "interval_us", 2000);
	video.frame.height = 1 << 30;
	CHECK(ioctl(device, VIDEO_READ, &video) == -1 && errno == EFAULT);
	video.frame.height = 16;
	addresses[1] = frames + LENGTH - 4095;
	CHECK(ioctl(device, VIDEO_READ, &video) == -1 && errno == EFAULT);
	/* more lines than a VDMA counts */
	addresses[1] = frames;
	video.frame = (struct frame){ 8192, 1, 4 };
	CHECK(ioctl(device, VIDEO_READ, &video) == -1 && errno == EMSGSIZE);
	video.frame = (struct frame){ 16, 64, 4 };
	video.count = 1000;
	CHECK(ioctl(device, VIDEO_READ, &video) == -1 && errno == EINVAL);

	/* a dma-buf of another device; here of the port's node */
	other = open("/dev/cm_icap0", O_RDWR);
	CHECK(other >= 0 && ioctl(other, _IOWR(CM_IOC_MAGIC, 0x21, struct cm_buffer_alloc), &alloc) == 0);
	registered.fd = alloc.fd;
	registered.address = mmap(NULL, LENGTH, PROT_READ | PROT_WRITE, MAP_SHARED, alloc.fd, 0);
	CHECK(registered.address != MAP_FAILED);
	CHECK(ioctl(device, REGISTER, &registered) == 0);
	memset(registered.address, 0x5a, LENGTH);
	both.tx = registered.address;
	CHECK(ioctl(device, DMA_TWO_WAY, &both) == 0 && in[0] == 0x5a && in[LENGTH - 1] == 0x5a);
	CHECK(ioctl(device, UNREGISTER, registered.address) == 0);
	CHECK(ioctl(device, UNREGISTER, registered.address) == -1 && errno == ENOENT);
	CHECK(ioctl(device, DMA_TWO_WAY, &both) == -1 && errno == EFAULT);
	registered.size = LENGTH * 2;
	CHECK(ioctl(device, REGISTER, &registered) == -1 && errno == EINVAL);

	close(device);
	CHECK(open("/dev/axidma", O_RDWR) == -1 && errno == EBUSY); /* the mappings hold the file */
	munmap(in, LENGTH);
	munmap(out, LENGTH);
	munmap(frames, LENGTH);
	CHECK(open("/dev/axidma", O_RDWR) >= 0);
	printf("%s: %d failures\n", failures ? "FAIL" : "PASS", failures);
	return failures != 0;
}
