// SPDX-License-Identifier: Apache-2.0
/*
 * Registers read by name: what the table says, never what it said before it was withdrawn; a bus that hangs or
 * does not answer; clients that talk nonsense.  Run under the sanitizers too.
 */
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <sys/mman.h>
#include <sys/socket.h>

#include "bus.h"
#include "client/cm_plane_wire.h"
#include "clock.h"
#include "plane.h"
#include "reads.h"
#include "test.h"
#include "uio_private.h"

#define HUNG_MS 60000 /* however busy the machine is */
#define PAGE 4096
#define CHANGES 200

#ifdef __SANITIZE_THREAD__
/* GCC 12's thread sanitizer does not know this one, and would take what it locks for unlocked. */
int pthread_mutex_clocklock(pthread_mutex_t *mutex, clockid_t clock, const struct timespec *until)
{
	int64_t left = cm_clock_left(until->tv_sec * CM_NS_PER_S + until->tv_nsec);
	struct timespec now, at = cm_clock_timespec(left);

	CHECK(clock == CLOCK_MONOTONIC);
	clock_gettime(CLOCK_REALTIME, &now);
	at = cm_clock_timespec((now.tv_sec + at.tv_sec) * CM_NS_PER_S + now.tv_nsec + at.tv_nsec);
	return pthread_mutex_timedlock(mutex, &at);
}
#endif

/* A device whose window is memory of ours. */
struct device {
	struct cm_uio uio;
	int fd;
	uint32_t *registers;
};

static struct device *device_make(void)
{
	struct device *device = calloc(1, sizeof(*device));

	CHECK(device && !cm_bus_watch());
	device->fd = memfd_create("registers", MFD_CLOEXEC);
	CHECK(device->fd >= 0 && !ftruncate(device->fd, PAGE));
	device->registers = mmap(NULL, PAGE, PROT_READ | PROT_WRITE, MAP_SHARED, device->fd, 0);
	CHECK(device->registers != MAP_FAILED);
	device->uio.node = cm_node_open("/", "dev/null"); /* a character device, as UIO's are */
	CHECK(device->uio.node);
	device->uio.info.map_count = 1;
	device->uio.info.maps[0].size = PAGE;
	device->uio.windows[0].base = device->registers;
	return device;
}

static void device_free(struct device *device)
{
	cm_node_close(device->uio.node);
	munmap(device->registers, PAGE);
	close(device->fd);
	free(device);
}

static void offer(struct cm_reads *reads, struct device *device, const char *name, uint64_t offset)
{
	struct cm_read read = {
		.uio = &device->uio, .width = 32, .offset = offset, .mask = UINT64_MAX
	};

	CHECK(!cm_reads_offer(reads, name, &read));
}

static struct cm_plane_descriptor receive(int fd)
{
	struct pollfd ready = { .fd = fd, .events = POLLIN };
	struct cm_plane_descriptor packet = { 0 };

	CHECK(poll(&ready, 1, HUNG_MS) == 1);
	CHECK(recv(fd, &packet, sizeof(packet), 0) == (ssize_t)sizeof(packet));
	return packet;
}

static int client(struct cm_reads *reads)
{
	int ends[2];

	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends));
	CHECK(!cm_reads_adopt(reads, ends[1], 1));
	CHECK(receive(ends[0]).kind == CM_PLANE_REGISTERS);
	return ends[0];
}

static void ask(int fd, const char *name, uint64_t sequence)
{
	char packet[sizeof(struct cm_plane_descriptor) + CM_PLANE_NAME_MAX];
	struct cm_plane_descriptor head = { .kind = CM_PLANE_READ, .sequence = sequence };
	size_t size = sizeof(head) + strlen(name);

	memcpy(packet, &head, sizeof(head));
	memcpy(packet + sizeof(head), name, strlen(name));
	CHECK(send(fd, packet, size, MSG_NOSIGNAL) == (ssize_t)size);
}

static struct cm_plane_descriptor read_of(int fd, const char *name)
{
	static atomic_ulong last;
	uint64_t sequence = ++last;
	struct cm_plane_descriptor packet;

	ask(fd, name, sequence);
	packet = receive(fd);
	CHECK(packet.sequence == sequence);
	return packet;
}

static bool is_readable(int fd)
{
	struct pollfd ready = { .fd = fd, .events = POLLIN };

	return poll(&ready, 1, 0) == 1;
}

static bool hung_up(int fd)
{
	struct pollfd ready = { .fd = fd, .events = POLLIN };
	char byte;

	CHECK(poll(&ready, 1, HUNG_MS) == 1);
	return recv(fd, &byte, 1, 0) <= 0;
}

