// SPDX-License-Identifier: GPL-2.0-only
/* A configuration port at the end of an MM2S channel. */
#include <linux/io.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <asm/byteorder.h>

#include "cm_icap.h"
#include "cm_icap_port.h"
#include "plsim.h"

static u32 status_word(const struct plsim_chan *chan)
{
	u32 word = CM_ICAP_SR_EOS | READ_ONCE(chan->load_errors) << CM_ICAP_SR_ERRORS_SHIFT;

	/* a port that waits for the rest of a packet is not done */
	if (!(chan->load_errors & CM_ICAP_ERR_TIMEOUT))
		word |= CM_ICAP_SR_DONE;
	return word;
}

/**
 * plsim_icap_take() - one load
 * @chan: channel of kind PLSIM_ICAP
 * @data: words in memory order, aligned to 4 bytes
 * @length: bytes
 */
void plsim_icap_take(struct plsim_chan *chan, const u8 *data, size_t length)
{
	const __le32 *words = (const __le32 *)data;
	size_t i;

	cm_configport_begin(&chan->port);
	for (i = 0; i < length / sizeof(*words); i++)
		cm_configport_word(&chan->port, le32_to_cpu(words[i]));
	WRITE_ONCE(chan->load_errors,
		   cm_configport_end(&chan->port) | xchg(&chan->inject_errors, 0));
	chan->load_words = chan->port.words;
	chan->loads++;
	if (chan->dma->status)
		writel(status_word(chan), chan->dma->status);
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
