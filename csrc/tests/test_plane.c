// SPDX-License-Identifier: Apache-2.0
/*
 * The data plane under stress: readers of the client library that come and go, some that hang
 * up with frames in hand or talk nonsense, a writer, and streams that end under them.  Run under
 * the sanitizers too.
 */
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/un.h>

#include "client/cm_plane.h"
#include "fake_node.h"
#include "plane.h"
#include "plane_private.h"
#include "test.h"

#define READERS 2
#define LIVES 1
#define FRAMES 20 /* of a reader's life, at most */
#define SLOTS 12
#define DEPTH 2
#define LENGTH 8192
#define HUNG_MS 60000 /* however busy the machine is */

struct place {
	char *root;
	struct fake_node *fake;
	struct cm_dma *dma;
	struct cm_plane *plane;
	int listener;
	atomic_int stream; /* readers are let in to it */
	atomic_bool ending;
	atomic_uint releases_refused;
	int memory[SLOTS];
	pthread_t acceptor;
};

static size_t geometry_packet(unsigned char *packet, bool writable)
{
	struct cm_plane_descriptor head = { .kind = CM_PLANE_GEOMETRY };
	struct cm_plane_geometry body = {
		.slot_length = LENGTH,
		.frame_length = LENGTH / 2,
		.flags = CM_PLANE_COHERENT | (writable ? CM_PLANE_WRITABLE : 0),
		.depth = DEPTH,
		.dimensions = 1,
		.shape = { LENGTH / 2 },
		.dtype = "uint8",
	};
	static const char names[] = "x\0config\0mode";

	memcpy(packet, &head, sizeof(head));
	memcpy(packet + sizeof(head), &body, sizeof(body));
	memcpy(packet + sizeof(head) + sizeof(body), names, sizeof(names));
	return sizeof(head) + sizeof(body) + sizeof(names);
}

/* Let one in, as the manager does; -1 if the stream has just ended. */
static int admit(struct place *place, int connection, bool writer)
{
	unsigned char packet[CM_PLANE_PACKET_MAX];
	int client = cm_plane_adopt(place->plane, connection);

	CHECK(client > 0);
	if (!cm_plane_attach(place->plane, client, place->stream, DEPTH, packet,
			     geometry_packet(packet, writer)))
		return client;
	CHECK(errno == ENOENT || errno == EAGAIN);
	cm_plane_drop(place->plane, client);
	return -1;
}

static void *accept_clients(void *argument)
{
	struct place *place = argument;
	struct pollfd listener = { .fd = place->listener, .events = POLLIN };

	while (!place->ending) {
		unsigned char open[CM_PLANE_PACKET_MAX];
		int connection;

		if (poll(&listener, 1, 20) <= 0)
			continue;
		connection = accept4(place->listener, NULL, NULL, SOCK_CLOEXEC);
		CHECK(connection >= 0);
		if (recv(connection, open, sizeof(open), 0) >=
		    (ssize_t)sizeof(struct cm_plane_descriptor))
			admit(place, connection, false);
		else
			close(connection);
	}
	return NULL;
}

static void start_stream(struct place *place)
{
	struct cm_plane_setup setup = { .queue_depth = 4, .length = LENGTH };
	int stream = cm_plane_start(place->plane, place->dma, &setup);

	CHECK(stream > 0);
	for (int i = 0; i < SLOTS; i++)
		CHECK(cm_plane_add_slot(place->plane, stream, place->memory[i], 7) == i);
	place->stream = stream;
}

static struct place *place_make(void)
{
	struct place *place = calloc(1, sizeof(*place));
	struct sockaddr_un address = { .sun_family = AF_UNIX };

	CHECK(place);
	place->root = fake_root_make();
	place->fake = fake_node_start(place->root, "dev/cm_dma/x", WELL_BEHAVED);
	place->dma = cm_dma_open(place->root, "x");
	place->plane = cm_plane_new();
	CHECK(place->dma && place->plane);
	for (int i = 0; i < SLOTS; i++) {
		place->memory[i] = memfd_create("slot", MFD_CLOEXEC);
		CHECK(place->memory[i] >= 0 && !ftruncate(place->memory[i], LENGTH));
	}
	start_stream(place);
	CHECK((size_t)snprintf(address.sun_path, sizeof(address.sun_path), "%s/data", place->root) <
	      sizeof(address.sun_path));
	place->listener = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
	CHECK(!bind(place->listener, (struct sockaddr *)&address, sizeof(address)));
	CHECK(!listen(place->listener, 16));
	CHECK(!pthread_create(&place->acceptor, NULL, accept_clients, place));
	return place;
}

