// SPDX-License-Identifier: GPL-2.0-only
/* A configuration port at the end of an MM2S channel. */
#include <linux/io.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/sizes.h>
#include <asm/byteorder.h>

#include "cm_icap.h"
#include "cm_icap_port.h"
#include "plsim.h"

/* words; the longest that a DMA engine moves in one go */
#define ANSWER_MAX (SZ_64M / 4)

static u32 status_word(const struct plsim_chan *chan)
{
	u32 word = CM_ICAP_SR_EOS | READ_ONCE(chan->load_errors) << CM_ICAP_SR_ERRORS_SHIFT;

	/* a port that waits for the rest of a packet is not done */
	if (!(chan->load_errors & CM_ICAP_ERR_TIMEOUT))
		word |= CM_ICAP_SR_DONE;
	return word;
}

/* what was asked for, as one packet; a port without a way back keeps it */
static void answer(struct plsim_chan *chan)
{
	struct plsim_packet *packet;
	__le32 *words;
	u32 i;

	if (!chan->peer || !chan->port.synced || chan->port.asked > ANSWER_MAX)
		return;
	packet = plsim_packet_new(chan->port.asked * sizeof(*words));
	if (!packet)
		return;
	words = (__le32 *)packet->data;
	for (i = 0; i < chan->port.asked; i++)
		words[i] = cpu_to_le32(cm_configport_answer(&chan->port));
	chan->reads++;
	plsim_give(chan->peer, packet);
}

/**
 * plsim_icap_take() - one load, or one part of a read
 * @chan: channel of kind PLSIM_ICAP
 * @data: words in memory order, aligned to 4 bytes
 * @length: bytes
 */
void plsim_icap_take(struct plsim_chan *chan, const u8 *data, size_t length)
{
	const __le32 *words = (const __le32 *)data;
	bool closes = chan->port.asked;
	size_t i;

	/* as cm_icap_read.v does it: who sends words waits for no answer, so nobody has it */
	if (chan->peer)
		plsim_drop_packets(chan->peer);
	cm_configport_begin(&chan->port);
	for (i = 0; i < length / sizeof(*words); i++)
		cm_configport_word(&chan->port, le32_to_cpu(words[i]));
	WRITE_ONCE(chan->load_errors,
		   cm_configport_end(&chan->port) | xchg(&chan->inject_errors, 0));
	chan->load_words = chan->port.words;
	if (!closes && !chan->port.asked)
		chan->loads++;
	if (chan->dma->status)
		writel(status_word(chan), chan->dma->status);
	if (chan->port.asked)
		answer(chan);
}

/* the engine may have been unbound and bound again; without it there is no loader */
static u32 read_status(void *context)
{
	struct plsim_port *port = context;
	struct plsim_dma *dma = platform_get_drvdata(port->engine);

	return status_word(&dma->channels[port->number]);
}

/**
 * plsim_icap_platform_data() - the port's status for the loader's driver
 * @port: engine, and channel of kind PLSIM_ICAP; outlives the loader
 * @data: filled in
 */
void plsim_icap_platform_data(struct plsim_port *port, struct cm_icap_platform_data *data)
{
	data->status = read_status;
	data->context = port;
	data->full = true;
}
