// SPDX-License-Identifier: Apache-2.0
/*
 * ZMTP 3 (RFC 23 of ZeroMQ), as far as bounds need it: where messages begin and end. With CURVE each frame is one
 * message here, since the flag that says otherwise is encrypted: the bound on untaken frames bounds those (guard.c).
 */
#include "guard_private.h"

#define GREETING 64
#define MORE 0x01
#define LONG 0x02
#define COMMAND 0x04
#define COMMANDS 4096 /* bytes of one, which the handshake's are far below */
#define PARTS 16      /* of a message; with more, each counts as a frame that is not small */
#define AT_ONCE 512   /* bytes that are read of short messages: what was read waits, held or not */
#define FREE (32 << 10) /* bytes of a message that needs no place */
#define SEALED \
	33 /* bytes that CURVE adds to a frame: a command's name, a number, a flag and the seal */

enum phase { IN_GREETING, AT_FLAGS, IN_LENGTH, IN_BODY };

void cm_guard_begin(struct cm_guard_stream *stream)
{
	stream->phase = IN_GREETING;
	stream->flags = stream->got = 0;
	stream->curve = false;
	stream->shakes = 0;
	stream->left = stream->bytes = stream->counts = stream->came = stream->small = 0;
	stream->parts = stream->credit = 0;
	stream->credit_s = 0;
	atomic_store(&stream->frames, 0);
}

bool cm_guard_is_long(const struct cm_guard_stream *stream)
{
	return stream->bytes > FREE;
}

/* The signature, and a version that has frames as they are followed here. */
static int greet(struct cm_guard_stream *stream, uint8_t byte)
{
	uint8_t at = stream->got++;

	if ((at == 0 && byte != 0xff) || (at == 9 && !(byte & 1)) || (at == 10 && byte < 3))
		return CM_GUARD_PROTOCOL;
	if (at == 12)
		stream->curve = byte == 'C';
	if (stream->got == GREETING) {
		stream->phase = AT_FLAGS;
		stream->shakes = stream->curve ? 2 : 1; /* HELLO and INITIATE, or READY */
	}
	return -1;
}

static bool has_credit(struct cm_guard_stream *stream, uint32_t most, int64_t now_s)
{
	int64_t passed = now_s - stream->credit_s;

	if (!stream->credit_s || passed >= 16)
		stream->credit = most;
	else if (passed > 0)
		stream->credit += (uint32_t)((uint64_t)passed * most / 16);
	if (stream->credit > most)
		stream->credit = most;
	stream->credit_s = now_s;
	return stream->credit && stream->credit--;
}

/* A command; before the handshake nothing else may come, as the peer is not known yet. */
static int command(struct cm_guard_stream *stream)
{
	if (!(stream->flags & COMMAND))
		return stream->shakes ? CM_GUARD_PROTOCOL : -1;
	if (stream->left > COMMANDS)
		return CM_GUARD_BYTES;
	if (stream->shakes)
		stream->shakes--;
	return -1;
}

/* Of what the manager is given: what it tells cm_guard_taken() of, by the same rules. */
static void count(struct cm_guard_stream *stream)
{
	uint64_t size = stream->left;

	stream->bytes += size;
	stream->parts++;
	if (stream->curve)
		size -= size < SEALED ? size : SEALED;
	if (size > CM_GUARD_SMALL)
		stream->counts += size;
	else if (stream->curve) /* it may be half of a ping, which is never taken */
		stream->small += size + sizeof(*stream);
}

/* A frame of stream->left bytes begins. */
static int begin(struct cm_guard_stream *stream, uint32_t kind,
		 const struct cm_guard_limits *limits, int64_t now_s)
{
	bool shakes_hands = stream->shakes;
	int cause = command(stream);

	stream->phase = IN_BODY;
	if (cause >= 0 || shakes_hands)
		return cause;
	if (kind == CM_GUARD_TOPICS && limits->topics && !has_credit(stream, limits->topics, now_s))
		return CM_GUARD_RATE;
	if (limits->bytes &&
	    (stream->left > limits->bytes || stream->bytes > limits->bytes - stream->left))
		return CM_GUARD_BYTES;
	stream->frames++;
	if (stream->flags & COMMAND)
		return -1;
	count(stream);
	return limits->parts && stream->parts > limits->parts ? CM_GUARD_PARTS : -1;
}

static void end(struct cm_guard_stream *stream)
{
	stream->phase = AT_FLAGS;
	if (stream->flags & (MORE | COMMAND))
		return;
	stream->came += stream->counts;
	if (stream->parts > PARTS)
		stream->came += (uint64_t)stream->parts * CM_GUARD_SMALL;
	stream->parts = 0;
	stream->bytes = stream->counts = 0;
}

static int length(struct cm_guard_stream *stream, uint8_t byte, uint32_t kind,
		  const struct cm_guard_limits *limits, int64_t now_s)
{
	int cause;

	stream->left = stream->left << 8 | byte;
	if (++stream->got < (stream->flags & LONG ? 8 : 1))
		return -1;
	cause = begin(stream, kind, limits, now_s);
	if (!stream->left)
		end(stream);
	return cause;
}

size_t cm_guard_room(const struct cm_guard_stream *stream)
{
	return stream->phase == IN_BODY && stream->left > AT_ONCE ? (size_t)stream->left : AT_ONCE;
}

int cm_guard_follow(struct cm_guard_stream *stream, uint32_t kind,
		    const struct cm_guard_limits *limits, const uint8_t *data, size_t size,
		    int64_t now_s)
{
	size_t at = 0;
	int cause = -1;

	while (at < size && cause < 0) {
		if (stream->phase == IN_BODY) {
			size_t some = stream->left < size - at ? (size_t)stream->left : size - at;

			at += some;
			stream->left -= some;
			if (!stream->left)
				end(stream);
		} else if (stream->phase == IN_GREETING) {
			cause = greet(stream, data[at++]);
		} else if (stream->phase == AT_FLAGS) {
			stream->flags = data[at++];
			stream->phase = IN_LENGTH;
			stream->left = 0;
			stream->got = 0;
		} else {
			cause = length(stream, data[at++], kind, limits, now_s);
		}
	}
	return cause;
}
