// SPDX-License-Identifier: GPL-2.0-only
/*
 * Exercises /dev/cm_icap0 against cm_plsim's configuration port, in a virtual
 * machine.  Prints one line a check; exit status 0 where all hold.
 *
 *	smoke_icap DEBUGFS-FOLDER-OF-THE-ENGINE
 */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include "cm_icap.h"
#include "smoke.h"

#define IDCODE 0x03727093
#define FRAME_WORDS 1010

static uint32_t crc37(uint32_t crc, uint32_t address, uint32_t data)
{
	uint64_t bits = (uint64_t)address << 32 | data;

	for (int i = 0; i < 37; i++, bits >>= 1)
		crc = ((crc ^ bits) & 1) ? crc >> 1 ^ 0x82F63B78 : crc >> 1;
	return crc;
}

struct stream {
	uint32_t *words;
	size_t count;
	uint32_t crc;
};

static void put(struct stream *stream, uint32_t word)
{
	stream->words[stream->count++] = word;
}

static void write_register(struct stream *stream, uint32_t address, uint32_t value)
{
	put(stream, 0x30000001 | address << 13);
	put(stream, value);
	stream->crc = crc37(stream->crc, address, value);
}

static size_t assemble(uint32_t *words, uint32_t idcode)
{
	struct stream stream = { .words = words };

	put(&stream, 0xFFFFFFFF);
	put(&stream, 0xAA995566);
	put(&stream, 0x20000000);
	write_register(&stream, 4, 7); /* CMD RCRC */
	stream.crc = 0;
	write_register(&stream, 12, idcode);
	write_register(&stream, 1, 0x00400000); /* FAR */
	put(&stream, 0x30004000);
	put(&stream, 0x50000000 | FRAME_WORDS);
	for (uint32_t i = 0; i < FRAME_WORDS; i++) {
		put(&stream, i * 2654435761u);
		stream.crc = crc37(stream.crc, 2, i * 2654435761u);
	}
	put(&stream, 0x30000001);
	put(&stream, stream.crc);
	stream.crc = 0;
	write_register(&stream, 4, 13); /* CMD DESYNC */
	return stream.count * sizeof(*words);
}

static int load(int port, __u32 handle, __u64 length, __u64 cookie)
{
	struct cm_icap_load args = { .size = sizeof(args), .handle = handle, .length = length,
				     .cookie = cookie };

	return ioctl(port, CM_ICAP_IOC_LOAD, &args);
}

static int finished(int port, struct cm_icap_completion *completion)
{
	struct pollfd waiter = { .fd = port, .events = POLLIN };

	if (poll(&waiter, 1, 60000) != 1 ||
	    read(port, completion, sizeof(*completion)) != sizeof(*completion))
		return 1;
	return completion->status;
}

static uint64_t loads_ended(int port)
{
	struct cm_icap_status status = { .size = sizeof(status) };

	return ioctl(port, CM_ICAP_IOC_STATUS, &status) ? 0 : status.loads;
}

/* the file hears of a load's end a little later than the port's status says it */
static int load_soon(int port, uint32_t handle, size_t length, uint64_t cookie)
{
	int i;

	for (i = 0; i < 60000; i++) {
		if (!load(port, handle, length, cookie))
			return 0;
		if (errno != EBUSY)
			break;
		usleep(1000);
	}
	return -1;
}

/* unread completions are kept, up to a limit */
static void test_unread(int port, uint32_t handle, size_t length)
{
	struct cm_icap_completion completion;
	uint64_t before;
	int i, k;

	for (i = 0; i < 64; i++) {
		before = loads_ended(port);
		if (load_soon(port, handle, length, i))
			break;
		for (k = 0; loads_ended(port) == before && k < 60000; k++)
			usleep(1000);
	}
	CHECK(i == 64);
	CHECK(load(port, handle, length, 64) == -1 && errno == EBUSY);
	CHECK(finished(port, &completion) == 0 && completion.cookie == 0);
	CHECK(load_soon(port, handle, length, 64) == 0);
	for (i = 1; i < 65; i++)
		if (finished(port, &completion) || completion.cookie != (uint64_t)i)
			break;
	CHECK(i == 65);
}

static __u32 loaded;
static __u64 loads_before;

static struct cm_icap_status status_of(int port)
{
	struct cm_icap_status status = { .size = sizeof(status) };

	CHECK(ioctl(port, CM_ICAP_IOC_STATUS, &status) == 0);
	return status;
}

/* one word is taken, and ends in an error of its own */
static void prepare_load(int port, void *args)
{
	struct cm_icap_load *load = args;

	load->handle = loaded;
	load->length = 4;
	loads_before = status_of(port).loads;
}