static void place_end(struct place *place)
{
	place->ending = true;
	pthread_join(place->acceptor, NULL);
	cm_plane_close(place->plane);
	cm_dma_close(place->dma);
	fake_node_stop(place->fake);
	close(place->listener);
	for (int i = 0; i < SLOTS; i++)
		close(place->memory[i]);
	fake_root_remove(place->root);
	free(place);
}

/* One life of a reader: some frames, and an end with or without them in hand. */
static void live(struct place *place, unsigned int *seed)
{
	struct cm_reader *reader = cm_reader_open(place->root, "x", DEPTH);
	int wanted = 5 + rand_r(seed) % FRAMES;

	CHECK(reader);
	for (int i = 0; i < wanted; i++) {
		struct cm_frame frame;
		int got = cm_reader_next(reader, 50, &frame);

		if (got < 0)
			break; /* the stream ended as we came */
		if (!got)
			continue;
		CHECK(frame.length == LENGTH / 2);
		CHECK(*(const volatile unsigned char *)frame.data == 0);
		if (rand_r(seed) % 16 == 0)
			continue; /* kept, until the end gives it back */
		if (cm_reader_release(reader, &frame))
			place->releases_refused++;
	}
	cm_reader_close(reader);
}

static void *live_on(void *argument)
{
	struct place *place = argument;
	unsigned int seed = (unsigned int)(uintptr_t)&seed;

	for (int i = 0; i < LIVES; i++)
		live(place, &seed);
	return NULL;
}

static void *talk_nonsense(void *argument)
{
	struct place *place = argument;
	unsigned int seed = 7;

	while (!place->ending) {
		unsigned char packet[64];
		int pair[2];

		CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair));
		if (admit(place, pair[1], false) > 0) {
			for (int i = 0; i < 2; i++) {
				for (size_t k = 0; k < sizeof(packet); k++)
					packet[k] = (unsigned char)rand_r(&seed);
				packet[2] = (unsigned char)(rand_r(&seed) % 8);
				if (send(pair[0], packet, i ? 32 : 1 + (size_t)rand_r(&seed) % 64,
					 MSG_NOSIGNAL | MSG_DONTWAIT) < 0)
					break;
			}
		}
		close(pair[0]);
		poll(NULL, 0, 2);
	}
	return NULL;
}

static void *look_on(void *argument)
{
	struct place *place = argument;
	struct cm_plane_stats stats;
	struct cm_plane_client_stats client;
	struct cm_plane_event event;
	struct cm_plane_descriptor label = { .kind = CM_PLANE_LABEL };

	while (!place->ending) {
		if (!cm_plane_get_stats(place->plane, place->stream, &stats))
			CHECK(stats.held <= SLOTS && stats.queued <= SLOTS);
		cm_plane_get_client_stats(place->plane, (int)(stats.frames % 64), &client);
		cm_plane_tell(place->plane, place->stream, &label, sizeof(label));
		while (cm_plane_take(place->plane, &event))
			CHECK(event.kind == CM_PLANE_CLIENT_GONE);
		poll(NULL, 0, 1);
	}
	return NULL;
}

/* A busy machine may have given the readers none in their lives: one more, that waits. */
static void frames_come(struct place *place)
{
	struct cm_reader *reader = cm_reader_open(place->root, "x", DEPTH);
	struct cm_frame frame;

	CHECK(reader && cm_reader_next(reader, HUNG_MS, &frame) == 1);
	cm_reader_close(reader);
}

static void run_with(struct place *place, void (*meanwhile)(struct place *))
{
	pthread_t readers[READERS], nonsense, looker;

	CHECK(!pthread_create(&nonsense, NULL, talk_nonsense, place));
	CHECK(!pthread_create(&looker, NULL, look_on, place));
	for (int i = 0; i < READERS; i++)
		CHECK(!pthread_create(&readers[i], NULL, live_on, place));
	if (meanwhile)
		meanwhile(place);
	for (int i = 0; i < READERS; i++)
		pthread_join(readers[i], NULL);
	frames_come(place);
	place->ending = true;
	pthread_join(nonsense, NULL);
	pthread_join(looker, NULL);
}

