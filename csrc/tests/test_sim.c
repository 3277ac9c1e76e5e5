// SPDX-License-Identifier: Apache-2.0
/* The simulated board's fast path, with a client at the other ends; run under the thread sanitizer too. */
#include <poll.h>
#include <stdint.h>
#include <sys/socket.h>

#include "cm_node.h"
#include "sim_fifo.h"
#include "test.h"

#define FRAME 100000 /* several pieces, and a rest */
#define HANDLE 7
#define PATIENCE_MS 60000

struct end {
	struct cm_sim_channel channel;
	struct cm_sim_buffer buffer;
	int requests, events; /* the client's ends */
	uint8_t memory[2 * FRAME];
};

struct bench {
	struct cm_sim_fifo *fifo;
	struct end source, sink;
};

struct request {
	struct cm_node_request head;
	struct cm_dma_submit submit;
};

static void open_end(struct end *end)
{
	int requests[2], events[2];

	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET, 0, requests));
	CHECK(!socketpair(AF_UNIX, SOCK_SEQPACKET, 0, events));
	end->requests = requests[0];
	end->events = events[0];
	end->buffer = (struct cm_sim_buffer){
		.memory = end->memory,
		.length = sizeof(end->memory),
		.handle = HANDLE,
	};
	end->channel = (struct cm_sim_channel){
		.request_fd = requests[1],
		.event_fd = events[1],
		.buffers = &end->buffer,
		.buffer_count = 1,
		.packet_cost = 1, /* of one byte: the client counts as far behind as it can be */
	};
}

static struct bench *start(void)
{
	struct bench *bench = calloc(1, sizeof(*bench));

	CHECK(bench);
	open_end(&bench->source);
	open_end(&bench->sink);
	bench->fifo = cm_sim_fifo_new();
	CHECK(bench->fifo);
	CHECK(!cm_sim_fifo_run(bench->fifo, &bench->source.channel, &bench->sink.channel));
	return bench;
}

static void close_end(struct end *end)
{
	close(end->requests);
	close(end->events);
	close(end->channel.request_fd);
	close(end->channel.event_fd);
}

static void stop(struct bench *bench)
{
	cm_sim_fifo_close(bench->fifo);
	close_end(&bench->source);
	close_end(&bench->sink);
	free(bench);
}

static struct request submit_of(uint64_t offset, uint64_t length, uint64_t cookie)
{
	return (struct request){
		.head = { .op = CM_DMA_IOC_SUBMIT, .length = sizeof(struct cm_dma_submit) },
		.submit = { .size = sizeof(struct cm_dma_submit),
			    .handle = HANDLE,
			    .offset = offset,
			    .length = length,
			    .cookie = cookie },
	};
}

static void ask(const struct end *end, const struct request *request)
{
	CHECK(send(end->requests, request, sizeof(*request), 0) == sizeof(*request));
}

static void await(int fd)
{
	struct pollfd one = { .fd = fd, .events = POLLIN };

	CHECK(poll(&one, 1, PATIENCE_MS) == 1);
}

static void submit(const struct end *end, uint64_t offset, uint64_t length, uint64_t cookie)
{
	struct request request = submit_of(offset, length, cookie);
	struct {
		struct cm_node_reply head;
		struct cm_dma_submit submit;
	} reply;

	ask(end, &request);
	await(end->requests);
	CHECK(recv(end->requests, &reply, sizeof(reply), 0) == sizeof(reply));
	CHECK(reply.head.op == CM_DMA_IOC_SUBMIT && !reply.head.error);
	CHECK(reply.submit.cookie == cookie);
}

static struct cm_dma_completion completion(const struct end *end)
{
	struct cm_dma_completion done;

	await(end->events);
	CHECK(recv(end->events, &done, sizeof(done), 0) == sizeof(done));
	return done;
}

static void a_frame_arrives_whole(void)
{
	struct bench *bench = start();
	struct cm_dma_completion done;

	for (size_t i = 0; i < FRAME; i++)
		bench->source.memory[FRAME + i] = (uint8_t)(i * 7 + i / 251);
	submit(&bench->source, FRAME, FRAME, 3);
	submit(&bench->sink, 0, FRAME, 4);
	done = completion(&bench->sink);
	CHECK(done.cookie == 4 && done.length == FRAME && !done.status && !done.sequence);
	done = completion(&bench->source);
	CHECK(done.cookie == 3 && done.length == FRAME && !done.status && done.timestamp_ns);
	CHECK(!memcmp(bench->sink.memory, bench->source.memory + FRAME, FRAME));
	CHECK(!bench->sink.memory[FRAME]);
	stop(bench);
}