/* what was refused does not end */
static void undo_load(int port, void *args)
{
	struct cm_icap_completion completion;

	while (status_of(port).state == CM_ICAP_STATE_LOADING)
		usleep(1000);
	if (status_of(port).loads > loads_before)
		CHECK(finished(port, &completion) == -EIO);
}

/* the port's status register, by words behind those of a load */
#define REQUEST 15000
#define REPLY 15100
#define CLOSING 15200
#define STATUS_WORD 0x000078FC

static uint32_t *memory;

static void prepare_read(int port, void *args)
{
	static const uint32_t request[] = { 0xAA995566, 0x20000000, 0x2800E001, 0x20000000 };
	static const uint32_t closing[] = { 0x30008001, 13 };
	struct cm_icap_read *read = args;

	memcpy(memory + REQUEST, request, sizeof(request));
	memcpy(memory + CLOSING, closing, sizeof(closing));
	memory[REPLY] = 0;
	read->handle = loaded;
	read->request_offset = 4 * REQUEST;
	read->request_length = sizeof(request);
	read->reply_offset = 4 * REPLY;
	read->reply_length = 4;
	read->closing_offset = 4 * CLOSING;
	read->closing_length = sizeof(closing);
	loads_before = status_of(port).loads;
}

static void undo_read(int port, void *args)
{
	struct cm_icap_completion completion;

	while (status_of(port).state == CM_ICAP_STATE_LOADING)
		usleep(1000);
	if (status_of(port).loads == loads_before)
		return;
	CHECK(finished(port, &completion) == 0 && completion.length == 4);
	CHECK(memory[REPLY] == STATUS_WORD);
}

static int try_read(int port, __u64 reply_offset, __u64 reply_length)
{
	struct cm_icap_read args = { .size = sizeof(args) };

	prepare_read(port, &args);
	args.size = sizeof(args);
	args.reply_offset = reply_offset;
	args.reply_length = reply_length;
	return ioctl(port, CM_ICAP_IOC_READ, &args);
}

static void test_read(int port)
{
	struct cm_icap_completion completion;

	CHECK(try_read(port, 4 * REPLY, 4) == 0 && finished(port, &completion) == 0);
	CHECK(memory[REPLY] == STATUS_WORD);
	CHECK(try_read(port, 4 * REQUEST, 4) == -1 && errno == EINVAL);
	CHECK(try_read(port, 4 * CLOSING + 4, 4) == -1 && errno == EINVAL);
	CHECK(try_read(port, 4 * REPLY, 0) == -1 && errno == EINVAL);
	CHECK(try_read(port, 4 * REPLY + 2, 4) == -1 && errno == EINVAL);
	CHECK(try_read(port, 1 << 16, 4) == -1 && errno == EINVAL);
	CHECK(try_read(port, 4 * REPLY, ~3ULL) == -1 && errno == EINVAL);
	CHECK(try_read(port, 4 * REPLY, 8) == 0);
	CHECK(finished(port, &completion) == -ETIMEDOUT && completion.length == 4);
	fault("icap_read", "fail_next", 1);
	CHECK(try_read(port, 4 * REPLY, 4) == 0);
	CHECK(finished(port, &completion) == -EIO && completion.errors == CM_ICAP_ERR_DMA);
	CHECK(try_read(port, 4 * REPLY, 4) == 0 && finished(port, &completion) == 0);
}

static void test_sizes(int port, __u32 handle)
{
	static const __u32 read[] = { CM_ICAP_READ_SIZE_VER0, 0 };
	static const __u32 info[] = { CM_ICAP_INFO_SIZE_VER0, 0 };
	static const __u32 load[] = { CM_ICAP_LOAD_SIZE_VER0, 0 };
	static const __u32 status[] = { CM_ICAP_STATUS_SIZE_VER0, 0 };

	_Static_assert(sizeof(struct cm_icap_info) == CM_ICAP_INFO_SIZE_VER0, "info");
	_Static_assert(sizeof(struct cm_icap_load) == CM_ICAP_LOAD_SIZE_VER0, "load");
	_Static_assert(sizeof(struct cm_icap_read) == CM_ICAP_READ_SIZE_VER0, "read");
	_Static_assert(sizeof(struct cm_icap_status) == CM_ICAP_STATUS_SIZE_VER0, "status");
	loaded = handle;
	check_buffer_sizes(port, 0x20);
	check_sizes(port, 0x20, info, nothing, nothing);
	check_sizes(port, 0x24, load, prepare_load, undo_load);
	check_sizes(port, 0x25, status, nothing, nothing);
	check_sizes(port, 0x26, read, prepare_read, undo_read);
}

