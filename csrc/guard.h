/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What libzmq lacks: bounds on connections, and on what they send before it is looked at.
 *
 * libzmq takes every connection there is, and ends its process where there is no descriptor for one more
 * (`errno_assert` in ipc_listener.cpp, up to 4.3.5). So its calls of accept(), accept4(), listen(), recv() and
 * close() are led through here, by the table of functions that its ELF object has for those of others
 * (guard_hook.c). A connection too many is taken and closed; one that breaks a bound while it sends ends.
 *
 * Only listeners are guarded that a thread made after cm_guard_expect(). State is that of the process, as
 * descriptors are. Any thread.
 */
#ifndef CM_SHIM_GUARD_H
#define CM_SHIM_GUARD_H

#include <stdint.h>

#define CM_GUARD_SMALL 255 /* bytes of a frame, such as a routing id, that does not count */

enum cm_guard_kind {
	CM_GUARD_NONE,	   /* not ours */
	CM_GUARD_REQUESTS, /* peers send messages of several parts */
	CM_GUARD_TOPICS,   /* peers send subscriptions */
};

/* Why a connection was refused or ended; the index of cm_guard_counts.refused. */
enum cm_guard_cause {
	CM_GUARD_FULL,	      /* as many connections as there may be */
	CM_GUARD_EACH,	      /* as many of this peer as it may have */
	CM_GUARD_DESCRIPTORS, /* the remaining descriptors are reserved for the manager */
	CM_GUARD_PROTOCOL,    /* not ZMTP 3 */
	CM_GUARD_PARTS,	      /* a message of too many parts */
	CM_GUARD_BYTES,	      /* a message that is too long, or endless */
	CM_GUARD_RATE,	      /* subscribes too often */
	CM_GUARD_CUT,	      /* by cm_guard_cut() */
	CM_GUARD_SLOW,	      /* kept others with long messages waiting */
	CM_GUARD_UNREAD,      /* by cm_guard_cut_slowest() */
	CM_GUARD_OFTEN,	      /* connects too often, while many wait */
	CM_GUARD_CAUSES,
};

struct cm_guard_limits {
	uint32_t connections; /* in all; three quarters of them for the processes of one user */
	uint32_t
		each; /* of one peer: a process of this machine, or an address; and new ones a second */
	uint32_t newcomers;   /* of all, for peers with few */
	uint32_t descriptors; /* of the process, that no connection may take */
	uint32_t parts;	      /* of a message */
	uint64_t
		bytes; /* of a message; also the unit for how many may be untaken, see guard_owe.c */
	uint32_t
		topics; /* subscriptions and their ends at once, four times as many of a peer over all its connections; a sixteenth comes back every second */
};

/* A connection, and the peer at its other end. */
struct cm_guard_peer {
	uint64_t serial; /* no other connection has it */
	int32_t fd;
	uint32_t kind;
	int32_t pid; /* on this machine; 0: see address */
	uint32_t uid;
	uint32_t gid;
	uint8_t address[16]; /* IPv6, or IPv4 mapped into it */
};

struct cm_guard_counts {
	uint32_t connections;
	uint64_t refused[CM_GUARD_CAUSES];
	struct cm_guard_peer last; /* the peer that was last refused */
	uint32_t last_cause;
};

/*
 * Lead libzmq's calls through here; twice is fine. How many functions are: 0 where libzmq calls them in a way that
 * cannot be changed, then nothing is guarded.
 */
int cm_guard_install(void);

/* Set the limits from now on; all zero: none. */
void cm_guard_limit(const struct cm_guard_limits *limits);

/* Listeners that this thread makes from now on are of a kind of enum cm_guard_kind. */
void cm_guard_expect(uint32_t kind);

/* The connections there are, @max at most; how many were written. */
int cm_guard_peers(struct cm_guard_peer *peers, int max);

/* The peer of a descriptor; ENOENT. */
int cm_guard_peer(int fd, struct cm_guard_peer *peer);

/* The serial of the connection that a descriptor is; 0: it is none. */
uint64_t cm_guard_serial(int fd);

/* End a connection: libzmq sees that its peer has gone. ENOENT. */
int cm_guard_cut(int fd);

/*
 * A message of this connection was taken, which has @bytes in frames of more than CM_GUARD_SMALL; with more than 16
 * parts, CM_GUARD_SMALL more for each.
 */
void cm_guard_taken(int fd, uint64_t bytes);

/* Stop or resume reading a connection. ENOENT. */
int cm_guard_hold(int fd, int hold);

/* End the connection of this kind that has been unable to write for longest. -1: none is. */
int cm_guard_cut_slowest(uint32_t kind);

/*
 * Once a second: end connections that keep others from sending long messages by sending theirs for longer than ten
 * of these looks.
 */
void cm_guard_look_on(void);

void cm_guard_count(struct cm_guard_counts *counts);

#endif