static void names_in_the_table_are_read(void)
{
	struct device *device = device_make();
	struct cm_reads *reads = cm_reads_new();
	struct cm_read field = {
		.uio = &device->uio, .width = 32, .offset = 4, .mask = 0xf0, .lsb = 4
	};
	struct cm_read wide = { .uio = &device->uio, .width = 64, .offset = 8, .mask = UINT64_MAX };
	int fd = client(reads);

	device->registers[0] = 7;
	device->registers[1] = 0xabc;
	device->registers[3] = 1;
	offer(reads, device, "a", 0);
	CHECK(!cm_reads_offer(reads, "b.field", &field) && !cm_reads_offer(reads, "wide", &wide));
	CHECK(read_of(fd, "a").length == 7);
	CHECK(read_of(fd, "b.field").length == 0xb);
	CHECK(read_of(fd, "wide").length == UINT64_C(1) << 32);
	offer(reads, device, "a", 4);
	CHECK(read_of(fd, "a").length == 0xabc);
	CHECK(!is_readable(cm_reads_wanted_fd(reads)));
	close(fd);
	cm_reads_close(reads);
	device_free(device);
}

static void what_the_table_lacks_is_wanted_once(void)
{
	struct device *device = device_make();
	struct cm_reads *reads = cm_reads_new();
	int fd = client(reads);
	uint64_t count;

	for (int i = 0; i < 2; i++) {
		CHECK(read_of(fd, "a").kind == CM_PLANE_ELSEWHERE);
		CHECK(read(cm_reads_wanted_fd(reads), &count, sizeof(count)) == sizeof(count));
		CHECK(read_of(fd, "").kind == CM_PLANE_ELSEWHERE);
		CHECK(!is_readable(cm_reads_wanted_fd(reads)));
		offer(reads, device, "a", 0);
		CHECK(read_of(fd, "a").kind == CM_PLANE_VALUE);
		CHECK(read_of(fd, "aa").kind == CM_PLANE_ELSEWHERE);
		cm_reads_withdraw(reads);
	}
	close(fd);
	cm_reads_close(reads);
	device_free(device);
}

static void nonsense_is_hung_up_on(void)
{
	struct cm_reads *reads = cm_reads_new();
	struct cm_plane_descriptor other = { .kind = CM_PLANE_PING };
	char packet[sizeof(other) + CM_PLANE_NAME_MAX + 1] = { 0 };
	size_t sizes[] = { 1, sizeof(other), sizeof(packet) };

	for (size_t i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++) {
		int fd = client(reads), good = client(reads);

		other.kind = i == 1 ? CM_PLANE_PING : CM_PLANE_READ;
		memcpy(packet, &other, sizeof(other));
		CHECK(send(fd, packet, sizes[i], MSG_NOSIGNAL) == (ssize_t)sizes[i]);
		CHECK(hung_up(fd));
		CHECK(read_of(good, "a").kind == CM_PLANE_ELSEWHERE);
		close(fd);
		close(good);
	}
	cm_reads_close(reads);
}

static void a_process_has_so_many_connections(void)
{
	struct cm_reads *reads = cm_reads_new();
	int fds[CM_READS_EACH], ends[2];

	for (int i = 0; i < CM_READS_EACH; i++)
		fds[i] = client(reads);
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends));
	CHECK(cm_reads_adopt(reads, ends[1], 1) < 0 && errno == EUSERS);
	CHECK(!cm_reads_adopt(reads, ends[1], 2));
	for (int i = 0; i < CM_READS_EACH; i++)
		close(fds[i]);
	close(ends[0]);
	cm_reads_close(reads);
}

static void a_bus_that_does_not_answer_is_asked_elsewhere(void)
{
	struct device *device = device_make();
	struct cm_reads *reads = cm_reads_new();
	int fd = client(reads);

	offer(reads, device, "a", 0);
	CHECK(!ftruncate(device->fd, 0)); /* an access is a SIGBUS now */
	CHECK(read_of(fd, "a").kind == CM_PLANE_ELSEWHERE);
	CHECK(!ftruncate(device->fd, PAGE));
	CHECK(read_of(fd, "a").kind == CM_PLANE_VALUE);
	close(fd);
	cm_reads_close(reads);
	device_free(device);
}

/* ---- a bus that hangs: the load does not end, since the handler of its fault does not return ---- */

static struct device *hanging;
static int hangs[2], goes_on[2]; /* pipes */

static void hang(int number)
{
	char byte = 0;

	(void)number;
	(void)!write(hangs[1], &byte, 1);
	while (read(goes_on[0], &byte, 1) < 0 && errno == EINTR)
		;
	mprotect(hanging->registers, PAGE, PROT_READ | PROT_WRITE);
}

static atomic_bool withdrawn;

static void *withdraw(void *reads)
{
	cm_reads_withdraw(reads);
	atomic_store(&withdrawn, true);
	return NULL;
}

