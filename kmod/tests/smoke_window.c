// SPDX-License-Identifier: GPL-2.0-only
/*
 * Exercises /dev/cm_window against a register window of cm_plsim, in a virtual
 * machine.  Prints one line a check; exit status 0 where all hold.
 *
 *	smoke_window DEBUGFS-FOLDER-OF-THE-ENGINE
 *
 * The window is /dev/uio0, at 0x43c00000, of 8192 bytes.
 */
#define _GNU_SOURCE
#include <poll.h>
#include <signal.h>
#include <stdint.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <sys/wait.h>
#include <time.h>

#include "cm_window.h"
#include "smoke.h"

#define ADDRESS 0x43c00000ULL
#define LENGTH 8192
#define PAGE 4096
#define OURS 0x600D600Du   /* the module that was lent */
#define OTHERS 0xBADBADu   /* the one that came after it */
#define READERS 3
#define ROUNDS 30

/* a grant, mapped as a client does it */
struct mapped {
	__u32 id;
	int fd;
	volatile struct cm_window_state *state;
	volatile uint32_t *registers;
};

static volatile uint32_t *hardware; /* the window as its owner sees it */

static struct mapped lend(int node, __u32 flags)
{
	struct cm_window_grant args = { .size = sizeof(args), .flags = flags, .address = ADDRESS,
					.length = LENGTH };
	struct mapped mapped = { .fd = -1 };

	if (ioctl(node, CM_WINDOW_IOC_GRANT, &args))
		return mapped;
	mapped.id = args.id;
	mapped.fd = args.fd;
	mapped.state = mmap(NULL, PAGE, PROT_READ, MAP_SHARED, args.fd, 0);
	mapped.registers = mmap(NULL, LENGTH,
				PROT_READ | (flags & CM_WINDOW_WRITE ? PROT_WRITE : 0), MAP_SHARED,
				args.fd, PAGE);
	return mapped;
}

static void give_back(struct mapped *mapped)
{
	munmap((void *)mapped->state, PAGE);
	munmap((void *)mapped->registers, LENGTH);
	close(mapped->fd);
}

static int take_back(int node, __u64 address, __u64 length, __u32 id, __u32 *count)
{
	struct cm_window_revoke args = { .size = sizeof(args), .address = address,
					 .length = length, .id = id };
	int ret = ioctl(node, CM_WINDOW_IOC_REVOKE, &args);

	if (count)
		*count = args.count;
	return ret;
}

/* all that waits, forgotten */
static int drain(int node)
{
	struct cm_window_event events[16];
	struct pollfd wait = { .fd = node, .events = POLLIN };
	int count = 0;

	while (poll(&wait, 1, 0) > 0)
		count += read(node, events, sizeof(events)) / sizeof(events[0]);
	return count;
}

static void prepare_grant(int node, void *args)
{
	struct cm_window_grant *grant = args;

	grant->address = ADDRESS;
	grant->length = PAGE;
	grant->fd = -1;
}

static void undo_grant(int node, void *args)
{
	struct cm_window_grant *grant = args;

	if (grant->fd > 0)
		close(grant->fd);
}

static void prepare_revoke(int node, void *args)
{
	struct cm_window_revoke *range = args;

	range->address = ADDRESS;
	range->length = PAGE;
}

static void test_sizes(int node)
{
	static const __u32 grant[] = { CM_WINDOW_GRANT_SIZE_VER0, 0 };
	static const __u32 take[] = { CM_WINDOW_REVOKE_SIZE_VER0, 0 };

	_Static_assert(sizeof(struct cm_window_grant) == CM_WINDOW_GRANT_SIZE_VER0, "grant");
	_Static_assert(sizeof(struct cm_window_revoke) == CM_WINDOW_REVOKE_SIZE_VER0, "revoke");
	check_sizes(node, 0x40, grant, prepare_grant, undo_grant);
	check_sizes(node, 0x41, take, prepare_revoke, nothing);
	drain(node);
}

static int refused(int node, __u64 address, __u64 length, __u32 flags)
{
	struct cm_window_grant args = { .size = sizeof(args), .flags = flags, .address = address,
					.length = length };

	return ioctl(node, CM_WINDOW_IOC_GRANT, &args) ? errno : 0;
}