/* When all clients have gone, no slot is held, and frames go on. */
static void nothing_is_held(struct place *place)
{
	struct cm_plane_stats stats = { .held = 1 };
	uint64_t before = 0;

	for (int i = 0; i < HUNG_MS && (stats.held || stats.frames <= before); i++) {
		before = stats.frames && !before ? stats.frames : before;
		poll(NULL, 0, 1);
		CHECK(!cm_plane_get_stats(place->plane, place->stream, &stats));
	}
	CHECK(stats.held == 0 && stats.frames > before && stats.errors == 0);
}

static void readers_come_and_go(void)
{
	struct place *place = place_make();

	run_with(place, NULL);
	nothing_is_held(place);
	place_end(place);
}

static void stop_and_start(struct place *place)
{
	for (int i = 0; i < 2; i++) {
		poll(NULL, 0, 10);
		CHECK(!cm_plane_stop(place->plane, place->stream, 0));
		start_stream(place);
	}
}

static void streams_end_under_their_readers(void)
{
	struct place *place = place_make();

	run_with(place, stop_and_start);
	nothing_is_held(place);
	place_end(place);
}

static void the_plane_ends_under_its_readers(void)
{
	struct place *place = place_make();
	struct cm_reader *reader = cm_reader_open(place->root, "x", DEPTH);
	struct cm_frame frame;

	CHECK(cm_reader_next(reader, HUNG_MS, &frame) == 1);
	place_end(place);
	CHECK(*(const volatile unsigned char *)frame.data == 0);
	while (cm_reader_next(reader, HUNG_MS, &frame) >= 0)
		;
	CHECK(errno == ECONNRESET);
	cm_reader_close(reader);
}

/* A writer without hardware: every frame is done at once, and its slot its own again. */
static void a_writer_gets_its_slots_back(void)
{
	struct cm_plane *plane = cm_plane_new();
	struct cm_plane_setup setup = { .write = true, .length = LENGTH };
	struct cm_plane_descriptor packet, grant = { 0 };
	unsigned char geometry[CM_PLANE_PACKET_MAX];
	int pair[2], memory = memfd_create("slot", MFD_CLOEXEC), stream, client;
	struct cm_plane_client_stats stats;

	CHECK(plane && !ftruncate(memory, LENGTH));
	stream = cm_plane_start(plane, NULL, &setup);
	CHECK(cm_plane_add_slot(plane, stream, memory, 0) == 0);
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair));
	client = cm_plane_adopt(plane, pair[1]);
	CHECK_ERRNO(cm_plane_attach(plane, client, stream, 2, geometry,
				    geometry_packet(geometry, true)),
		    EAGAIN);
	CHECK(!cm_plane_attach(plane, client, stream, 1, geometry,
			       geometry_packet(geometry, true)));
	while (grant.kind != CM_PLANE_GRANT)
		CHECK(recv(pair[0], &grant, sizeof(grant), 0) > 0);
	for (uint64_t i = 0; i < 2000; i++) {
		packet = grant;
		packet.kind = CM_PLANE_SUBMIT;
		packet.length = i % 7 ? LENGTH : LENGTH + 1; /* one that does not fit is refused */
		packet.sequence = i;
		CHECK(send(pair[0], &packet, sizeof(packet), 0) == sizeof(packet));
		CHECK(recv(pair[0], &packet, sizeof(packet), 0) == sizeof(packet));
		CHECK(packet.kind == CM_PLANE_DONE && packet.sequence == i);
		CHECK(packet.offset == (i % 7 ? 0 : EINVAL));
	}
	CHECK(!cm_plane_get_client_stats(plane, client, &stats));
	CHECK(stats.frames == 2000 - 2000 / 7 - 1 && stats.held == 0 && stats.depth == 1);
	cm_plane_close(plane);
	close(pair[0]);
	close(memory);
}

struct ending {
	struct cm_plane *plane;
	int stream;
	atomic_bool over;
};

static void *stop_stream(void *argument)
{
	struct ending *ending = argument;

	CHECK(!cm_plane_stop(ending->plane, ending->stream, 0));
	ending->over = true;
	return NULL;
}

