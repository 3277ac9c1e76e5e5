// SPDX-License-Identifier: Apache-2.0
/* One simulated DMA channel: plain submits in, completions out. */
#include <errno.h>
#include <linux/sockios.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include "clock.h"
#include "cm_node.h"
#include "sim_private.h"

#define MAX_LENGTH ((UINT64_C(1) << 26) - 1) /* cm/sim/hardware/dma.py */

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

uint8_t *sim_memory(const struct cm_sim_channel *channel)
{
	const struct cm_sim_transfer *head = sim_head(channel);

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

bool sim_serve(struct cm_sim_channel *channel)
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

void sim_complete(struct cm_sim_channel *channel, uint64_t length, int32_t status)
{
	struct cm_dma_completion done = {
		.cookie = sim_head(channel)->cookie,
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