static void frame_passes(struct cm_plane *plane)
{
	struct cm_plane_setup setup = { .write = true, .queue_depth = 2, .length = PAGE };
	union {
		struct cm_plane_descriptor head;
		char bytes[sizeof(struct cm_plane_descriptor) + sizeof(struct cm_plane_geometry)];
	} geometry = { .head = { .kind = CM_PLANE_GEOMETRY } };
	struct cm_plane_descriptor packet = { .kind = CM_PLANE_SUBMIT, .length = 8 };
	int memory = memfd_create("slot", MFD_CLOEXEC), ends[2];
	int stream = cm_plane_start(plane, NULL, &setup);

	CHECK(memory >= 0 && !ftruncate(memory, PAGE) && stream > 0);
	CHECK(cm_plane_add_slot(plane, stream, memory, 0) == 0);
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends));
	CHECK(!cm_plane_attach(plane, cm_plane_adopt(plane, ends[1]), stream, 1, geometry.bytes,
			       sizeof(geometry)));
	for (int kind = 0; kind != CM_PLANE_GRANT;) {
		char bytes[CM_PLANE_PACKET_MAX];

		CHECK(recv(ends[0], bytes, sizeof(bytes), 0) >= (ssize_t)sizeof(packet));
		kind = ((struct cm_plane_descriptor *)(void *)bytes)->kind;
		packet.flags = ((struct cm_plane_descriptor *)(void *)bytes)->flags;
	}
	CHECK(send(ends[0], &packet, sizeof(packet), MSG_NOSIGNAL) == (ssize_t)sizeof(packet));
	CHECK(receive(ends[0]).kind == CM_PLANE_DONE);
	CHECK(!cm_plane_stop(plane, stream, 0));
	close(ends[0]);
	close(memory);
}

static void a_bus_that_hangs_stops_no_frames(void)
{
	struct sigaction action = { .sa_handler = hang }, before;
	struct device *device = hanging = device_make();
	struct cm_reads *reads = cm_reads_new();
	struct cm_plane *plane = cm_plane_new();
	struct cm_read read_b = { .uio = &device->uio, .width = 32, .mask = UINT64_MAX };
	int fd = client(reads), ends[2];
	pthread_t thread;
	char byte = 0;

	CHECK(!pipe2(hangs, O_CLOEXEC) && !pipe2(goes_on, O_CLOEXEC));
	CHECK(!sigaction(SIGSEGV, &action, &before));
	device->registers[0] = 5;
	offer(reads, device, "a", 0);
	CHECK(!mprotect(device->registers, PAGE, PROT_NONE));
	ask(fd, "a", 1);
	CHECK(read(hangs[0], &byte, 1) == 1);
	frame_passes(plane);
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends));
	CHECK(!cm_reads_adopt(reads, ends[1], 2)); /* the caller's loop goes on, too */
	CHECK(cm_reads_offer(reads, "b", &read_b) < 0 && errno == ETIMEDOUT);
	CHECK(!pthread_create(&thread, NULL, withdraw, reads));
	usleep(20000);
	CHECK(!atomic_load(&withdrawn)); /* nobody may touch the region yet */
	CHECK(write(goes_on[1], &byte, 1) == 1);
	CHECK(!pthread_join(thread, NULL));
	CHECK(receive(fd).length == 5);
	CHECK(read_of(fd, "a").kind == CM_PLANE_ELSEWHERE);
	CHECK(!sigaction(SIGSEGV, &before, NULL));
	for (int i = 0; i < 2; i++) {
		close(hangs[i]);
		close(goes_on[i]);
	}
	close(fd);
	close(ends[0]);
	cm_plane_close(plane);
	cm_reads_close(reads);
	device_free(device);
}

/* ---- changes ---- */

static atomic_bool over;

/* Names of two modules that share a place: each has its own value there. */
static void *read_both(void *argument)
{
	int fd = *(int *)argument;

	while (!atomic_load(&over)) {
		struct cm_plane_descriptor one = read_of(fd, "one"), two = read_of(fd, "two");

		CHECK(one.kind == CM_PLANE_ELSEWHERE || one.length == 1);
		CHECK(two.kind == CM_PLANE_ELSEWHERE || two.length == 2);
	}
	return NULL;
}

static void no_read_is_of_another_module(void)
{
	struct device *device = device_make();
	struct cm_reads *reads = cm_reads_new();
	int fds[2] = { client(reads), client(reads) };
	pthread_t threads[2];

	for (int i = 0; i < 2; i++)
		CHECK(!pthread_create(&threads[i], NULL, read_both, &fds[i]));
	for (int i = 0; i < CHANGES; i++) {
		int other = client(reads); /* some come and go */

		__atomic_store_n(&device->registers[0], 1 + (uint32_t)i % 2, __ATOMIC_RELAXED);
		offer(reads, device, i % 2 ? "two" : "one", 0);
		CHECK(read_of(other, i % 2 ? "two" : "one").kind == CM_PLANE_VALUE);
		cm_reads_withdraw(reads);
		close(other);
	}
	atomic_store(&over, true);
	for (int i = 0; i < 2; i++) {
		CHECK(!pthread_join(threads[i], NULL));
		close(fds[i]);
	}
	cm_reads_close(reads);
	device_free(device);
}

int main(void)
{
	RUN(names_in_the_table_are_read);
	RUN(what_the_table_lacks_is_wanted_once);
	RUN(nonsense_is_hung_up_on);
	RUN(a_process_has_so_many_connections);
	RUN(a_bus_that_does_not_answer_is_asked_elsewhere);
	RUN(a_bus_that_hangs_stops_no_frames);
	RUN(no_read_is_of_another_module);
	return 0;
}
