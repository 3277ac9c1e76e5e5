// SPDX-License-Identifier: Apache-2.0
/* Streams of the data plane: slots on their way to the hardware and back. */
#include <errno.h>
#include <stdlib.h>
#include <sys/epoll.h>

#include "clock.h"
#include "plane_private.h"

#define TAKE_AT_ONCE 16

struct stream *stream_find(struct cm_plane *plane, int id)
{
	struct stream *stream = plane->streams;

	while (stream && stream->id != id)
		stream = stream->next;
	if (!stream)
		errno = ENOENT;
	return stream;
}

static void lose(struct cm_plane *plane, struct stream *stream, int error)
{
	if (stream->lost)
		return;
	stream->lost = true;
	epoll_ctl(plane->epoll_fd, EPOLL_CTL_DEL, stream->event_fd, NULL);
	plane_report(plane, CM_PLANE_STREAM_LOST, stream->id, error);
}

static int submit(struct stream *stream, const struct slot *slot, uint32_t number)
{
	const struct cm_plane_setup *setup = &stream->setup;
	uint64_t length = setup->write ? slot->frame.length : setup->length;
	uint64_t offset = setup->write ? slot->frame.offset : 0;
	uint32_t flags = setup->cyclic ? CM_DMA_SUBMIT_CYCLIC : 0;

	if (setup->lines)
		return cm_dma_submit_video(stream->dma, slot->handle, offset, setup->lines,
					   setup->line_bytes, setup->stride, number, flags);
	return cm_dma_submit(stream->dma, slot->handle, offset, length, number, flags,
			     setup->cyclic ? length : 0);
}

static void record(struct stream *stream, uint64_t length, uint64_t completed_ns)
{
	uint64_t now = (uint64_t)cm_clock_ns();
	uint32_t place = (uint32_t)(stream->recent++ % CM_PLANE_RECENT);

	stream->stats.frames++;
	stream->stats.bytes += length;
	stream->stats.at_ns[place] = completed_ns;
	stream->stats.latency_ns[place] = now > completed_ns ? now - completed_ns : 0;
}

static void note_error(struct stream *stream, int error, uint64_t asked, uint64_t came)
{
	stream->stats.errors++;
	stream->stats.error = error;
	stream->stats.asked = asked;
	stream->stats.came = came;
}

/* Tell a writer the outcome of its transfer. */
static void tell_done(struct stream *stream, struct slot *slot, uint64_t moved, uint32_t error,
		      uint64_t at_ns)
{
	struct cm_plane_descriptor packet = slot->frame;

	packet.kind = CM_PLANE_DONE;
	packet.flags = stream->epoch;
	packet.offset = error;
	packet.timestamp_ns = at_ns;
	if (stream->setup.lent)
		packet.length = moved;
	if (!slot->owner)
		return;
	slot->owner->frames += !error;
	client_send(slot->owner, &packet, sizeof(packet));
}

/* The slot belongs to its writer again, or is free if the writer has gone. */
static void written(struct stream *stream, struct slot *slot, uint64_t moved, uint32_t error,
		    uint64_t at_ns)
{
	slot->queued = false;
	tell_done(stream, slot, moved, error, at_ns);
	if (!error)
		record(stream, stream->setup.lent ? moved : slot->frame.length, at_ns);
	else if (error != ECANCELED)
		note_error(stream, (int)error, slot->frame.length, moved);
}

static void push(struct cm_plane *plane, struct stream *stream);

/* The repeating frame was cancelled. */
static void cycle_cancelled(struct stream *stream)
{
	struct slot *slot = &stream->slot[stream->cycling];

	stream->cycling = -1;
	slot->queued = false;
	if (slot->owner)
		client_grant(slot->owner, stream, slot);
}

/* A driver may need seconds to cancel: the lock is not held meanwhile, and the other streams go on. */
static void *replace(void *argument)
{
	struct stream *stream = argument;
	bool more;

	do {
		cm_dma_cancel(stream->dma);
		pthread_mutex_lock(&stream->plane->lock);
		stream->replacing = false;
		if (stream->cycling >= 0)
			cycle_cancelled(stream);
		push(stream->plane, stream);
		more = stream->replacing;
		pthread_mutex_unlock(&stream->plane->lock);
	} while (more);
	return NULL;
}

/* Replace the repeating frame by a new one, in another thread. */
static void end_cycle(struct stream *stream)
{
	stream->replacing = true;
	if (stream->aside && pthread_equal(pthread_self(), stream->replacer))
		return; /* it repeats once more */
	if (stream->aside)
		pthread_join(stream->replacer, NULL); /* it is over: nothing was being replaced */
	stream->aside = !plane_thread(&stream->replacer, replace, stream);
	if (stream->aside)
		return;
	cm_dma_cancel(stream->dma);
	stream->replacing = false;
	cycle_cancelled(stream);
}

