// SPDX-License-Identifier: Apache-2.0
/* Clients of the data plane: what they send, hold and receive. */
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "plane_private.h"

struct client *client_find(struct cm_plane *plane, int id)
{
	struct client *client = plane->clients;

	while (client && client->id != id)
		client = client->next;
	if (!client)
		errno = ENOENT;
	return client;
}

/* Disconnect a client that cannot receive an essential packet; later, because lists are being walked. */
void client_break_off(struct client *client, int error)
{
	if (!client->broken)
		client->error = error;
	client->broken = true;
}

static int try_send(const struct client *client, const void *packet, size_t size)
{
	return send(client->fd, packet, size, MSG_DONTWAIT | MSG_NOSIGNAL) < 0 ? -1 : 0;
}

int client_send(struct client *client, const void *packet, size_t size)
{
	if (!try_send(client, packet, size))
		return 0;
	client_break_off(client, errno);
	return -1;
}

/* A number of the frames that follow, in a packet of its own if it has changed: a descriptor has no room for it. */
static int tell(struct client *client, const struct stream *stream, uint8_t kind, uint64_t *told,
		uint64_t number)
{
	struct cm_plane_descriptor packet = {
		.kind = kind,
		.flags = stream->epoch,
		.sequence = number,
	};

	if (*told == number)
		return 0;
	if (try_send(client, &packet, sizeof(packet)))
		return -1;
	*told = number;
	return 0;
}

/* Lend a frame to a reader; -1 if it has as many as it may, or does not read. */
int client_offer(struct client *client, const struct stream *stream, uint32_t number)
{
	if (!stream->setup.backpressure && client->held_count >= client->depth)
		return -1;
	if (tell(client, stream, CM_PLANE_GENERATION, &client->generation,
		 stream->slot[number].generation) ||
	    tell(client, stream, CM_PLANE_FAILED, &client->failed, stream->stats.errors))
		return -1;
	if (try_send(client, &stream->slot[number].frame, sizeof(struct cm_plane_descriptor)))
		return -1;
	client->held[number] = true;
	client->held_count++;
	client->frames++;
	return 0;
}

void client_grant(struct client *client, const struct stream *stream, const struct slot *slot)
{
	struct cm_plane_descriptor packet = {
		.slot = (uint16_t)(slot - stream->slot),
		.kind = CM_PLANE_GRANT,
		.flags = stream->epoch,
		.length = stream->setup.length,
	};

	client_send(client, &packet, sizeof(packet));
}

static int send_fds(const struct client *client, const struct cm_plane_descriptor *packet,
		    const int *fds, size_t count)
{
	union {
		char bytes[CMSG_SPACE(CM_PLANE_FDS_MAX * sizeof(int))];
		struct cmsghdr align;
	} control = { 0 };
	struct iovec part = { .iov_base = (void *)packet, .iov_len = sizeof(*packet) };
	struct msghdr message = {
		.msg_iov = &part,
		.msg_iovlen = 1,
		.msg_control = control.bytes,
		.msg_controllen = CMSG_SPACE(count * sizeof(int)),
	};
	struct cmsghdr *header = CMSG_FIRSTHDR(&message);

	header->cmsg_level = SOL_SOCKET;
	header->cmsg_type = SCM_RIGHTS;
	header->cmsg_len = CMSG_LEN(count * sizeof(int));
	memcpy(CMSG_DATA(header), fds, count * sizeof(int));
	return sendmsg(client->fd, &message, MSG_DONTWAIT | MSG_NOSIGNAL) < 0 ? -1 : 0;
}

/* The memory of all slots from @first on. */
int client_send_slots(struct client *client, const struct stream *stream, uint32_t first)
{
	while (first < stream->slots && !stream->setup.lent) {
		uint32_t left = stream->slots - first;
		uint32_t count = left < CM_PLANE_FDS_MAX ? left : CM_PLANE_FDS_MAX;
		int fds[CM_PLANE_FDS_MAX];
		struct cm_plane_descriptor packet = {
			.slot = (uint16_t)first,
			.kind = CM_PLANE_SLOTS,
			.flags = stream->epoch,
			.offset = count,
			.length = stream->setup.length,
		};

		for (uint32_t i = 0; i < count; i++)
			fds[i] = stream->slot[first + i].fd;
		if (send_fds(client, &packet, fds, count)) {
			client_break_off(client, errno);
			return -1;
		}
		first += count;
	}
	return 0;
}

static void give_back(struct cm_plane *plane, struct client *client, uint32_t number)
{
	struct slot *slot = &client->stream->slot[number];

	client->held[number] = false;
	client->held_count--;
	slot->holders--;
	if (!slot->holders)
		stream_queue(plane, client->stream, number);
}

/* Remove the client from its stream; what it held goes back. */
void client_detach(struct cm_plane *plane, struct client *client)
{
	struct stream *stream = client->stream;

	if (!stream)
		return;
	for (uint32_t i = 0; i < stream->slots; i++) {
		if (client->held[i] && stream->ending)
			client->held[i] = false;
		else if (client->held[i])
			give_back(plane, client, i);
		if (stream->slot[i].owner == client)
			stream->slot[i].owner = NULL;
	}
	client->held_count = 0;
	client->stream = NULL;
}

static void release(struct cm_plane *plane, struct client *client,
		    struct cm_plane_descriptor *packet)
{
	struct stream *stream = client->stream;
	const struct cm_plane_descriptor *frame;