static void short_and_long_packets(void)
{
	struct bench *bench = start();
	struct cm_dma_completion done;

	submit(&bench->sink, 0, FRAME, 1);
	submit(&bench->source, 0, 10, 2);
	done = completion(&bench->sink);
	CHECK(done.length == 10 && !done.status);
	submit(&bench->sink, 0, 10, 3);
	submit(&bench->source, 0, FRAME, 4);
	done = completion(&bench->sink);
	CHECK(done.length == 10 && done.status == -EIO && done.sequence == 1);
	CHECK(completion(&bench->source).cookie == 2 && completion(&bench->source).cookie == 4);
	stop(bench);
}

/* What is not a plain submit stays in the socket, and the thread gives the channels back. */
static void parks_for(struct request request)
{
	struct bench *bench = start();
	struct request left;

	submit(&bench->source, 0, 64, 9);
	ask(&bench->source, &request);
	await(cm_sim_fifo_event_fd(bench->fifo));
	cm_sim_fifo_park(bench->fifo);
	CHECK(recv(bench->source.channel.request_fd, &left, sizeof(left), 0) == sizeof(left));
	CHECK(!memcmp(&left, &request, sizeof(left)));
	CHECK(bench->source.channel.count == 1 && bench->source.channel.queue[0].cookie == 9);
	CHECK(!cm_sim_fifo_run(bench->fifo, &bench->source.channel, &bench->sink.channel));
	submit(&bench->sink, 0, 64, 10);
	CHECK(completion(&bench->sink).cookie == 10);
	CHECK(completion(&bench->source).cookie == 9);
	stop(bench);
}

static void parks_for_what_it_does_not_know(void)
{
	struct request cancel = submit_of(0, 64, 1), handle = cancel, range = cancel,
		       cyclic = cancel;
	struct request wraps = cancel, empty = cancel, size = cancel;

	cancel.head.op = CM_DMA_IOC_CANCEL;
	handle.submit.handle++;
	range.submit.offset = 2 * FRAME - 63;
	wraps.submit.offset = UINT64_MAX - 62;
	empty.submit.length = 0;
	size.submit.size--;
	cyclic.submit.flags = CM_DMA_SUBMIT_CYCLIC;
	cyclic.submit.period = 64;
	parks_for(cancel);
	parks_for(handle);
	parks_for(range);
	parks_for(wraps);
	parks_for(empty);
	parks_for(size);
	parks_for(cyclic);
}

static void parks_when_a_client_goes(void)
{
	struct bench *bench = start();

	CHECK(!shutdown(bench->sink.requests, SHUT_WR));
	await(cm_sim_fifo_event_fd(bench->fifo));
	cm_sim_fifo_park(bench->fifo);
	stop(bench);
}

static void parks_when_completions_are_not_read(void)
{
	struct bench *bench = start();
	struct request request = submit_of(0, 8, 0);

	for (uint64_t i = 0; i < CM_SIM_QUEUE; i++) {
		submit(&bench->sink, 0, 8, i);
		submit(&bench->source, 0, 8, i);
		CHECK(completion(&bench->source).cookie == i);
	}
	ask(&bench->sink, &request);
	await(cm_sim_fifo_event_fd(bench->fifo));
	cm_sim_fifo_park(bench->fifo);
	CHECK(bench->sink.channel.sent == CM_SIM_QUEUE && !bench->sink.channel.count);
	stop(bench);
}

static void is_parked_and_run_while_frames_move(void)
{
	struct bench *bench = start();

	for (uint64_t i = 0; i < 500; i++) {
		memset(bench->source.memory, (int)i, FRAME);
		submit(&bench->sink, 0, FRAME, i);
		submit(&bench->source, 0, FRAME, i);
		cm_sim_fifo_park(bench->fifo);
		CHECK(bench->source.channel.sent + bench->source.channel.count == i + 1);
		CHECK(!cm_sim_fifo_run(bench->fifo, &bench->source.channel, &bench->sink.channel));
		CHECK_ERRNO(
			cm_sim_fifo_run(bench->fifo, &bench->source.channel, &bench->sink.channel),
			EBUSY);
		CHECK(completion(&bench->sink).sequence == i);
		CHECK(completion(&bench->source).cookie == i);
		CHECK(bench->sink.memory[0] == (uint8_t)i &&
		      bench->sink.memory[FRAME - 1] == (uint8_t)i);
	}
	stop(bench);
}

int main(void)
{
	alarm(TEST_SECONDS);
	RUN(a_frame_arrives_whole);
	RUN(short_and_long_packets);
	RUN(parks_for_what_it_does_not_know);
	RUN(parks_when_a_client_goes);
	RUN(parks_when_completions_are_not_read);
	RUN(is_parked_and_run_while_frames_move);
	return 0;
}
