// SPDX-License-Identifier: GPL-2.0-only
/*
 * Exercises cm_plsim's register window as a UIO device, in a virtual machine:
 * mapping, doorbell, interrupts and their mask, and its end under a reader.
 *
 *	smoke_uio DEBUGFS-FOLDER-OF-THE-ENGINE
 *
 * needs a window "camera" of 8192 bytes at 0x43c00000 with a doorbell at
 * 0x1000, on the same board in configfs as the engine.
 */
#include <errno.h>
#include <fcntl.h>
#include <glob.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include "smoke.h"

#define SIZE 8192
#define DOORBELL 0x1000
#define BOARDS "/sys/kernel/config/cm_plsim/*/dev_name"

static int number = -1;
static char fire_path[256], live_path[256];

static int put(const char *path, const char *text)
{
	int fd = open(path, O_WRONLY);
	ssize_t ret = -1;

	if (fd >= 0) {
		ret = write(fd, text, strlen(text));
		close(fd);
	}
	return ret < 0 ? -1 : 0;
}

/* a file's only line */
static void get_line(char *text, size_t size, const char *path)
{
	ssize_t length = -1;
	int fd = open(path, O_RDONLY);

	if (fd >= 0) {
		length = read(fd, text, size - 1);
		close(fd);
	}
	text[length > 0 ? length - 1 : 0] = 0;
}

static void get(char *text, size_t size, const char *name)
{
	char path[128];

	snprintf(path, sizeof(path), "/sys/class/uio/uio%d/%s", number, name);
	get_line(text, size, path);
}

/* the switch of the board that the engine belongs to */
static void find_board(const char *engine)
{
	const char *name = strrchr(engine, '/');
	char text[128];
	glob_t found;

	if (glob(BOARDS, 0, NULL, &found))
		return;
	for (size_t i = 0; i < found.gl_pathc; i++) {
		get_line(text, sizeof(text), found.gl_pathv[i]);
		if (name && !strcmp(text, name + 1))
			snprintf(live_path, sizeof(live_path), "%.*s/live",
				 (int)(strrchr(found.gl_pathv[i], '/') - found.gl_pathv[i]),
				 found.gl_pathv[i]);
	}
	globfree(&found);
}

/* the device of that name, and where its interrupts are raised */
static void find(void)
{
	char text[128], path[128];
	ssize_t length;

	for (number = 0; number < 32; number++) {
		get(text, sizeof(text), "name");
		if (!strcmp(text, "camera"))
			break;
	}
	snprintf(path, sizeof(path), "/sys/class/uio/uio%d/device", number);
	length = readlink(path, text, sizeof(text) - 1);
	text[length > 0 ? length : 0] = 0;
	snprintf(fire_path, sizeof(fire_path), "/sys/kernel/debug/cm_plsim/%s/fire",
		 strrchr(text, '/') ? strrchr(text, '/') + 1 : "");
}

static int open_uio(int flags)
{
	char path[32];

	snprintf(path, sizeof(path), "/dev/uio%d", number);
	return open(path, O_RDWR | flags);
}

static int ready(int fd, int timeout_ms)
{
	struct pollfd poller = { .fd = fd, .events = POLLIN };

	return poll(&poller, 1, timeout_ms) == 1 && poller.revents & POLLIN;
}

static int set_mask(int fd, uint32_t on)
{
	return write(fd, &on, sizeof(on)) == sizeof(on) ? 0 : -1;
}

static int64_t take(int fd)
{
	uint32_t count;

	return read(fd, &count, sizeof(count)) == sizeof(count) ? (int64_t)count : -1;
}

static void test_sizes(int fd)
{
	char text[8] = {};

	CHECK(read(fd, text, 2) == -1 && errno == EINVAL);
	CHECK(read(fd, text, 8) == -1 && errno == EINVAL);
	CHECK(write(fd, text, 2) == -1 && errno == EINVAL);
	CHECK(write(fd, text, 8) == -1 && errno == EINVAL);
	CHECK(put(fire_path, "1000000000000") == -1 && errno == EINVAL);
}

