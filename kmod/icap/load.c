// SPDX-License-Identifier: GPL-2.0-only
/*
 * One load: have the port, send the words, wait for the port's own end.
 *
 * That the DMA is done only means that the data left memory.  All of a load is
 * one piece of work, since the mutex of the platform's FPGA manager, which is
 * held meanwhile, belongs to who took it.
 */
#include <linux/delay.h>
#include <linux/io.h>
#include <linux/iopoll.h>
#include <linux/ktime.h>
#include <linux/workqueue.h>

#include "cm_compat.h"
#include "icap.h"

/* a stream FIFO of 1024 words at 50 MHz */
#define DRAIN_US 25
#define POLL_US 20
#define PORT_TIMEOUT_US 100000

/**
 * cm_icap_has_status() - whether the port can be asked
 * @icap: port
 *
 * Return: true if there is a status register.
 */
bool cm_icap_has_status(const struct cm_icap *icap)
{
	return icap->status_register || icap->port.status;
}

static u32 read_status(struct cm_icap *icap)
{
	if (icap->port.status)
		return icap->port.status(icap->port.context);
	return readl(icap->status_register);
}

/**
 * cm_icap_port_errors() - wait for the port's own end
 * @icap: port
 *
 * Return: CM_ICAP_ERR_* bits.
 */
u32 cm_icap_port_errors(struct cm_icap *icap)
{
	u32 word;
	int ret;

	if (!cm_icap_has_status(icap)) {
		usleep_range(DRAIN_US, 2 * DRAIN_US);
		return 0;
	}
	ret = read_poll_timeout(read_status, word,
				word & (CM_ICAP_SR_DONE | CM_ICAP_SR_FAILED | CM_ICAP_SR_ERRORS),
				POLL_US, PORT_TIMEOUT_US, false, icap);
	return (word & CM_ICAP_SR_ERRORS) >> CM_ICAP_SR_ERRORS_SHIFT |
	       (word & CM_ICAP_SR_FAILED ? CM_ICAP_ERR_PORT : 0) |
	       (ret ? CM_ICAP_ERR_TIMEOUT : 0);
}

/* softirq context */
static void dma_done(void *context, const struct cm_result *result)
{
	struct cm_icap *icap = context;
	bool last;

	spin_lock_bh(&icap->dma_lock);
	if (result->status && !icap->dma_error)
		icap->dma_error = result->status;
	last = --icap->dma_left == 0;
	spin_unlock_bh(&icap->dma_lock);
	if (last)
		complete(&icap->sent);
}

static int dma_error(struct cm_icap *icap)
{
	int error;

	spin_lock_bh(&icap->dma_lock);
	error = icap->dma_error;
	spin_unlock_bh(&icap->dma_lock);
	return error;
}

/**
 * cm_icap_await_sent() - wait for the end of cm_icap_send()
 * @icap: port
 *
 * Return: CM_ICAP_ERR_* bits.
 */
u32 cm_icap_await_sent(struct cm_icap *icap)
{
	int error;

	if (!wait_for_completion_timeout(&icap->sent, msecs_to_jiffies(icap->timeout_ms)))
		cm_channel_cancel(icap->channel);
	error = dma_error(icap);
	if (error == -ECANCELED)
		return CM_ICAP_ERR_TIMEOUT;
	return error ? CM_ICAP_ERR_DMA : 0;
}

/* how the transfer ended, and then the port */
static u32 await_end(struct cm_icap *icap)
{
	u32 errors;

	if (icap->request.reply.length)
		return cm_icap_read_end(icap);
	errors = cm_icap_await_sent(icap);
	return errors ?: cm_icap_port_errors(icap);
}

static void finish(struct cm_icap *icap, u32 errors)
{
	struct cm_icap_request request = icap->request;
	struct cm_icap_completion completion = {
		.cookie = request.cookie,
		.started_ns = icap->started_ns,
		.errors = errors,
		.status = cm_icap_verdict(errors),
	};

	if (request.reply.length)
		completion.length = icap->reply.length;
	else if (!(errors & (CM_ICAP_ERR_DMA | CM_ICAP_ERR_TIMEOUT)))
		completion.length = request.words.length;
	cm_icap_deselect_port(icap);
	/* a region whose load failed stays decoupled */
	if (request.own_bridges && !completion.status)
		completion.status = cm_icap_bridges_enable(icap);
	completion.finished_ns = ktime_get_ns();
	cm_buffer_put(request.buffer);
	mutex_lock(&icap->lock);
	icap->status.state = completion.status ? CM_ICAP_STATE_ERROR : CM_ICAP_STATE_IDLE;
	icap->status.errors = errors;
	icap->status.bytes_done = completion.length;
	icap->status.loads++;
	mutex_unlock(&icap->lock);
	request.done(request.context, &completion);
	wake_up_all(&icap->idle);
}

/* all of it before the first word is sent */
static void arm(struct cm_icap *icap, u64 length)
{
	u64 most = round_down(icap->channel->info.max_length, 4);

	reinit_completion(&icap->sent);
	spin_lock_bh(&icap->dma_lock);
	icap->dma_left = DIV64_U64_ROUND_UP(length, most);
	icap->dma_error = 0;
	spin_unlock_bh(&icap->dma_lock);
}