/* A writer of a stream without hardware, attached; its end of the socket. */
static int echo_writer(struct cm_plane *plane, int memory, struct cm_plane_descriptor *grant)
{
	struct cm_plane_setup setup = { .write = true, .length = LENGTH };
	unsigned char geometry[CM_PLANE_PACKET_MAX];
	int stream = cm_plane_start(plane, NULL, &setup), pair[2];

	CHECK(cm_plane_add_slot(plane, stream, memory, 0) == 0);
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair));
	CHECK(!cm_plane_attach(plane, cm_plane_adopt(plane, pair[1]), stream, 1, geometry,
			       geometry_packet(geometry, true)));
	while (grant->kind != CM_PLANE_GRANT)
		CHECK(recv(pair[0], grant, sizeof(*grant), 0) > 0);
	return pair[0];
}

/* The driver is slow to cancel one stream: the others do not wait for it. */
static void a_stream_that_is_long_in_ending_holds_up_no_other(void)
{
	char *root = fake_root_make();
	struct fake_node *fake = fake_node_start(root, "dev/cm_dma/slow", ANSWER_LATE);
	struct cm_dma *dma = cm_dma_open(root, "slow");
	struct cm_plane_setup setup = { .write = true, .queue_depth = 4, .length = LENGTH };
	struct ending ending = { .plane = cm_plane_new() };
	struct cm_plane_descriptor packet, grant = { 0 };
	int memory = memfd_create("slot", MFD_CLOEXEC), writer;
	pthread_t stopper;

	CHECK(dma && ending.plane && !ftruncate(memory, LENGTH));
	ending.stream = cm_plane_start(ending.plane, dma, &setup);
	writer = echo_writer(ending.plane, memory, &grant);
	CHECK(!pthread_create(&stopper, NULL, stop_stream, &ending));
	/* from when the end has begun: another one finds no stream */
	while (cm_plane_add_slot(ending.plane, ending.stream, memory, 7) >= 0 || errno != ENOENT)
		poll(NULL, 0, 1);
	for (int i = 0; i < 20; i++) {
		packet = grant;
		packet.kind = CM_PLANE_SUBMIT;
		packet.length = LENGTH;
		CHECK(send(writer, &packet, sizeof(packet), 0) == sizeof(packet));
		CHECK(recv(writer, &packet, sizeof(packet), 0) == sizeof(packet));
		CHECK(packet.kind == CM_PLANE_DONE && packet.offset == 0);
	}
	CHECK(!ending.over);
	fake_node_speak(fake);
	pthread_join(stopper, NULL);
	CHECK(ending.over);
	cm_plane_close(ending.plane);
	close(writer);
	close(memory);
	cm_dma_close(dma);
	fake_node_stop(fake);
	fake_root_remove(root);
}

/* A manager that says what the test wants; the reader's end is connected. */
struct speaker {
	char *root;
	int listener, connection;
	struct cm_reader *reader;
};

static struct speaker speaker_make(void)
{
	struct speaker speaker = { .root = fake_root_make() };
	struct sockaddr_un address = { .sun_family = AF_UNIX };
	unsigned char geometry[CM_PLANE_PACKET_MAX];
	size_t size = geometry_packet(geometry, false);

	snprintf(address.sun_path, sizeof(address.sun_path), "%.90s/data", speaker.root);
	speaker.listener = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
	CHECK(!bind(speaker.listener, (struct sockaddr *)&address, sizeof(address)));
	CHECK(!listen(speaker.listener, 1));
	speaker.reader = cm_reader_open(speaker.root, "x", DEPTH);
	CHECK(speaker.reader);
	speaker.connection = accept4(speaker.listener, NULL, NULL, SOCK_CLOEXEC);
	CHECK(send(speaker.connection, geometry, size, 0) == (ssize_t)size);
	return speaker;
}

static void speaker_end(struct speaker *speaker)
{
	cm_reader_close(speaker->reader);
	close(speaker->connection);
	close(speaker->listener);
	fake_root_remove(speaker->root);
}

/* A packet with the descriptors of @count files of @length bytes. */
static void say_with(const struct speaker *speaker, struct cm_plane_descriptor head, uint32_t count,
		     off_t length)
{
	union {
		char bytes[CMSG_SPACE(8 * sizeof(int))];
		struct cmsghdr align;
	} control = { 0 };
	struct iovec part = { .iov_base = &head, .iov_len = sizeof(head) };
	struct msghdr message = { .msg_iov = &part,
				  .msg_iovlen = 1,
				  .msg_control = control.bytes,
				  .msg_controllen = CMSG_SPACE(count * sizeof(int)) };
	struct cmsghdr *header = CMSG_FIRSTHDR(&message);
	int memory[8];

	header->cmsg_level = SOL_SOCKET;
	header->cmsg_type = SCM_RIGHTS;
	header->cmsg_len = CMSG_LEN(count * sizeof(int));
	for (uint32_t i = 0; i < count; i++) {
		memory[i] = memfd_create("slot", MFD_CLOEXEC);
		CHECK(!ftruncate(memory[i], length));
	}
	memcpy(CMSG_DATA(header), memory, count * sizeof(int));
	CHECK(sendmsg(speaker->connection, &message, 0) == (ssize_t)sizeof(head));
	for (uint32_t i = 0; i < count; i++)
		close(memory[i]);
}