static volatile uint32_t *test_registers(int fd)
{
	volatile uint32_t *registers;
	char text[64];
	void *other;

	get(text, sizeof(text), "maps/map0/addr");
	CHECK(strtoull(text, NULL, 0) == 0x43c00000);
	get(text, sizeof(text), "maps/map0/size");
	CHECK(strtoull(text, NULL, 0) == SIZE);
	CHECK(mmap(NULL, 2 * SIZE, PROT_READ, MAP_SHARED, fd, 0) == MAP_FAILED);
	CHECK(mmap(NULL, 4096, PROT_READ, MAP_SHARED, fd, 4096) == MAP_FAILED);
	registers = mmap(NULL, SIZE, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
	if (registers == MAP_FAILED) {
		perror("mmap");
		exit(1);
	}
	other = mmap(NULL, SIZE, PROT_READ, MAP_SHARED, fd, 0);
	registers[1] = 0xC0FFEE00;
	registers[SIZE / 4 - 1] = 0x12345678;
	CHECK(((volatile uint32_t *)other)[1] == 0xC0FFEE00);
	CHECK(((volatile uint32_t *)other)[SIZE / 4 - 1] == 0x12345678);
	munmap(other, SIZE);
	return registers;
}

/* an interrupt masks itself; those meanwhile are one when it is unmasked */
static void test_mask(int fd)
{
	int64_t count;

	CHECK(!ready(fd, 0) && take(fd) == -1 && errno == EAGAIN);
	CHECK(put(fire_path, "1") == 0 && ready(fd, 60000));
	count = take(fd);
	CHECK(count >= 1);
	CHECK(!ready(fd, 0));
	CHECK(put(fire_path, "3") == 0 && !ready(fd, 20));
	CHECK(set_mask(fd, 1) == 0 && ready(fd, 60000) && take(fd) == count + 1);
	CHECK(set_mask(fd, 1) == 0 && !ready(fd, 20));
	CHECK(set_mask(fd, 0) == 0 && put(fire_path, "1") == 0 && !ready(fd, 20));
	CHECK(set_mask(fd, 1) == 0 && ready(fd, 60000) && take(fd) == count + 2);
	CHECK(set_mask(fd, 1) == 0);
	CHECK(put(fire_path, "5") == 0 && ready(fd, 60000) && take(fd) == count + 3);
	/* the other four came while it was masked */
	CHECK(!ready(fd, 20) && set_mask(fd, 1) == 0 && take(fd) == count + 4);
	CHECK(set_mask(fd, 1) == 0);
}

static void test_doorbell(int fd, volatile uint32_t *registers)
{
	registers[DOORBELL / 4] = 7;
	CHECK(ready(fd, 60000) && take(fd) >= 0);
	CHECK(registers[DOORBELL / 4] == 0);
	CHECK(set_mask(fd, 1) == 0 && !ready(fd, 20));
}

/* the device goes away while a process is blocked in read() */
static void test_unplug(int fd, volatile uint32_t *registers)
{
	int to_parent[2], blocking, status;
	pid_t child;
	char text;

	if (pipe(to_parent))
		exit(1);
	child = fork();
	if (!child) {
		uint32_t count;

		blocking = open_uio(0);
		if (write(to_parent[1], "b", 1) != 1)
			_exit(3);
		_exit(read(blocking, &count, sizeof(count)) == -1 && errno == EIO ? 0 : 1);
	}
	CHECK(read(to_parent[0], &text, 1) == 1);
	usleep(100000);
	CHECK(waitpid(child, &status, WNOHANG) == 0);
	CHECK(put(live_path, "0") == 0);
	CHECK(waitpid(child, &status, 0) == child && WIFEXITED(status) && !WEXITSTATUS(status));
	CHECK(take(fd) == -1 && errno == EIO);
	CHECK(set_mask(fd, 1) == -1);
	/* what was mapped stays */
	CHECK(registers[1] == 0xC0FFEE00);
	registers[1] = 1;
	CHECK(put(live_path, "1") == 0);
	/* it is another device now */
	find();
	blocking = open_uio(O_NONBLOCK);
	CHECK(blocking >= 0);
	registers = mmap(NULL, SIZE, PROT_READ | PROT_WRITE, MAP_SHARED, blocking, 0);
	CHECK(registers != MAP_FAILED && registers[1] == 0);
	CHECK(put(fire_path, "1") == 0 && ready(blocking, 60000) && take(blocking) == 1);
	munmap((void *)registers, SIZE);
	close(blocking);
}

int main(int argc, char **argv)
{
	volatile uint32_t *registers;
	int fd;

	if (argc != 2)
		return 2;
	setvbuf(stdout, NULL, _IOLBF, 0);
	find_board(argv[1]);
	CHECK(*live_path);
	find();
	fd = open_uio(O_NONBLOCK);
	CHECK(fd >= 0);
	/* as the previous user may have left it: masked, and one came meanwhile */
	CHECK(set_mask(fd, 1) == 0);
	take(fd);
	CHECK(set_mask(fd, 1) == 0);
	registers = test_registers(fd);
	test_sizes(fd);
	test_mask(fd);
	test_doorbell(fd, registers);
	test_unplug(fd, registers);
	munmap((void *)registers, SIZE);
	close(fd);
	printf("%s: %d failures\n", failures ? "FAIL" : "PASS", failures);
	return failures != 0;
}