int main(int argc, char **argv)
{
	struct cm_buffer_alloc args = { .size = sizeof(args), .length = 1 << 16 };
	struct cm_icap_status status = { .size = sizeof(status) };
	struct cm_icap_info info = { .size = sizeof(info) };
	struct cm_icap_load bad = { .size = sizeof(bad) };
	struct cm_icap_completion completion;
	uint32_t *words;
	size_t length;
	unsigned long long loads;
	int port;

	if (argc != 2)
		return 2;
	engine = argv[1];
	setvbuf(stdout, NULL, _IOLBF, 0);
	port = open("/dev/cm_icap0", O_RDWR);
	CHECK(port >= 0);
	CHECK(ioctl(port, CM_ICAP_IOC_INFO, &info) == 0 && info.word_bits == 32);
	CHECK(info.idcode == IDCODE && info.caps == (CM_ICAP_CAP_STATUS | CM_ICAP_CAP_READ));
	CHECK(ioctl(port, CM_ICAP_IOC_ALLOC, &args) == 0);
	CHECK(args.address && args.address % 4096 == 0);
	words = mmap(NULL, args.length, PROT_READ | PROT_WRITE, MAP_SHARED, args.fd, 0);
	CHECK(words != MAP_FAILED);
	memory = words;
	length = assemble(words, IDCODE);

	CHECK(load(port, args.handle, length, 5) == 0);
	CHECK(finished(port, &completion) == 0);
	CHECK(completion.cookie == 5 && completion.length == length);
	CHECK(completion.started_ns && completion.finished_ns > completion.started_ns);
	CHECK(counter("icap", "frame_words") == FRAME_WORDS && counter("icap", "crc_checks") == 1);
	CHECK(counter("icap", "errors") == 0);
	CHECK(ioctl(port, CM_ICAP_IOC_STATUS, &status) == 0 && status.loads >= 1);
	CHECK(status.state == CM_ICAP_STATE_IDLE && status.bytes_done == length);

	words[200] ^= 1;
	CHECK(load(port, args.handle, length, 6) == 0);
	CHECK(finished(port, &completion) == -EILSEQ && completion.errors == CM_ICAP_ERR_CRC);
	CHECK(ioctl(port, CM_ICAP_IOC_STATUS, &status) == 0);
	CHECK(status.state == CM_ICAP_STATE_ERROR && status.errors == CM_ICAP_ERR_CRC);
	words[200] ^= 1;
	assemble(words, 0x03722093);
	CHECK(load(port, args.handle, length, 7) == 0);
	CHECK(finished(port, &completion) == -ENODEV && completion.errors == CM_ICAP_ERR_ID);
	assemble(words, IDCODE | 0xF0000000);
	CHECK(load(port, args.handle, length, 8) == 0 && finished(port, &completion) == 0);
	CHECK(load(port, args.handle, 4, 9) == 0);
	CHECK(finished(port, &completion) == -EIO && completion.errors == CM_ICAP_ERR_NOSYNC);
	CHECK(load(port, args.handle, 800, 9) == 0);
	CHECK(finished(port, &completion) == -ETIMEDOUT);
	fault("icap", "fail_next", 1);
	CHECK(load(port, args.handle, length, 10) == 0);
	CHECK(finished(port, &completion) == -EIO && completion.errors == CM_ICAP_ERR_DMA);
	fault("icap", "hang", 1);
	CHECK(load(port, args.handle, length, 11) == 0);
	CHECK(load(port, args.handle, length, 12) == -1 && errno == EBUSY);
	fault("icap", "hang", 0);
	CHECK(finished(port, &completion) == 0 && completion.cookie == 11);
	CHECK(load(port, args.handle, length, 13) == 0 && finished(port, &completion) == 0);

	CHECK(load(port, args.handle, 6, 0) == -1 && errno == EINVAL);
	CHECK(load(port, args.handle, 0, 0) == -1 && errno == EINVAL);
	CHECK(load(port, args.handle, 1 << 30, 0) == -1 && errno == EINVAL);
	CHECK(load(port, 99, length, 0) == -1 && errno == ENOENT);
	bad.handle = args.handle;
	bad.length = 8;
	bad.flags = 4;
	CHECK(ioctl(port, CM_ICAP_IOC_LOAD, &bad) == -1 && errno == EINVAL);

	test_unread(port, args.handle, length);
	test_sizes(port, args.handle);
	memory[REPLY] = 0;
	test_read(port);

	/* closing waits for the end of the load */
	loads = counter("icap", "loads");
	fault("icap", "delay_us", 50000);
	CHECK(load(port, args.handle, length, 14) == 0);
	close(port);
	CHECK(counter("icap", "loads") == loads + 1);
	fault("icap", "delay_us", 0);
	printf("%s: %d failures\n", failures ? "FAIL" : "PASS", failures);
	return failures != 0;
}