static void say_slots(const struct speaker *speaker, uint16_t first, uint32_t said, uint32_t count)
{
	struct cm_plane_descriptor head = { .slot = first, .kind = CM_PLANE_SLOTS, .offset = said };

	say_with(speaker, head, count, LENGTH);
}

static void a_slot_that_is_shorter_than_said_is_an_error(void)
{
	struct cm_plane_descriptor head = { .kind = CM_PLANE_SLOTS, .offset = 1 };
	const off_t lengths[] = { 0, LENGTH - 1 };

	for (size_t i = 0; i < 2; i++) {
		struct speaker speaker = speaker_make();
		struct cm_frame frame;
		int opened = open_descriptors();

		say_with(&speaker, head, 1, lengths[i]);
		CHECK_ERRNO(cm_reader_next(speaker.reader, 1000, &frame), EPROTO);
		CHECK(open_descriptors() == opened);
		speaker_end(&speaker);
	}
}

static void descriptors_that_come_with_a_frame_are_closed(void)
{
	struct speaker speaker = speaker_make();
	struct cm_plane_descriptor head = { .kind = CM_PLANE_FRAME, .length = LENGTH };
	struct cm_frame frame;
	int opened;

	say_slots(&speaker, 0, 1, 1);
	opened = open_descriptors();
	say_with(&speaker, head, 4, LENGTH);
	CHECK(cm_reader_next(speaker.reader, 1000, &frame) == 1);
	CHECK(!cm_reader_release(speaker.reader, &frame));
	CHECK(open_descriptors() == opened);
	speaker_end(&speaker);
}

static void slots_without_room_for_their_descriptors_are_an_error(void)
{
	struct speaker speaker = speaker_make();
	struct rlimit before, none;
	struct cm_frame frame;
	int opened;

	CHECK(cm_reader_next(speaker.reader, 0, &frame) == 0);
	say_slots(&speaker, 0, 4, 4);
	opened = open_descriptors();
	CHECK(!getrlimit(RLIMIT_NOFILE, &before));
	none = before;
	none.rlim_cur = 3;
	CHECK(!setrlimit(RLIMIT_NOFILE, &none));
	CHECK_ERRNO(cm_reader_next(speaker.reader, 1000, &frame), EMFILE);
	CHECK(!setrlimit(RLIMIT_NOFILE, &before));
	CHECK(open_descriptors() == opened);
	speaker_end(&speaker);
}

/* Frames name slots by number: a list with a gap would give each frame another's memory. */
static void slots_out_of_order_are_an_error(void)
{
	static const struct {
		uint16_t first;
		uint32_t said, count;
	} wrong[] = { { 1, 2, 2 }, { 0, 3, 2 }, { 0, 1, 2 } };

	for (size_t i = 0; i < sizeof(wrong) / sizeof(wrong[0]); i++) {
		struct speaker speaker = speaker_make();
		struct cm_frame frame;
		int opened = open_descriptors();

		say_slots(&speaker, wrong[i].first, wrong[i].said, wrong[i].count);
		CHECK_ERRNO(cm_reader_next(speaker.reader, 1000, &frame), EPROTO);
		CHECK(open_descriptors() == opened);
		speaker_end(&speaker);
	}
}

/* A packet of a kind; others are passed over. */
static struct cm_plane_descriptor await_kind(int sock, uint8_t kind)
{
	struct cm_plane_descriptor packet = { 0 };

	do
		CHECK(recv(sock, &packet, sizeof(packet), 0) > 0);
	while (packet.kind != kind);
	return packet;
}

static void send_frame(int sock, struct cm_plane_descriptor grant)
{
	grant.kind = CM_PLANE_SUBMIT;
	grant.length = LENGTH;
	CHECK(send(sock, &grant, sizeof(grant), 0) == sizeof(grant));
}

