/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Packets of a simulated node: headers of cm_node.h, payload, one descriptor.
 * Stateless; the caller serialises.
 */
#ifndef CM_SHIM_MESSAGE_H
#define CM_SHIM_MESSAGE_H

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

/**
 * cm_message_send() - send one request on @sock
 * @fd: descriptor to pass along, or -1
 *
 * Errors: ENODEV if the other end is gone, EMSGSIZE for a payload above
 * CM_NODE_PAYLOAD_MAX.
 */
int cm_message_send(int sock, uint32_t op, const void *payload, size_t length, int fd);

/**
 * cm_message_receive() - receive the reply to @op on @sock, blocks
 * @payload: room for @size bytes
 * @fd: where a passed descriptor is stored (-1 if none came), or NULL to refuse one
 *
 * Returns the payload's length.  Errors: the reply's own; ENODEV if the other
 * end is gone; EPROTO for a malformed reply; ETIMEDOUT if none came within the
 * connection's time.  @broken is set where the two ends no longer agree, that is
 * for the latter three.
 */
ssize_t cm_message_receive(int sock, uint32_t op, void *payload, size_t size, int *fd, int *broken);

/**
 * cm_message_drop_late() - take the reply to a request that was given up, and forget it
 *
 * Never blocks.  ETIMEDOUT while there is none; ENODEV if the other end is gone.
 */
int cm_message_drop_late(int sock);

/**
 * cm_message_greeting() - receive what a server says first
 * @event_fd: set to the event socket, or -1 if none came
 * @offers: set to the CM_NODE_OFFERS_* bits
 *
 * Errors: that of the open; those of cm_message_receive().
 */
int cm_message_greeting(int sock, int *event_fd, uint32_t *offers);

#endif /* CM_SHIM_MESSAGE_H */
