/* SPDX-License-Identifier: Apache-2.0 */
/* Shared by the parts of the guard. */
#ifndef CM_GUARD_PRIVATE_H
#define CM_GUARD_PRIVATE_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <sys/types.h>

#include "guard.h"

/* A position in what a ZMTP 3 peer sends; all zero: at its beginning. */
struct cm_guard_stream {
	uint8_t phase;
	uint8_t flags;
	uint8_t got;		 /* bytes of the greeting, or of a length */
	bool curve;		 /* what it sends is encrypted */
	uint8_t shakes;		 /* commands of the handshake that are to come */
	uint64_t left;		 /* bytes of the frame's body; a length while it is read */
	uint32_t parts;		 /* of this message */
	uint64_t bytes;		 /* of this message */
	uint32_t credit;	 /* subscriptions that it may send now */
	int64_t credit_s;	 /* when that was computed; 0: never */
	uint64_t counts;	 /* of its bytes, those that count once it is whole */
	uint64_t came;		 /* of all whole messages, the same */
	uint64_t small;		 /* bytes of small frames that are encrypted */
	_Atomic uint32_t frames; /* that began */
};

/* At the beginning of what a peer sends. */
void cm_guard_begin(struct cm_guard_stream *stream);

/* Whether a message that is too long to go without a place (guard_owe.c) is half read. */
bool cm_guard_is_long(const struct cm_guard_stream *stream);

/* How many bytes of a peer's requests to read at once. */
size_t cm_guard_room(const struct cm_guard_stream *stream);

/*
 * Follow what a peer sent. The enum cm_guard_cause of a bound that it broke, -1 if none. No bound holds where the
 * limit is 0.
 */
int cm_guard_follow(struct cm_guard_stream *stream, uint32_t kind,
		    const struct cm_guard_limits *limits, const uint8_t *data, size_t size,
		    int64_t now_s);

/* What the connections of a peer, or of a user, have sent that has not been taken. */
struct cm_guard_sum {
	uint64_t owes;
	uint32_t connections;
};

#define CM_GUARD_HELD_OWES 1u  /* as much as may wait does */
#define CM_GUARD_HELD_ASKED 2u /* cm_guard_hold() */

/* What is known about a descriptor. */
struct cm_guard_place {
	uint32_t listens;   /* enum cm_guard_kind of those that it takes */
	uint32_t in_a_row;  /* that it took, behind each of which another waited */
	int64_t crowded_ms; /* until when it counts that many waited */
	_Atomic uint32_t kind;
	struct cm_guard_peer peer;
	struct cm_guard_stream stream; /* of libzmq's thread for this connection */
	_Atomic uint32_t frames;       /* stream.frames when a message was last taken */
	_Atomic uint32_t held;	       /* why it is not read: CM_GUARD_HELD_...; 0: it is */
	struct cm_guard_sum *mine;     /* of its peer */
	struct cm_guard_sum *user;     /* of its user; of its peer where that is elsewhere */
	uint64_t came, small;	       /* of the stream, as of now */
	uint64_t taken;		       /* of what came */
	uint64_t owes;		       /* bytes that were not taken, with those of its place */
	uint64_t since;		       /* when it was held back: a number that rises */
	bool curve;		       /* of the stream */
	uint32_t looks;		       /* of cm_guard_look_on(), while it keeps its place */
	uint32_t stalls;	       /* of these, in which next to nothing came */
	_Atomic uint64_t read;	       /* bytes since the last of these */
	bool has_place;		       /* for a long message, which is under way */
	bool wants_place;
	uint64_t
		stuck; /* when it began to have more to write than its peer takes; a rising number, 0: it does not */
	bool ended; /* by cm_guard_cut_slowest() */
	int epoll;  /* where libzmq waits for it; -1: nowhere that we know of */
	struct epoll_event event;
	int32_t next; /* of those in use; -1: none */
	int32_t before;
};

extern pthread_mutex_t cm_guard_lock; /* of all that follows, but what is atomic */
extern struct cm_guard_limits cm_guard_limits;
extern int cm_guard_spare; /* a descriptor that makes room for one that is refused; -1: none */
extern _Thread_local uint32_t cm_guard_expected;

/* The limits as they are now. */
struct cm_guard_limits cm_guard_bounds(void);

/* NULL for a descriptor that is too high to be known. */
struct cm_guard_place *cm_guard_place(int fd);

/* The peer of a connection that was taken; @from: as accept() has it, since one that has gone has no name any more. */
struct cm_guard_peer cm_guard_look(int fd, uint32_t kind, const struct sockaddr_storage *from);

/* Whether two connections are of one process, or from one address. */
bool cm_guard_same(const struct cm_guard_peer *a, const struct cm_guard_peer *b);

/* A connection was taken, where others wait if it is @crowded: whether it stays. */
bool cm_guard_admit(const struct cm_guard_peer *peer, int64_t now_ms, bool crowded);

/* Count it; with the lock held, like the next function. */
void cm_guard_refuse(const struct cm_guard_peer *peer, int cause);
void cm_guard_leave(struct cm_guard_place *place);

/* The connections that there are, one behind the other by cm_guard_place.next; -1: none. */
int cm_guard_first(void);

/* Do not read it, for one more reason, or one less; with the lock held. Whether that was one. */
bool cm_guard_stop(struct cm_guard_place *place, uint32_t why);
bool cm_guard_go_on(struct cm_guard_place *place, uint32_t why);

/* What was not taken; with the lock held. The sums of a new connection: false if there is no memory. */
bool cm_guard_owe(struct cm_guard_place *place);
void cm_guard_quit(struct cm_guard_place *place);
void cm_guard_settle(struct cm_guard_place *place, const struct cm_guard_limits *limits);

/*
 * A peer sent so many subscriptions, or ends of them, over one of its connections; with the lock held. Whether it
 * might, where one connection may send @each at once and a sixteenth of it in a second, and all of them four times that.
 */
bool cm_guard_pay(const struct cm_guard_peer *peer, uint32_t topics, uint32_t each, int64_t now_s);

/* A peer has connected once more; with the lock held. Whether it has no more than @each times within a second. */
bool cm_guard_connects(const struct cm_guard_peer *peer, uint32_t each, int64_t now_ms);

/* The replacements for the C library's functions in libzmq. */
int cm_guard_accept4(int listener, struct sockaddr *address, socklen_t *length, int flags);
int cm_guard_accept(int listener, struct sockaddr *address, socklen_t *length);
int cm_guard_listen(int fd, int backlog);
int cm_guard_close(int fd);
ssize_t cm_guard_recv(int fd, void *data, size_t size, int flags);
int cm_guard_epoll_ctl(int epoll, int op, int fd, struct epoll_event *event);
ssize_t cm_guard_recv_chk(int fd, void *data, size_t size, size_t room, int flags);

#endif