/* The driver is slow to cancel what repeats: who waits is the one that replaces it, and nobody else. */
static void a_frame_that_is_long_in_being_replaced_holds_up_no_other_stream(void)
{
	char *root = fake_root_make();
	struct fake_node *fake = fake_node_start(root, "dev/cm_dma/slow", ANSWER_CANCEL_LATE);
	struct cm_dma *dma = cm_dma_open(root, "slow");
	struct cm_plane_setup setup = {
		.write = true, .cyclic = true, .queue_depth = 4, .length = LENGTH
	};
	struct cm_plane *plane = cm_plane_new();
	struct cm_plane_descriptor grants[2], other = { 0 };
	unsigned char geometry[CM_PLANE_PACKET_MAX];
	int memory = memfd_create("slot", MFD_CLOEXEC), pair[2], stream, writer;
	uint64_t requests;

	CHECK(dma && plane && !ftruncate(memory, LENGTH));
	stream = cm_plane_start(plane, dma, &setup);
	CHECK(cm_plane_add_slot(plane, stream, memory, 1) == 0);
	CHECK(cm_plane_add_slot(plane, stream, memory, 2) == 1);
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair));
	CHECK(!cm_plane_attach(plane, cm_plane_adopt(plane, pair[1]), stream, 2, geometry,
			       geometry_packet(geometry, true)));
	for (int i = 0; i < 2; i++)
		grants[i] = await_kind(pair[0], CM_PLANE_GRANT);
	writer = echo_writer(plane, memory, &other);
	send_frame(pair[0], grants[0]);
	while (!fake_node_requests(fake)) /* it repeats */
		poll(NULL, 0, 1);
	requests = fake_node_requests(fake);
	send_frame(pair[0], grants[1]);
	for (int i = 0; i < 20; i++) {
		send_frame(writer, other);
		CHECK(await_kind(writer, CM_PLANE_DONE).offset == 0);
	}
	CHECK(fake_node_requests(fake) ==
	      requests); /* the cancel waits, and the next frame for it */
	fake_node_speak(fake);
	CHECK(await_kind(pair[0], CM_PLANE_GRANT).slot == grants[0].slot);
	while (fake_node_requests(fake) < requests + 2) /* the cancel, and the next frame */
		poll(NULL, 0, 1);
	fake_node_speak(fake);
	cm_plane_close(plane);
	close(pair[0]);
	close(writer);
	close(memory);
	cm_dma_close(dma);
	fake_node_stop(fake);
	fake_root_remove(root);
}

/* What the hardware took just before its stream ended, the writer is told it took. */
static void a_frame_that_ends_as_its_stream_does_was_taken(void)
{
	char *root = fake_root_make();
	struct fake_node *fake = fake_node_start(root, "dev/cm_dma/quick", END_AT_CANCEL);
	struct cm_dma *dma = cm_dma_open(root, "quick");
	struct cm_plane_setup setup = { .write = true, .queue_depth = 4, .length = LENGTH };
	struct cm_plane *plane = cm_plane_new();
	unsigned char geometry[CM_PLANE_PACKET_MAX];
	int memory = memfd_create("slot", MFD_CLOEXEC), pair[2], stream;

	CHECK(dma && plane && !ftruncate(memory, LENGTH));
	stream = cm_plane_start(plane, dma, &setup);
	CHECK(cm_plane_add_slot(plane, stream, memory, 1) == 0);
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair));
	CHECK(!cm_plane_attach(plane, cm_plane_adopt(plane, pair[1]), stream, 1, geometry,
			       geometry_packet(geometry, true)));
	send_frame(pair[0], await_kind(pair[0], CM_PLANE_GRANT));
	while (!fake_node_requests(fake)) /* it is at the hardware */
		poll(NULL, 0, 1);
	CHECK(!cm_plane_stop(plane, stream, 0));
	CHECK(await_kind(pair[0], CM_PLANE_DONE).offset == 0);
	cm_plane_close(plane);
	close(pair[0]);
	close(memory);
	cm_dma_close(dma);
	fake_node_stop(fake);
	fake_root_remove(root);
}