/**
 * cm_icap_send() - write words to the port
 * @icap: port
 * @part: of the buffer of the request under way
 *
 * The port sees one stream, however many descriptors it is cut into.
 *
 * Return: 0 and cm_icap_await_sent() is to be called, or a negative errno.
 */
int cm_icap_send(struct cm_icap *icap, const struct cm_icap_part *part)
{
	u64 most = round_down(icap->channel->info.max_length, 4);
	u64 left = part->length;
	struct cm_request request = {
		.buffer = icap->request.buffer,
		.offset = part->offset,
		.done = dma_done,
		.context = icap,
	};
	int ret = 0;

	arm(icap, part->length);
	for (; left && !ret; left -= request.length, request.offset += request.length) {
		request.length = min(left, most);
		ret = cm_channel_submit(icap->channel, &request);
		if (ret)
			break;
	}
	return ret;
}

/**
 * cm_icap_part_check() - whether a range is one of words in the buffer
 * @icap: port
 * @request: with its buffer
 * @part: range
 *
 * Return: 0, -EINVAL, or -EMSGSIZE above the longest load.
 */
int cm_icap_part_check(struct cm_icap *icap, const struct cm_icap_request *request,
		       const struct cm_icap_part *part)
{
	dma_addr_t address;

	if ((part->offset | part->length) & 3)
		return -EINVAL;
	if (cm_buffer_address(request->buffer, part->offset, part->length, &address))
		return -EINVAL;
	return part->length > icap->info.max_length ? -EMSGSIZE : 0;
}

static int check(struct cm_icap *icap, const struct cm_icap_request *request)
{
	int ret = cm_icap_part_check(icap, request, &request->words);

	return ret || !request->reply.length ? ret : cm_icap_read_check(icap, request);
}

static int begin(struct cm_icap *icap, const struct cm_icap_request *request, u32 *before)
{
	int ret = 0;

	mutex_lock(&icap->lock);
	*before = icap->status.state;
	if (icap->gone)
		ret = -ENODEV;
	else if (icap->status.state == CM_ICAP_STATE_LOADING)
		ret = -EBUSY;
	if (!ret) {
		icap->status.state = CM_ICAP_STATE_LOADING;
		icap->status.errors = 0;
		icap->status.bytes_done = 0;
		icap->status.bytes_total = request->reply.length ?: request->words.length;
	}
	mutex_unlock(&icap->lock);
	return ret;
}

static void withdraw(struct cm_icap *icap, u32 state)
{
	mutex_lock(&icap->lock);
	icap->status.state = state;
	mutex_unlock(&icap->lock);
	wake_up_all(&icap->idle);
}

/* the port is asked for before anything is decoupled: it may be refused */
static int prepare(struct cm_icap *icap)
{
	int ret = cm_icap_select_port(icap);

	if (ret || !icap->request.own_bridges)
		return ret;
	ret = cm_icap_bridges_disable(icap);
	if (ret) {
		/* those that were closed before the one that could not be */
		cm_icap_bridges_enable(icap);
		cm_icap_deselect_port(icap);
	}
	return ret;
}

/* what was sent before the engine took no more is ended, and not reported */
static void send_back(struct cm_icap *icap)
{
	cm_channel_cancel(icap->channel);
	cm_icap_deselect_port(icap);
}

/**
 * cm_icap_work() - one load or read, from its start to its end
 * @work: of a port
 */
void cm_icap_work(struct work_struct *work)
{
	struct cm_icap *icap = container_of(work, struct cm_icap, work);
	u32 otherwise = icap->state_before;
	int ret = prepare(icap);

	if (!ret) {
		icap->started_ns = ktime_get_ns();
		ret = icap->request.reply.length ? cm_icap_read_begin(icap) :
						   cm_icap_send(icap, &icap->request.words);
		if (ret) {
			send_back(icap);
			otherwise = CM_ICAP_STATE_ERROR;
		}
	}
	icap->start_error = ret;
	if (ret) {
		cm_buffer_put(icap->request.buffer);
		withdraw(icap, otherwise);
	}
	complete(&icap->started);
	if (!ret)
		finish(icap, await_end(icap));
}

/**
 * cm_icap_start() - start a load or a read
 * @icap: port
 * @request: copied; the port takes its own reference to the buffer
 *
 * Return: 0, and @request's done will be called; or a negative errno, and it
 * will not: -EINVAL for a range that is not made of words or lies outside the
 * buffer, -EMSGSIZE above the longest load, -EBUSY while one runs, or while the
 * platform's own FPGA manager is in use, -EACCES or -EIO where the platform does
 * not give the port.
 */
int cm_icap_start(struct cm_icap *icap, const struct cm_icap_request *request)
{
	int ret = check(icap, request);

	if (ret)
		return ret;
	mutex_lock(&icap->start_lock);
	ret = begin(icap, request, &icap->state_before);
	if (!ret) {
		icap->request = *request;
		cm_buffer_get(request->buffer);
		reinit_completion(&icap->started);
		queue_work(icap->queue, &icap->work);
		wait_for_completion(&icap->started);
		ret = icap->start_error;
	}
	mutex_unlock(&icap->start_lock);
	return ret;
}