static void test_refusals(int node)
{
	CHECK(refused(node, ADDRESS + 16, PAGE, 0) == EINVAL);
	CHECK(refused(node, ADDRESS, 16, 0) == EINVAL);
	CHECK(refused(node, ADDRESS, 0, 0) == EINVAL);
	CHECK(refused(node, ADDRESS, PAGE, 2) == EINVAL);
	CHECK(refused(node, ~0ULL & ~(__u64)(PAGE - 1), 2 * PAGE, 0) == EINVAL);
	CHECK(refused(node, ADDRESS, LENGTH + PAGE, 0) == ENXIO);
	CHECK(refused(node, ADDRESS - PAGE, PAGE, 0) == ENXIO);
	CHECK(refused(node, 0x1000, PAGE, 0) == ENXIO);
	CHECK(take_back(node, 0, 0, 77, NULL) == -1 && errno == ENOENT);
	CHECK(take_back(node, 0, 0, 0, NULL) == -1 && errno == EINVAL);
	CHECK(take_back(node, ADDRESS, PAGE, 1, NULL) == -1 && errno == EINVAL);
}

static void test_access(int node)
{
	struct mapped mapped = lend(node, CM_WINDOW_WRITE);
	__u32 count;

	CHECK(mapped.registers != MAP_FAILED && mapped.state != MAP_FAILED);
	CHECK(mapped.state->revoked == 0 && mapped.state->length == LENGTH);
	CHECK(mapped.state->flags == CM_WINDOW_WRITE);
	hardware[5] = OURS;
	CHECK(mapped.registers[5] == OURS);
	mapped.registers[1030] = 17;
	CHECK(hardware[1030] == 17);
	CHECK(take_back(node, ADDRESS + PAGE, PAGE, 0, &count) == 0 && count == 1);
	CHECK(mapped.state->revoked == CM_WINDOW_REVOKED_CALL);
	CHECK(mapped.registers[5] == ~0u && mapped.registers[1030] == ~0u);
	mapped.registers[1030] = 18;
	CHECK(hardware[1030] == 17);
	CHECK(take_back(node, ADDRESS, LENGTH, 0, &count) == 0 && count == 0);
	give_back(&mapped);
}

static void test_mappings_for_reading(int node)
{
	struct mapped mapped = lend(node, 0);
	void *page = (void *)mapped.registers;
	int again = dup(mapped.fd);

	CHECK(mapped.registers != MAP_FAILED);
	CHECK(mprotect(page, PAGE, PROT_READ | PROT_WRITE) == -1 && errno == EACCES);
	CHECK(mprotect(page, PAGE, PROT_READ | PROT_EXEC) == -1 && errno == EACCES);
	CHECK(mmap(NULL, PAGE, PROT_WRITE, MAP_SHARED, again, PAGE) == MAP_FAILED && errno == EACCES);
	close(again);
	give_back(&mapped);
	mapped = lend(node, CM_WINDOW_WRITE);
	CHECK(mmap(NULL, PAGE, PROT_WRITE, MAP_SHARED, mapped.fd, 0) == MAP_FAILED && errno == EACCES);
	CHECK(mmap(NULL, 2 * PAGE, PROT_WRITE, MAP_SHARED, mapped.fd, 0) == MAP_FAILED);
	CHECK(mprotect((void *)mapped.state, PAGE, PROT_WRITE) == -1 && errno == EACCES);
	CHECK(mmap(NULL, PAGE, PROT_READ, MAP_PRIVATE, mapped.fd, PAGE) == MAP_FAILED &&
	      errno == EINVAL);
	CHECK(mmap(NULL, PAGE, PROT_READ, MAP_SHARED, mapped.fd, PAGE + LENGTH) == MAP_FAILED);
	CHECK(mmap(NULL, LENGTH + PAGE, PROT_READ, MAP_SHARED, mapped.fd, PAGE) == MAP_FAILED);
	give_back(&mapped);
}