/* What a client says again and again is reported once, or not at all; others hear nothing of it. */
static void a_packet_that_is_repeated_without_end_is_reported_once(void)
{
	static const struct {
		uint8_t said, answered;
	} kinds[] = { { CM_PLANE_LEAVE, 0 },
		      { CM_PLANE_RELEASE, CM_PLANE_LATE },
		      { CM_PLANE_SUBMIT, CM_PLANE_DONE },
		      { CM_PLANE_PING, CM_PLANE_PONG } };
	struct cm_plane *plane = cm_plane_new();
	struct cm_plane_setup setup = { .write = true, .length = LENGTH };
	int memory = memfd_create("slot", MFD_CLOEXEC);

	CHECK(plane && !ftruncate(memory, LENGTH));
	for (size_t k = 0; k < sizeof(kinds) / sizeof(kinds[0]); k++) {
		int stream = cm_plane_start(plane, NULL, &setup), pair[2], client;
		unsigned char geometry[CM_PLANE_PACKET_MAX];
		struct cm_plane_descriptor packet = {
			.kind = kinds[k].said,
			.slot = 7,
			.flags = (uint8_t)(k + 1), /* the epoch */
		};
		struct cm_plane_event event;
		int reported = 0;

		CHECK(cm_plane_add_slot(plane, stream, memory, 0) == 0);
		CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair));
		client = cm_plane_adopt(plane, pair[1]);
		CHECK(!cm_plane_attach(plane, client, stream, 1, geometry,
				       geometry_packet(geometry, true)));
		for (int i = 0; i < 5000; i++) {
			CHECK(send(pair[0], &packet, sizeof(packet), 0) == sizeof(packet));
			if (kinds[k].answered)
				await_kind(pair[0], kinds[k].answered);
		}
		close(pair[0]);
		for (event.kind = 0; event.kind != CM_PLANE_CLIENT_GONE;) {
			struct pollfd told = { .fd = cm_plane_event_fd(plane), .events = POLLIN };

			CHECK(poll(&told, 1, HUNG_MS) == 1);
			if (!cm_plane_take(plane, &event))
				continue;
			CHECK(event.id == client);
			reported += event.kind == CM_PLANE_CLIENT_LEAVES;
		}
		CHECK(reported == (kinds[k].said == CM_PLANE_LEAVE));
		CHECK(!cm_plane_stop(plane, stream, 0));
	}
	cm_plane_close(plane);
	close(memory);
}

static void numbers_begin_anew_and_leave_out_those_in_use(void)
{
	struct cm_plane *plane = cm_plane_new();
	struct cm_plane_setup setup = { .write = true, .length = LENGTH };
	int pair[2];

	CHECK(plane && cm_plane_start(plane, NULL, &setup) == 1);
	plane->last_id = INT_MAX - 1;
	CHECK(cm_plane_start(plane, NULL, &setup) == INT_MAX);
	CHECK(cm_plane_start(plane, NULL, &setup) == 2);
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair));
	plane->last_id = INT_MAX;
	CHECK(cm_plane_adopt(plane, pair[1]) == 3);
	cm_plane_close(plane);
	close(pair[0]);
}

#define LENT UINT64_C(0x10000000) /* where devices see it */
#define NOBODY 65534

/* A client of @user with memory that its user may transfer, until *@stream is stopped; its end of the socket. */
static int lender(struct cm_plane *plane, int memory, uid_t user, int *stream)
{
	struct cm_plane_setup setup = { .write = true, .length = LENGTH, .address = LENT };
	unsigned char geometry[CM_PLANE_PACKET_MAX];
	uid_t me = geteuid();
	int pair[2];

	*stream = cm_plane_start(plane, NULL, &setup);
	CHECK(cm_plane_add_slot(plane, *stream, memory, 0) == 0);
	/* The system call is this thread's alone: the library's would interrupt the others. */
	CHECK(!syscall(SYS_setresuid, -1, user, -1));
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair));
	CHECK(!syscall(SYS_setresuid, -1, me, -1));
	CHECK(!cm_plane_attach(plane, cm_plane_adopt(plane, pair[1]), *stream, 1, geometry,
			       geometry_packet(geometry, true)));
	return pair[0];
}

struct transfers {
	char *root;
	struct fake_node *fake;
	struct cm_dma *dma;
	struct cm_plane *plane;
	struct cm_plane_descriptor grant;
	int memory, lent, lender, end;
};

