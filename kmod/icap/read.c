// SPDX-License-Identifier: GPL-2.0-only
/*
 * One read: words to the port, words from it, and words to it that close it.
 *
 * The port's side knows from the first words how many come back, and ends them
 * with TLAST; where it gets more words before, it drops what was not taken (see
 * cm_icap_read.v).  So the closing words are sent however the reply ended, when
 * nothing waits for it any more.
 */
#include "icap.h"

static bool overlap(const struct cm_icap_part *one, const struct cm_icap_part *other)
{
	return one->offset < other->offset + other->length &&
	       other->offset < one->offset + one->length;
}

/* each part is one packet of a stream, and so one descriptor */
static bool too_long(const struct cm_channel *channel, const struct cm_icap_part *part)
{
	return part->length > round_down(channel->info.max_length, 4);
}

/**
 * cm_icap_read_check() - what a read needs beyond what a load does
 * @icap: port
 * @request: of which @words have been checked
 *
 * Return: 0, -EINVAL for parts that are not in the buffer or overlap, or
 * -EMSGSIZE.
 */
int cm_icap_read_check(struct cm_icap *icap, const struct cm_icap_request *request)
{
	int ret = cm_icap_part_check(icap, request, &request->reply);

	if (!ret)
		ret = cm_icap_part_check(icap, request, &request->closing);
	if (ret)
		return ret;
	if (overlap(&request->words, &request->reply) ||
	    overlap(&request->words, &request->closing) ||
	    overlap(&request->reply, &request->closing))
		return -EINVAL;
	if (too_long(icap->channel, &request->words) || too_long(icap->back, &request->reply) ||
	    too_long(icap->channel, &request->closing))
		return -EMSGSIZE;
	return 0;
}

/* softirq context, or that of a cancel */
static void received(void *context, const struct cm_result *result)
{
	struct cm_icap *icap = context;

	icap->reply = *result;
	complete(&icap->received);
}

/**
 * cm_icap_read_begin() - ask, after somebody waits for the answer
 * @icap: port, with the request under way
 *
 * Return: 0 and cm_icap_read_end() is to be called, or a negative errno, and
 * nothing waits any more.
 */
int cm_icap_read_begin(struct cm_icap *icap)
{
	struct cm_request reply = {
		.buffer = icap->request.buffer,
		.offset = icap->request.reply.offset,
		.length = icap->request.reply.length,
		.done = received,
		.context = icap,
	};
	int ret;

	reinit_completion(&icap->received);
	icap->reply = (struct cm_result){};
	ret = cm_channel_submit(icap->back, &reply);
	if (ret)
		return ret;
	ret = cm_icap_send(icap, &icap->request.words);
	if (ret)
		cm_channel_cancel(icap->back);
	return ret;
}

static u32 await_received(struct cm_icap *icap)
{
	if (!wait_for_completion_timeout(&icap->received, msecs_to_jiffies(icap->timeout_ms)))
		cm_channel_cancel(icap->back);
	/* a cancel has told the end, if it had not been told */
	if (icap->reply.status)
		return icap->reply.status == -ECANCELED ? CM_ICAP_ERR_TIMEOUT : CM_ICAP_ERR_DMA;
	return icap->reply.length < icap->request.reply.length ? CM_ICAP_ERR_TIMEOUT : 0;
}

static u32 close_port(struct cm_icap *icap)
{
	u32 errors;

	if (cm_icap_send(icap, &icap->request.closing)) {
		cm_channel_cancel(icap->channel);
		return CM_ICAP_ERR_DMA;
	}
	errors = cm_icap_await_sent(icap);
	return errors ?: cm_icap_port_errors(icap);
}

/**
 * cm_icap_read_end() - wait for the answer, and leave the port as a load expects it
 * @icap: port, with the request under way
 *
 * Return: CM_ICAP_ERR_* bits; what came is in @icap's reply.
 */
u32 cm_icap_read_end(struct cm_icap *icap)
{
	u32 errors = cm_icap_await_sent(icap);

	/* who was not asked does not answer */
	if (errors)
		cm_channel_cancel(icap->back);
	errors |= await_received(icap);
	return errors | close_port(icap);
}
