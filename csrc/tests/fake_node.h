/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A simulated node served by a thread of the test, well behaved or not.
 *
 * It serves one connection after the other until it is stopped.  As a DMA
 * channel and as a configuration port it completes every transfer at once with
 * half of the bytes asked for; as a UIO device it has words of memory, and a write
 * of 1 to its event socket is answered by an interrupt.
 */
#ifndef CM_FAKE_NODE_H
#define CM_FAKE_NODE_H

#include <stdatomic.h>
#include <stdint.h>

enum misdeed {
	WELL_BEHAVED,
	/* at open */
	REFUSE_OPEN, /* EBUSY */
	HANG_UP_AT_OPEN,
	GREET_WITHOUT_FD,
	GREET_WITH_WRONG_OP,
	GREET_WITH_TWO_FDS,
	/* in the reply to each request */
	REFUSE, /* EIO */
	HANG_UP,
	SHORT_HEADER,
	WRONG_OP,
	WRONG_LENGTH,
	NEGATIVE_ERROR,
	SHORT_PAYLOAD,
	LONG_PAYLOAD,
	UNASKED_FD,
	NO_FD,
	/* in events */
	SHORT_EVENT,
	LONG_EVENT,
	HANG_UP_EVENTS,
	MANY_INTERRUPTS,
	/* not a misdeed: takes CM_NODE_OP_BLOCK_READ and _WRITE */
	OFFER_BLOCKS,
	OFFER_BLOCKS_AND_REFUSE, /* EIO */
	OFFER_BLOCKS_AND_CUT_SHORT,
	OFFER_BLOCKS_AND_ANSWER_LATE, /* as ANSWER_LATE */
	/* the first request is answered when fake_node_speak() says so */
	ANSWER_LATE,
	/* each cancel of a channel */
	ANSWER_CANCEL_LATE,
	/* not a misdeed: the last transfer of a channel ends well just before it would have been cancelled */
	END_AT_CANCEL,
};

#define FAKE_NODE_WORDS (40 * 1024) /* more than fit into two messages */

struct fake_node;

/* Serve @path under @root, whose folders are made. */
struct fake_node *fake_node_start(const char *root, const char *path, enum misdeed misdeed);
void fake_node_stop(struct fake_node *fake);

/* Let one that answers late do so. */
void fake_node_speak(struct fake_node *fake);

/* Requests answered so far. */
unsigned int fake_node_requests(struct fake_node *fake);

/* A fresh folder of any length of name, and its removal with all that is in it. */
char *fake_root_make(void);
char *fake_root_make_long(void);
void fake_root_remove(char *root);

/* Write a plain file under @root, making its folders. */
void fake_file(const char *root, const char *path, const char *text);

#endif /* CM_FAKE_NODE_H */