/* A client that transfers at most half of the memory at once, which @user has lent. */
static void transfers_make(struct transfers *all, uid_t user)
{
	struct cm_plane_setup setup = {
		.write = true, .queue_depth = 4, .length = LENGTH / 2, .lent = 2
	};
	unsigned char geometry[CM_PLANE_PACKET_MAX];
	int pair[2];

	all->root = fake_root_make();
	all->fake = fake_node_start(all->root, "dev/cm_dma/x", WELL_BEHAVED);
	all->dma = cm_dma_open(all->root, "x");
	all->plane = cm_plane_new();
	all->memory = memfd_create("lent", MFD_CLOEXEC);
	CHECK(all->dma && all->plane && !ftruncate(all->memory, LENGTH));
	all->lender = lender(all->plane, all->memory, user, &all->lent);
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair));
	all->end = pair[0];
	CHECK(!cm_plane_attach(all->plane, cm_plane_adopt(all->plane, pair[1]),
			       cm_plane_start(all->plane, all->dma, &setup), 2, geometry,
			       geometry_packet(geometry, true)));
	all->grant = await_kind(all->end, CM_PLANE_GRANT);
}

static void transfers_end(struct transfers *all)
{
	cm_plane_close(all->plane);
	close(all->end);
	close(all->lender);
	close(all->memory);
	cm_dma_close(all->dma);
	fake_node_stop(all->fake);
	fake_root_remove(all->root);
}

/* How a transfer ended: the errno, and the bytes. */
static struct cm_plane_descriptor transferred(struct transfers *all, uint64_t address,
					      uint64_t length)
{
	struct cm_plane_descriptor packet = all->grant;

	packet.kind = CM_PLANE_SUBMIT;
	packet.length = length;
	packet.timestamp_ns = address;
	CHECK(send(all->end, &packet, sizeof(packet), 0) == sizeof(packet));
	return await_kind(all->end, CM_PLANE_DONE);
}

static void bytes_that_a_user_has_lent_are_transferred_until_they_are_gone(void)
{
	static const struct {
		uint64_t address, length;
		uint32_t error;
	} wrong[] = { { LENT - 1, 2, EFAULT },	    { LENT + LENGTH - 1, 2, EFAULT },
		      { LENT + LENGTH, 1, EFAULT }, { LENT, 0, EFAULT },
		      { LENT, UINT64_MAX, EFAULT }, { LENT, LENGTH / 2 + 1, EMSGSIZE } };
	struct transfers all;
	unsigned int requests = 0;

	transfers_make(&all, geteuid());
	for (int i = 0; i < 3; i++) {
		struct cm_plane_descriptor done = transferred(&all, LENT + 64, LENGTH / 2);

		CHECK(done.offset == 0 && done.length == LENGTH / 4); /* the node moves half */
		if (!i)
			requests = fake_node_requests(all.fake);
	}
	CHECK(fake_node_requests(all.fake) == requests + 2); /* it is imported once */
	for (size_t i = 0; i < sizeof(wrong) / sizeof(wrong[0]); i++)
		CHECK(transferred(&all, wrong[i].address, wrong[i].length).offset ==
		      wrong[i].error);
	CHECK(!cm_plane_stop(all.plane, all.lent, 0));
	CHECK(transferred(&all, LENT + 64, 64).offset == EFAULT);
	CHECK(fake_node_requests(all.fake) == requests + 3); /* the handle is given back */
	transfers_end(&all);
}

static void bytes_of_another_user_are_not_transferred(void)
{
	struct transfers all;

	transfers_make(&all, NOBODY);
	CHECK(transferred(&all, LENT, 64).offset == EFAULT);
	transfers_end(&all);
}

int main(void)
{
	RUN(a_packet_that_is_repeated_without_end_is_reported_once);
	RUN(numbers_begin_anew_and_leave_out_those_in_use);
	RUN(a_frame_that_is_long_in_being_replaced_holds_up_no_other_stream);
	RUN(a_frame_that_ends_as_its_stream_does_was_taken);
	RUN(readers_come_and_go);
	RUN(streams_end_under_their_readers);
	RUN(the_plane_ends_under_its_readers);
	RUN(a_writer_gets_its_slots_back);
	RUN(slots_without_room_for_their_descriptors_are_an_error);
	RUN(slots_out_of_order_are_an_error);
	RUN(a_slot_that_is_shorter_than_said_is_an_error);
	RUN(descriptors_that_come_with_a_frame_are_closed);
	RUN(a_stream_that_is_long_in_ending_holds_up_no_other);
	RUN(bytes_that_a_user_has_lent_are_transferred_until_they_are_gone);
	if (geteuid() == 0)
		RUN(bytes_of_another_user_are_not_transferred);
	else
		puts("skipped bytes_of_another_user_are_not_transferred: only root has another user");
	return 0;
}