/* whatever a process does with its mapping, and whoever looks into it, nothing keeps a page */
static void test_ways_to_keep_a_page(int node)
{
	struct mapped mapped = lend(node, CM_WINDOW_WRITE);
	void *page = (void *)mapped.registers, *moved;
	char copy[16];
	struct iovec here = { copy, sizeof(copy) }, there = { page, sizeof(copy) };
	int end[2], twin = dup(mapped.fd), status;
	volatile uint32_t *other;
	pid_t child;

	hardware[0] = OURS;
	CHECK(mapped.registers[0] == OURS);
	CHECK(process_vm_readv(getpid(), &here, 1, &there, 1, 0) == -1);
	CHECK(pipe(end) == 0 && vmsplice(end[1], &there, 1, 0) == -1);
	CHECK(mremap(page, LENGTH, 4 * LENGTH, MREMAP_MAYMOVE) == MAP_FAILED);
	moved = mremap(page, LENGTH, LENGTH, MREMAP_MAYMOVE | MREMAP_FIXED,
		       mmap(NULL, LENGTH, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0));
	CHECK(moved != MAP_FAILED);
	mapped.registers = moved;
	CHECK(mapped.registers[0] == OURS);
	other = mmap(NULL, PAGE, PROT_READ, MAP_SHARED, twin, PAGE);
	CHECK(other[0] == OURS);
	child = fork();
	if (!child) {
		/* no core, no word: the mapping is not there */
		signal(SIGSEGV, SIG_DFL);
		_exit(mapped.registers[0] == OURS);
	}
	waitpid(child, &status, 0);
	CHECK(WIFSIGNALED(status) && WTERMSIG(status) == SIGSEGV);
	CHECK(take_back(node, 0, 0, mapped.id, NULL) == 0);
	hardware[0] = OTHERS;
	CHECK(mapped.registers[0] == ~0u && other[0] == ~0u);
	close(mapped.fd);
	mapped.fd = twin;
	munmap((void *)other, PAGE);
	/* a descriptor that was kept maps the ones */
	other = mmap(NULL, PAGE, PROT_READ, MAP_SHARED, twin, PAGE);
	CHECK(other[0] == ~0u);
	munmap((void *)other, PAGE);
	give_back(&mapped);
	close(end[0]);
	close(end[1]);
}

static void test_events(int node)
{
	struct mapped first = lend(node, 0), second = lend(node, 0);
	struct pollfd wait = { .fd = node, .events = POLLIN };
	struct cm_window_event events[2];

	drain(node);
	CHECK(first.id && second.id > first.id);
	CHECK(poll(&wait, 1, 0) == 0);
	close(first.fd);
	munmap((void *)first.state, PAGE);
	CHECK(poll(&wait, 1, 0) == 0); /* a mapping is left */
	munmap((void *)first.registers, LENGTH);
	CHECK(poll(&wait, 1, 1000) == 1);
	CHECK(read(node, events, sizeof(events)) == sizeof(events[0]));
	CHECK(events[0].id == first.id && events[0].reason == CM_WINDOW_RELEASED);
	/* who revoked by a call knows it */
	CHECK(take_back(node, 0, 0, second.id, NULL) == 0);
	CHECK(poll(&wait, 1, 0) == 0);
	CHECK(read(node, events, 4) == -1 && errno == EINVAL);
	give_back(&second);
	CHECK(read(node, events, sizeof(events)) == sizeof(events[0]));
	CHECK(take_back(node, 0, 0, second.id, NULL) == -1 && errno == ENOENT);
}

static void test_the_end_of_who_lent(void)
{
	int node = open("/dev/cm_window", O_RDWR);
	struct mapped mapped = lend(node, CM_WINDOW_WRITE);

	hardware[0] = OURS;
	CHECK(mapped.registers[0] == OURS);
	close(node);
	CHECK(mapped.state->revoked == CM_WINDOW_REVOKED_OWNER && mapped.registers[0] == ~0u);
	give_back(&mapped);
}

/* a module's register read, and one written, as fast as it goes, until it was taken back */
static void client(struct mapped *mapped, int report)
{
	uint64_t reads = 0, wrong = 0, late = 0;

	for (;;) {
		uint32_t value = mapped->registers[0];
		uint32_t said;

		__atomic_thread_fence(__ATOMIC_ACQUIRE);
		said = mapped->state->revoked;
		reads++;
		if (!said && value != OURS)
			wrong++;
		if (value == OTHERS)
			late++;
		if (said && value == ~0u)
			break;
		mapped->registers[1] = OURS;
	}
	dprintf(report, "%llu %llu %llu\n", (unsigned long long)reads, (unsigned long long)wrong,
		(unsigned long long)late);
	_exit(0);
}

static uint64_t now_us(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return now.tv_sec * 1000000ULL + now.tv_nsec / 1000;
}

static pid_t start_client(int node, int report, int ready)
{
	struct mapped mapped;
	pid_t child = fork();

	if (child)
		return child;
	mapped = lend(node, CM_WINDOW_WRITE);
	if (mapped.registers == MAP_FAILED || mapped.fd < 0)
		_exit(1);
	if (mapped.registers[0] == OURS && write(ready, "x", 1) != 1)
		_exit(1);
	client(&mapped, report);
	return 0;
}

