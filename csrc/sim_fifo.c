// SPDX-License-Identifier: Apache-2.0
/* One simulated DMA channel: plain submits in, completions out; and the thread that moves frames between two. */
#include <errno.h>
#include <linux/sockios.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "clock.h"
#include "cm_node.h"
#include "sim_fifo.h"

#define MAX_LENGTH ((UINT64_C(1) << 26) - 1) /* cm/simulation/software/hardware/dma.py */

static const struct cm_sim_transfer *head_of(const struct cm_sim_channel *channel)
{
	return &channel->queue[channel->first];
}

struct request {
	struct cm_node_request head;
	struct cm_dma_submit submit;
};

struct answer {
	struct cm_node_reply head;
	struct cm_dma_submit submit;
};

static const struct cm_sim_buffer *find(const struct cm_sim_channel *channel, uint32_t handle)
{
	for (uint32_t i = 0; i < channel->buffer_count; i++)
		if (channel->buffers[i].handle == handle)
			return &channel->buffers[i];
	return NULL;
}

static uint8_t *memory_of(const struct cm_sim_channel *channel)
{
	const struct cm_sim_transfer *head = head_of(channel);

	return find(channel, head->handle)->memory + head->offset;
}

/* Whether the client has fewer than 64 completions that are waiting or to come. */
static bool room(struct cm_sim_channel *channel)
{
	uint64_t limit = CM_SIM_QUEUE - channel->count;
	int queued;

	if (!limit)
		return false;
	if (channel->sent - channel->read < limit)
		return true;
	if (ioctl(channel->event_fd, SIOCOUTQ, &queued) || queued < 0)
		return false;
	channel->read = channel->sent - (uint64_t)queued / channel->packet_cost;
	return channel->sent - channel->read < limit;
}

static bool plain(const struct cm_sim_channel *channel, const struct request *request)
{
	const struct cm_dma_submit *submit = &request->submit;
	const struct cm_sim_buffer *buffer;

	if (request->head.op != CM_DMA_IOC_SUBMIT || request->head.length != sizeof(*submit) ||
	    submit->size != sizeof(*submit) || submit->flags || submit->reserved || submit->period)
		return false;
	buffer = find(channel, submit->handle);
	return buffer && submit->length && submit->length <= MAX_LENGTH &&
	       submit->offset <= buffer->length &&
	       submit->length <= buffer->length - submit->offset;
}

static void push(struct cm_sim_channel *channel, const struct cm_dma_submit *submit)
{
	uint32_t place = (channel->first + channel->count++) % CM_SIM_QUEUE;

	channel->queue[place] = (struct cm_sim_transfer){
		.offset = submit->offset,
		.length = submit->length,
		.cookie = submit->cookie,
		.handle = submit->handle,
	};
}

static bool reply(struct cm_sim_channel *channel, const struct cm_dma_submit *submit)
{
	struct answer answer = {
		.head = { .op = CM_DMA_IOC_SUBMIT, .length = sizeof(*submit) },
		.submit = *submit,
	};
	ssize_t sent;

	do {
		sent = send(channel->request_fd, &answer, sizeof(answer),
			    MSG_DONTWAIT | MSG_NOSIGNAL);
	} while (sent < 0 && errno == EINTR);
	if (sent >= 0)
		return true;
	channel->owed = true; /* or the client has gone, which the board will notice */
	channel->owed_submit = *submit;
	return false;
}

/* Serve one request, if one waits; false where it is not for us, and stays. */
static bool serve(struct cm_sim_channel *channel)
{
	const int flags = MSG_DONTWAIT | MSG_TRUNC;
	struct request request;
	ssize_t got = recv(channel->request_fd, &request, sizeof(request), flags | MSG_PEEK);

	if (got < 0)
		return errno == EAGAIN || errno == EINTR;
	if (got != (ssize_t)sizeof(request) || !plain(channel, &request) || !room(channel))
		return false;
	if (recv(channel->request_fd, &request, sizeof(request), flags) != got)
		return false;
	push(channel, &request.submit);
	return reply(channel, &request.submit);
}

/* The transfer at the head has moved @length bytes. */
static void complete(struct cm_sim_channel *channel, uint64_t length, int32_t status)
{
	struct cm_dma_completion done = {
		.cookie = head_of(channel)->cookie,
		.length = length,
		.timestamp_ns = (uint64_t)cm_clock_ns(),
		.sequence = channel->sequence++,
		.status = status,
	};

	channel->first = (channel->first + 1) % CM_SIM_QUEUE;
	channel->count--;
	channel->moved += length;
	if (send(channel->event_fd, &done, sizeof(done), MSG_DONTWAIT | MSG_NOSIGNAL) >= 0)
		channel->sent++;
}

/* A few KiB in hardware; here as much as stays in the second-level cache with room for others. */
#define FIFO_BYTES (32 << 10)

enum { SOURCE, SINK, SIDES };

struct cm_sim_fifo {
	pthread_t thread;
	pthread_mutex_t lock; /* of running and ending */
	pthread_cond_t changed;
	bool running; /* the thread has the channels */
	bool ending;
	atomic_bool stopping;
	int wake_fd;  /* readable: park */
	int event_fd; /* readable: has parked by itself */
	struct cm_sim_channel *channel[SIDES];
	uint8_t bytes[FIFO_BYTES];
};

static void ring(int fd)
{
	/* It fails only when the counter is full: then it is readable already. */
	(void)!eventfd_write(fd, 1);
}

static void silence(int fd)
{
	eventfd_t count;

	(void)!eventfd_read(fd, &count);
}

