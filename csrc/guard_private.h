/* SPDX-License-Identifier: Apache-2.0 */
/* What the parts of the guard share. */
#ifndef CM_GUARD_PRIVATE_H
#define CM_GUARD_PRIVATE_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/socket.h>
#include <sys/types.h>

#include "guard.h"

/* Where in what a ZMTP 3 peer sends; all zero: at its beginning. */
struct cm_guard_stream {
	uint8_t phase;
	uint8_t flags;
	uint8_t got;		 /* bytes of the greeting, or of a length */
	bool curve;		 /* what it sends is encrypted */
	uint64_t left;		 /* bytes of the frame's body; a length while it is read */
	uint32_t parts;		 /* of this message */
	uint64_t bytes;		 /* of this message */
	uint32_t credit;	 /* subscriptions that it may send now */
	int64_t credit_s;	 /* when that was reckoned; 0: never */
	uint64_t large;		 /* bytes of large frames that began */
	_Atomic uint32_t frames; /* that began */
};

/* At the beginning of what a peer sends. */
void cm_guard_begin(struct cm_guard_stream *stream);

/* Whether no frame is half read. */
bool cm_guard_between(const struct cm_guard_stream *stream);

/*
 * Follow what a peer sent. The enum cm_guard_cause of a bound that it broke, -1 if none. No bound holds where the
 * limit is 0.
 */
int cm_guard_follow(struct cm_guard_stream *stream, uint32_t kind,
		    const struct cm_guard_limits *limits, const uint8_t *data, size_t size,
		    int64_t now_s);

/* What is known of a descriptor. */
struct cm_guard_place {
	uint32_t listens; /* enum cm_guard_kind of those that it takes */
	_Atomic uint32_t kind;
	struct cm_guard_peer peer;
	struct cm_guard_stream stream; /* of libzmq's thread for this connection */
	int64_t held_s;		       /* since when it is not read; 0: it is */
	_Atomic uint64_t large;	       /* bytes of large frames that were taken, of stream.large */
	_Atomic uint32_t frames;       /* stream.frames when a message was last taken */
	int32_t next;		       /* of those in use; -1: none */
	int32_t before;
};

extern pthread_mutex_t cm_guard_lock; /* of all that follows, but what is atomic */
extern int cm_guard_spare; /* a descriptor that makes room for one that is refused; -1: none */
extern _Thread_local uint32_t cm_guard_expected;

/* The limits as they are now. */
struct cm_guard_limits cm_guard_bounds(void);

/* NULL for a descriptor that is too high to be known. */
struct cm_guard_place *cm_guard_place(int fd);

struct cm_guard_peer cm_guard_look(int fd, uint32_t kind);

/* A connection that was taken: whether it stays. */
bool cm_guard_admit(int fd, uint32_t kind);

/* Count it; with the lock held, as the next. */
void cm_guard_refuse(const struct cm_guard_peer *peer, int cause);
void cm_guard_leave(struct cm_guard_place *place);

/* What stands in place of the C library's functions in libzmq. */
int cm_guard_accept4(int listener, struct sockaddr *address, socklen_t *length, int flags);
int cm_guard_accept(int listener, struct sockaddr *address, socklen_t *length);
int cm_guard_listen(int fd, int backlog);
int cm_guard_close(int fd);
ssize_t cm_guard_recv(int fd, void *data, size_t size, int flags);
ssize_t cm_guard_recv_chk(int fd, void *data, size_t size, size_t room, int flags);

#endif