static void test_against_busy_clients(int node)
{
	unsigned long long reads, wrong, late, all = 0, bad = 0;
	uint64_t longest = 0;
	int round, i, status, intact = 0, report[2], ready[2];
	pid_t clients[READERS];
	char byte;
	FILE *said;

	CHECK(pipe(report) == 0 && pipe(ready) == 0);
	said = fdopen(report[0], "r");
	for (round = 0; round < ROUNDS; round++) {
		uint64_t begin;

		hardware[0] = OURS;
		for (i = 0; i < READERS; i++)
			clients[i] = start_client(node, report[1], ready[1]);
		for (i = 0; i < READERS; i++)
			(void)!read(ready[0], &byte, 1);
		kill(clients[0], SIGSTOP); /* it delays nobody */
		usleep(1000 * (round % 5));
		begin = now_us();
		take_back(node, ADDRESS, LENGTH, 0, NULL);
		begin = now_us() - begin;
		/* from here on it is another module's */
		hardware[0] = OTHERS;
		hardware[1] = OTHERS;
		longest = begin > longest ? begin : longest;
		kill(clients[0], SIGCONT);
		for (i = 0; i < READERS; i++) {
			waitpid(clients[i], &status, 0);
			if (status || fscanf(said, "%llu %llu %llu", &reads, &wrong, &late) != 3) {
				bad++;
				continue;
			}
			all += reads;
			bad += wrong + late;
		}
		intact += hardware[1] == OTHERS;
	}
	printf("%llu reads, the longest REVOKE took %llu us\n", all, (unsigned long long)longest);
	CHECK(all > 0 && bad == 0);
	CHECK(intact == ROUNDS);
	fclose(said);
	close(report[1]);
	close(ready[0]);
	close(ready[1]);
	drain(node);
}

static unsigned long lent(void)
{
	char text[32] = "";
	int fd = open("/sys/kernel/debug/cm_window/lent", O_RDONLY);

	if (fd < 0 || read(fd, text, sizeof(text) - 1) < 0)
		return ~0ul;
	close(fd);
	return strtoul(text, NULL, 0);
}

static void test_a_thousand_grants_of_a_killed_process(int node)
{
	unsigned long before = lent();
	int status, i;
	pid_t child = fork();

	if (!child) {
		struct cm_window_grant args = { .size = sizeof(args), .address = ADDRESS,
						.length = LENGTH };

		for (i = 0; i < 1000; i++) {
			int fd = ioctl(node, CM_WINDOW_IOC_GRANT, &args) ? -1 : args.fd;

			if (fd < 0 || mmap(NULL, PAGE, PROT_READ, MAP_SHARED, fd, PAGE) == MAP_FAILED)
				_exit(1);
		}
		raise(SIGKILL);
	}
	waitpid(child, &status, 0);
	CHECK(WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL);
	for (i = 0; i < 100 && lent() != before; i++)
		usleep(10000);
	CHECK(lent() == before);
	CHECK(drain(node) == 1000);
}

static void test_most_grants(int node)
{
	struct cm_window_grant args = { .size = sizeof(args), .address = ADDRESS, .length = PAGE };
	int count = 0;

	/* released ones count until that was read */
	while (ioctl(node, CM_WINDOW_IOC_GRANT, &args) == 0 && count <= 4096) {
		close(args.fd);
		count++;
	}
	CHECK(count == 4096 && refused(node, ADDRESS, PAGE, 0) == ENOSPC);
	CHECK(drain(node) == 4096 && refused(node, ADDRESS, PAGE, 0) == 0);
}

int main(int argc, char **argv)
{
	int node, uio;

	if (argc != 2) {
		fprintf(stderr, "usage: %s DEBUGFS-FOLDER\n", argv[0]);
		return 2;
	}
	engine = argv[1];
	setvbuf(stdout, NULL, _IOLBF, 0);
	node = open("/dev/cm_window", O_RDWR);
	uio = open("/dev/uio0", O_RDWR);
	CHECK(node >= 0 && uio >= 0);
	hardware = mmap(NULL, LENGTH, PROT_READ | PROT_WRITE, MAP_SHARED, uio, 0);
	CHECK(hardware != MAP_FAILED);
	test_sizes(node);
	test_refusals(node);
	test_access(node);
	test_mappings_for_reading(node);
	test_ways_to_keep_a_page(node);
	test_events(node);
	test_the_end_of_who_lent();
	test_against_busy_clients(node);
	test_a_thousand_grants_of_a_killed_process(node);
	test_most_grants(node);
	hardware[0] = 0;
	hardware[1] = 0;
	printf("%s: %d failures\n", failures ? "FAIL" : "PASS", failures);
	return failures != 0;
}