static void through(struct cm_sim_fifo *fifo, uint8_t *to, const uint8_t *from, uint64_t length)
{
	while (length) {
		size_t piece = length < FIFO_BYTES ? (size_t)length : FIFO_BYTES;

		memcpy(fifo->bytes, from, piece);
		memcpy(to, fifo->bytes, piece);
		from += piece;
		to += piece;
		length -= piece;
	}
}

static bool ready(const struct cm_sim_fifo *fifo)
{
	return fifo->channel[SOURCE]->count && fifo->channel[SINK]->count;
}

/* Move one packet: what does not fit into the receiving buffer is lost, with an error there. */
static void move(struct cm_sim_fifo *fifo)
{
	struct cm_sim_channel *source = fifo->channel[SOURCE], *sink = fifo->channel[SINK];
	uint64_t length = head_of(source)->length, space = head_of(sink)->length;
	uint64_t stored = length < space ? length : space;

	through(fifo, memory_of(sink), memory_of(source), stored);
	complete(sink, stored, stored < length ? -EIO : 0);
	complete(source, length, 0);
}

/* Both channels' requests, then a frame if one can move; false: the board is needed. */
static bool step(struct cm_sim_fifo *fifo)
{
	struct pollfd fds[SIDES + 1] = {
		[SOURCE] = { .fd = fifo->channel[SOURCE]->request_fd, .events = POLLIN },
		[SINK] = { .fd = fifo->channel[SINK]->request_fd, .events = POLLIN },
		[SIDES] = { .fd = fifo->wake_fd, .events = POLLIN },
	};

	if (poll(fds, SIDES + 1, ready(fifo) ? 0 : -1) < 0)
		return errno == EINTR;
	for (int i = 0; i < SIDES; i++)
		if (fds[i].revents && !serve(fifo->channel[i]))
			return false;
	if (ready(fifo) && !atomic_load(&fifo->stopping))
		move(fifo);
	return true;
}

static bool await_work(struct cm_sim_fifo *fifo)
{
	bool ending;

	pthread_mutex_lock(&fifo->lock);
	while (!fifo->running && !fifo->ending)
		pthread_cond_wait(&fifo->changed, &fifo->lock);
	ending = fifo->ending;
	pthread_mutex_unlock(&fifo->lock);
	return !ending;
}

static void end_work(struct cm_sim_fifo *fifo, bool by_itself)
{
	pthread_mutex_lock(&fifo->lock);
	fifo->running = false;
	pthread_cond_broadcast(&fifo->changed);
	if (by_itself)
		ring(fifo->event_fd);
	pthread_mutex_unlock(&fifo->lock);
}

static void *run(void *argument)
{
	struct cm_sim_fifo *fifo = argument;

	while (await_work(fifo)) {
		bool ours = true;

		while (ours && !atomic_load(&fifo->stopping))
			ours = step(fifo);
		end_work(fifo, !ours);
	}
	return NULL;
}

/* Signals are for the board's threads. */
static int start_thread(struct cm_sim_fifo *fifo)
{
	sigset_t all, before;
	int error;

	sigfillset(&all);
	pthread_sigmask(SIG_SETMASK, &all, &before);
	error = pthread_create(&fifo->thread, NULL, run, fifo);
	pthread_sigmask(SIG_SETMASK, &before, NULL);
	errno = error;
	return error ? -1 : 0;
}

static void free_fifo(struct cm_sim_fifo *fifo)
{
	int error = errno;

	if (fifo->wake_fd >= 0)
		close(fifo->wake_fd);
	if (fifo->event_fd >= 0)
		close(fifo->event_fd);
	pthread_cond_destroy(&fifo->changed);
	pthread_mutex_destroy(&fifo->lock);
	free(fifo);
	errno = error;
}

struct cm_sim_fifo *cm_sim_fifo_new(void)
{
	struct cm_sim_fifo *fifo = calloc(1, sizeof(*fifo));

	if (!fifo)
		return NULL;
	pthread_mutex_init(&fifo->lock, NULL);
	pthread_cond_init(&fifo->changed, NULL);
	fifo->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	fifo->event_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
	if (fifo->wake_fd < 0 || fifo->event_fd < 0 || start_thread(fifo)) {
		free_fifo(fifo);
		return NULL;
	}
	return fifo;
}

void cm_sim_fifo_close(struct cm_sim_fifo *fifo)
{
	if (!fifo)
		return;
	cm_sim_fifo_park(fifo);
	pthread_mutex_lock(&fifo->lock);
	fifo->ending = true;
	pthread_cond_broadcast(&fifo->changed);
	pthread_mutex_unlock(&fifo->lock);
	pthread_join(fifo->thread, NULL);
	free_fifo(fifo);
}

int cm_sim_fifo_event_fd(struct cm_sim_fifo *fifo)
{
	return fifo->event_fd;
}

int cm_sim_fifo_run(struct cm_sim_fifo *fifo, struct cm_sim_channel *source,
		    struct cm_sim_channel *sink)
{
	bool busy;

	pthread_mutex_lock(&fifo->lock);
	busy = fifo->running;
	if (!busy) {
		fifo->channel[SOURCE] = source;
		fifo->channel[SINK] = sink;
		silence(fifo->wake_fd);
		silence(fifo->event_fd);
		atomic_store(&fifo->stopping, false);
		fifo->running = true;
		pthread_cond_broadcast(&fifo->changed);
	}
	pthread_mutex_unlock(&fifo->lock);
	errno = EBUSY;
	return busy ? -1 : 0;
}

void cm_sim_fifo_park(struct cm_sim_fifo *fifo)
{
	atomic_store(&fifo->stopping, true);
	ring(fifo->wake_fd);
	pthread_mutex_lock(&fifo->lock);
	while (fifo->running)
		pthread_cond_wait(&fifo->changed, &fifo->lock);
	silence(fifo->event_fd);
	pthread_mutex_unlock(&fifo->lock);
}