	if (!stream || packet->flags != stream->epoch)
		return; /* from before the stream stopped: that memory is not used again */
	frame = &stream->slot[packet->slot % CM_PLANE_SLOTS_MAX].frame;
	if (packet->slot < stream->slots && client->held[packet->slot] &&
	    frame->sequence == packet->sequence && frame->timestamp_ns == packet->timestamp_ns) {
		give_back(plane, client, packet->slot);
		return;
	}
	stream->stats.late++;
	packet->kind = CM_PLANE_LATE;
	client_send(client, packet, sizeof(*packet));
}

static bool is_free(const struct client *client, uint32_t number)
{
	const struct stream *stream = client->stream;

	return number < stream->slots && stream->slot[number].owner == client &&
	       !stream->slot[number].queued;
}

/* 0, or the errno of a SUBMIT of a slot's bytes. */
static uint32_t in_slot(const struct client *client, const struct cm_plane_descriptor *packet)
{
	uint64_t room = client->stream->setup.length;

	return packet->length > 0 && packet->offset <= room &&
			       packet->length <= room - packet->offset
		       ? 0
		       : EINVAL;
}

/* Memory of the client's user that has all the bytes at an address, or NULL. */
static const struct stream *memory_at(const struct cm_plane *plane, const struct client *client,
				      uint64_t address, uint64_t length)
{
	for (const struct client *other = plane->clients; other; other = other->next) {
		const struct cm_plane_setup *setup = other->stream ? &other->stream->setup : NULL;

		if (setup && setup->address && other->user == client->user && !other->broken &&
		    address >= setup->address && address - setup->address < setup->length &&
		    length <= setup->length - (address - setup->address))
			return other->stream;
	}
	return NULL;
}

/* The same of bytes of the client's own, whose place is found. */
static uint32_t in_memory(const struct cm_plane *plane, const struct client *client,
			  struct cm_plane_descriptor *packet)
{
	struct stream *stream = client->stream;
	const struct stream *memory =
		memory_at(plane, client, packet->timestamp_ns, packet->length);

	if (!memory || !packet->length)
		return EFAULT;
	if (packet->length > stream->setup.length ||
	    packet->timestamp_ns - memory->setup.address > UINT32_MAX)
		return EMSGSIZE;
	packet->offset = (uint32_t)(packet->timestamp_ns - memory->setup.address);
	return stream_import(stream, memory, &stream->slot[packet->slot].handle) ? (uint32_t)errno
										 : 0;
}

static uint32_t check(const struct cm_plane *plane, const struct client *client,
		      struct cm_plane_descriptor *packet)
{
	const struct stream *stream = client->stream;

	if (!stream || packet->flags != stream->epoch)
		return ECANCELED;
	if (!is_free(client, packet->slot))
		return EINVAL;
	return stream->setup.lent ? in_memory(plane, client, packet) : in_slot(client, packet);
}

static void submit(struct cm_plane *plane, struct client *client,
		   struct cm_plane_descriptor *packet)
{
	uint32_t error = check(plane, client, packet);

	if (error) {
		packet->kind = CM_PLANE_DONE;
		packet->offset = error;
		packet->length = 0;
		client_send(client, packet, sizeof(*packet));
		return;
	}
	client->stream->slot[packet->slot].frame = *packet;
	stream_queue(plane, client->stream, packet->slot);
}

static void take(struct cm_plane *plane, struct client *client, struct cm_plane_descriptor *packet)
{
	switch (packet->kind) {
	case CM_PLANE_RELEASE:
		release(plane, client, packet);
		break;
	case CM_PLANE_SUBMIT:
		submit(plane, client, packet);
		break;
	case CM_PLANE_LEAVE:
		if (client->leaving)
			break; /* once: each report is work for the caller */
		client->leaving = true;
		plane_report(plane, CM_PLANE_CLIENT_LEAVES, client->id, 0);
		break;
	case CM_PLANE_PING:
		packet->kind = CM_PLANE_PONG;
		client_send(client, packet, sizeof(*packet));
		break;
	default:
		client_break_off(client, EPROTO);
	}
}

bool client_readable(struct cm_plane *plane, struct client *client)
{
	struct cm_plane_descriptor packet;
	ssize_t got = recv(client->fd, &packet, sizeof(packet), MSG_DONTWAIT | MSG_TRUNC);

	if (got == (ssize_t)sizeof(packet))
		take(plane, client, &packet);
	else if (got == 0)
		client_break_off(client, 0);
	else if (got > 0)
		client_break_off(client, EPROTO);
	else if (errno != EAGAIN && errno != EINTR)
		client_break_off(client, errno);
	else
		return false;
	return !client->broken;
}

static void drop(struct cm_plane *plane, struct client *client)
{
	client_detach(plane, client);
	epoll_ctl(plane->epoll_fd, EPOLL_CTL_DEL, client->fd, NULL); /* there may be a duplicate */
	close(client->fd);
	plane_report(plane, CM_PLANE_CLIENT_GONE, client->id, client->error);
	free(client);
}

void clients_reap(struct cm_plane *plane)
{
	struct client **link = &plane->clients;

	while (*link) {
		struct client *client = *link;

		if (client->broken) {
			*link = client->next;
			drop(plane, client);
			link = &plane->clients; /* what it gave back may have led to other broken clients */
		} else {
			link = &client->next;
		}
	}
}