static int push_one(struct stream *stream, uint32_t number)
{
	if (submit(stream, &stream->slot[number], number))
		return -1;
	if (stream->setup.cyclic) {
		stream->cycling = (int)number;
		stream->announced = false;
	} else {
		stream->under_way++;
	}
	return 0;
}

static uint32_t pop(struct stream *stream)
{
	uint32_t number = stream->waiting[stream->first];

	stream->first = (stream->first + 1) % CM_PLANE_SLOTS_MAX;
	stream->count--;
	return number;
}

/* Give the hardware as many waiting slots as its queue holds. */
static void push(struct cm_plane *plane, struct stream *stream)
{
	while (stream->count && stream->under_way < stream->setup.queue_depth && !stream->lost &&
	       !stream->ending && !stream->replacing) {
		uint32_t number = stream->waiting[stream->first];
		bool fault;

		if (stream->setup.cyclic && stream->cycling >= 0) {
			end_cycle(stream);
			continue;
		}
		if (!push_one(stream, number)) {
			pop(stream);
			continue;
		}
		if (errno == EBUSY && stream->under_way)
			return; /* a completion makes room */
		fault = stream->setup.write && (errno == EINVAL || errno == EMSGSIZE);
		if (!fault) {
			lose(plane, stream, errno);
			return;
		}
		written(stream, &stream->slot[pop(stream)], 0, (uint32_t)errno,
			(uint64_t)cm_clock_ns());
	}
}

void stream_queue(struct cm_plane *plane, struct stream *stream, uint32_t number)
{
	struct slot *slot = &stream->slot[number];
	uint32_t place = (stream->first + stream->count) % CM_PLANE_SLOTS_MAX;

	slot->queued = true;
	slot->outcome = ECANCELED;
	slot->moved = 0;
	if (!stream->dma) {
		written(stream, slot, slot->frame.length, 0, (uint64_t)cm_clock_ns());
		return;
	}
	stream->waiting[place] = (uint16_t)number;
	stream->count++;
	push(plane, stream);
}

/* Whether a frame comes sooner than the stream's rate allows. */
static bool too_soon(struct stream *stream, uint64_t at_ns)
{
	uint64_t period = stream->setup.period_ns;

	if (!period)
		return false;
	if (at_ns < stream->due_ns)
		return true;
	/* In step with the rate, unless a frame was late by more than a period. */
	stream->due_ns = at_ns - stream->due_ns > period ? at_ns + period : stream->due_ns + period;
	return false;
}

static void hand_on(struct cm_plane *plane, struct stream *stream, uint32_t number)
{
	struct slot *slot = &stream->slot[number];

	for (struct client *client = plane->clients; client; client = client->next) {
		if (client->stream != stream || client->leaving || client->broken)
			continue;
		if (!client_offer(client, stream, number)) {
			slot->holders++;
			continue;
		}
		client->dropped++;
		stream->stats.dropped++;
	}
	record(stream, slot->frame.length, slot->frame.timestamp_ns);
}

static void read_done(struct cm_plane *plane, struct stream *stream,
		      const struct cm_dma_completion *completion)
{
	uint32_t number = (uint32_t)completion->cookie;
	struct slot *slot = &stream->slot[number];

	slot->queued = false;
	stream->under_way--;
	stream->stats.idle += !stream->under_way && !stream->count;
	if (completion->status == -ECANCELED)
		return;
	if (completion->status) {
		note_error(stream, -completion->status, stream->setup.length, completion->length);
		stream->sequence++; /* the frame that failed has a number: readers see the gap */
	} else if (!too_soon(stream, completion->timestamp_ns)) {
		slot->frame = (struct cm_plane_descriptor){
			.slot = (uint16_t)number,
			.kind = CM_PLANE_FRAME,
			.flags = stream->epoch,
			.length = completion->length,
			.sequence = stream->sequence++,
			.timestamp_ns = completion->timestamp_ns,
		};
		slot->generation = stream->generation;
		hand_on(plane, stream, number);
	}
	stream->generation = generation_at(plane, completion->timestamp_ns, stream->generation);
	if (!slot->holders)
		stream_queue(plane, stream, number);
}

static void cycle_done(struct stream *stream, const struct cm_dma_completion *completion)
{
	struct slot *slot = &stream->slot[completion->cookie];

	if ((int)completion->cookie != stream->cycling || completion->status == -ECANCELED)
		return;
	if (completion->status) {
		stream->cycling = -1;
		written(stream, slot, completion->length, (uint32_t)-completion->status,
			completion->timestamp_ns);
		return;
	}
	if (!stream->announced)
		tell_done(stream, slot, completion->length, 0, completion->timestamp_ns);
	stream->announced = true;
	record(stream, slot->frame.length, completion->timestamp_ns);
}

static void completed(struct cm_plane *plane, struct stream *stream,
		      const struct cm_dma_completion *completion)
{
	if (completion->cookie >= stream->slots)
		return;
	if (stream->setup.cyclic) {
		cycle_done(stream, completion);
	} else if (stream->setup.write) {
		stream->under_way--;
		written(stream, &stream->slot[completion->cookie], completion->length,
			(uint32_t)-completion->status, completion->timestamp_ns);
	} else {
		read_done(plane, stream, completion);
	}
}

void stream_completed(struct cm_plane *plane, struct stream *stream)
{
	struct cm_dma_completion completions[TAKE_AT_ONCE];
	ssize_t taken = cm_dma_take(stream->dma, completions, TAKE_AT_ONCE);

	if (taken < 0) {
		lose(plane, stream, errno);
		return;
	}
	for (ssize_t i = 0; i < taken; i++)
		completed(plane, stream, &completions[i]);
	push(plane, stream);
}

void stream_stop_queueing(struct stream *stream)
{
	stream->ending = true;
	if (stream->dma && !stream->lost)
		epoll_ctl(stream->plane->epoll_fd, EPOLL_CTL_DEL, stream->event_fd, NULL);
}

/* What ended before it could be cancelled: tell_writers() says so. */
static void note_end(struct stream *stream, const struct cm_dma_completion *completion)
{
	struct slot *slot;

	if (completion->cookie >= stream->slots || completion->status == -ECANCELED)
		return;
	slot = &stream->slot[completion->cookie];
	slot->outcome = (uint32_t)-completion->status;
	slot->moved = completion->length;
	slot->ended_ns = completion->timestamp_ns;
}

void stream_cancel(struct stream *stream)
{
	struct cm_dma_completion completions[TAKE_AT_ONCE];
	ssize_t taken;

	if (stream->aside)
		pthread_join(stream->replacer, NULL);
	stream->aside = false;
	if (!stream->dma || cm_dma_cancel(stream->dma))
		return;
	while ((taken = cm_dma_take(stream->dma, completions, TAKE_AT_ONCE)) > 0)
		for (ssize_t i = 0; i < taken; i++)
			note_end(stream, &completions[i]);
}

/* Tell writers about transfers that were under way. */
static void tell_writers(struct stream *stream)
{
	uint64_t now = (uint64_t)cm_clock_ns();

	if (stream->cycling >= 0 && stream->announced)
		stream->slot[stream->cycling].queued =
			false; /* its writer knows that it was taken */
	for (struct slot *slot = stream->slot; slot < stream->slot + stream->slots; slot++)
		if (slot->queued && stream->setup.write)
			written(stream, slot, slot->moved, slot->outcome,
				slot->outcome == ECANCELED ? now : slot->ended_ns);
}

int stream_import(struct stream *stream, const struct stream *memory, uint32_t *handle)
{
	struct cm_buffer buffer;

	for (uint32_t i = 0; i < stream->imports; i++) {
		if (stream->import[i].memory != memory->id)
			continue;
		*handle = stream->import[i].handle;
		return 0;
	}
	if (stream->imports == IMPORTS_MAX) {
		errno = ENOSPC;
		return -1;
	}
	if (cm_dma_import(stream->dma, memory->slot[0].fd, &buffer))
		return -1;
	cm_buffer_close(&buffer);
	*handle = buffer.handle;
	stream->import[stream->imports++] = (struct import){ memory->id, buffer.handle };
	return 0;
}

/* Memory goes: a transfer that still uses it takes its client along, so that the stream ends. */
static void forget(struct stream *stream, int memory)
{
	for (uint32_t i = 0; i < stream->imports; i++) {
		uint32_t handle = stream->import[i].handle;

		if (stream->import[i].memory != memory)
			continue;
		stream->import[i] = stream->import[--stream->imports];
		for (struct slot *slot = stream->slot; slot < stream->slot + stream->slots; slot++)
			if (slot->queued && slot->handle == handle && slot->owner)
				client_break_off(slot->owner, EFAULT);
		if (!stream->lost && !stream->ending)
			cm_dma_free(stream->dma, handle);
		return;
	}
}

void stream_end(struct cm_plane *plane, struct stream *stream, int error)
{
	struct stream **link = &plane->streams;
	struct cm_plane_descriptor packet = {
		.kind = CM_PLANE_STOPPED,
		.flags = stream->epoch,
		.offset = (uint32_t)error,
		.sequence = stream->sequence,
		.timestamp_ns = (uint64_t)cm_clock_ns(),
	};

	tell_writers(stream);
	for (struct stream *other = plane->streams; stream->setup.address && other;
	     other = other->next)
		forget(other, stream->id);
	for (struct client *client = plane->clients; client; client = client->next) {
		if (client->stream != stream)
			continue;
		client_detach(plane, client);
		client_send(client, &packet, sizeof(packet));
	}
	while (*link != stream)
		link = &(*link)->next;
	*link = stream->next;
	free(stream);
}
