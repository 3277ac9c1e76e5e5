// SPDX-License-Identifier: GPL-2.0-only
/* Transfers in one or both directions, waited for or told by a signal. */
#include <linux/completion.h>
#include <linux/kref.h>
#include <linux/moduleparam.h>
#include <linux/pid.h>
#include <linux/sched/signal.h>
#include <linux/slab.h>
#include <linux/uaccess.h>

#include "axidma.h"
#include "cm_compat.h"

static unsigned int timeout_ms = 10000;
module_param(timeout_ms, uint, 0644);
MODULE_PARM_DESC(timeout_ms, "longest wait for a transfer in milliseconds");

/**
 * struct axidma_waiter - what waits for a transfer's end
 * @ref: one of the transfer, one of the waiting process
 * @over: completed at the end
 * @status: 0 or a negative errno
 * @owner: process that gets the signal, or NULL
 * @signal: signal, or 0
 * @id: number of the channel, sent with it
 */
struct axidma_waiter {
	struct kref ref;
	struct completion over;
	int status;
	struct pid *owner;
	int signal;
	int id;
};

static void waiter_release(struct kref *ref)
{
	struct axidma_waiter *waiter = container_of(ref, struct axidma_waiter, ref);

	put_pid(waiter->owner);
	kfree(waiter);
}

static void waiter_put(struct axidma_waiter *waiter)
{
	kref_put(&waiter->ref, waiter_release);
}

static struct axidma_waiter *waiter_new(int signal, int id)
{
	struct axidma_waiter *waiter = kzalloc(sizeof(*waiter), GFP_KERNEL);

	if (!waiter)
		return NULL;
	kref_init(&waiter->ref);
	init_completion(&waiter->over);
	waiter->signal = signal;
	waiter->id = id;
	waiter->owner = signal ? get_pid(task_tgid(current)) : NULL;
	return waiter;
}

static void send_signal(const struct axidma_waiter *waiter)
{
	struct kernel_siginfo info;
	struct task_struct *task;

	clear_siginfo(&info);
	info.si_signo = waiter->signal;
	info.si_code = SI_QUEUE;
	info.si_int = waiter->id;
	rcu_read_lock();
	task = pid_task(waiter->owner, PIDTYPE_TGID);
	if (task)
		send_sig_info(waiter->signal, &info, task);
	rcu_read_unlock();
}

static void transfer_done(void *context, const struct cm_result *result)
{
	struct axidma_waiter *waiter = context;

	waiter->status = result->status;
	if (waiter->signal && result->status != -ECANCELED)
		send_signal(waiter);
	complete(&waiter->over);
	waiter_put(waiter);
}

static int fill(struct axidma_file *file, struct axidma_channel *channel, unsigned long address,
		unsigned long length, const struct axidma_abi_frame *frame,
		struct cm_request *request)
{
	if (channel->channel->info.type == CM_DMA_TYPE_VDMA) {
		int ret = axidma_frame_request(frame, request);

		if (ret)
			return ret;
	}
	request->buffer = axidma_region_find(file, address, length, &request->offset);
	if (!request->buffer)
		return -EFAULT;
	/* the frame must lie in what the caller named, too */
	if (request->lines && (u64)request->lines * request->line_bytes > length) {
		cm_buffer_put(request->buffer);
		return -EINVAL;
	}
	request->length = length;
	return 0;
}

static int submit(struct axidma_file *file, struct axidma_channel *channel, unsigned long address,
		  unsigned long length, const struct axidma_abi_frame *frame,
		  struct axidma_waiter *waiter)
{
	struct cm_request request = { .done = transfer_done, .context = waiter };
	int ret = fill(file, channel, address, length, frame, &request);

	if (ret)
		return ret;
	kref_get(&waiter->ref);
	ret = cm_channel_submit(channel->channel, &request);
	if (ret)
		waiter_put(waiter);
	cm_buffer_put(request.buffer);
	return ret;
}

/* end a transfer that has no waiter any more */
static int wait_over(struct axidma_channel *channel, struct axidma_waiter *waiter)
{
	long left = wait_for_completion_killable_timeout(&waiter->over,
							 msecs_to_jiffies(timeout_ms));

	if (left > 0)
		return waiter->status;
	cm_channel_cancel(channel->channel);
	return left ?: -ETIME;
}

/**
 * axidma_one_way() - AXIDMA_ABI_DMA_READ and AXIDMA_ABI_DMA_WRITE
 * @file: file
 * @direction: CM_DMA_*
 * @arg: struct axidma_abi_transfer
 *
 * Return: 0, -ENODEV for an unknown channel, -EFAULT for memory that is not
 * this file's, -ETIME, -EIO, or another negative errno.
 */
long axidma_one_way(struct axidma_file *file, u32 direction, void __user *arg)
{
	struct axidma_abi_transfer args;
	struct axidma_channel *channel;
	struct axidma_waiter *waiter;
	int ret;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	channel = axidma_channel_find(file, args.id, direction);
	if (!channel)
		return -ENODEV;
	waiter = waiter_new(args.wait ? 0 : READ_ONCE(file->signal), args.id);
	if (!waiter)
		return -ENOMEM;
	ret = submit(file, channel, args.address, args.length, &args.frame, waiter);
	if (!ret && args.wait)
		ret = wait_over(channel, waiter);
	waiter_put(waiter);
	return ret;
}

static int start_both(struct axidma_file *file, const struct axidma_abi_two_way *args,
		      struct axidma_channel *tx, struct axidma_channel *rx,
		      struct axidma_waiter *sent, struct axidma_waiter *received)
{
	/* the receiver is ready before anything is sent */
	int ret = submit(file, rx, args->rx_address, args->rx_length, &args->rx_frame, received);

	if (ret)
		return ret;
	ret = submit(file, tx, args->tx_address, args->tx_length, &args->tx_frame, sent);
	if (ret)
		cm_channel_cancel(rx->channel);
	return ret;
}

/**
 * axidma_two_way() - AXIDMA_ABI_DMA_TWO_WAY
 * @file: file
 * @arg: struct axidma_abi_two_way
 *
 * Waiting means waiting for the receiver.
 *
 * Return: as axidma_one_way().
 */
long axidma_two_way(struct axidma_file *file, void __user *arg)
{
	struct axidma_waiter *sent, *received;
	struct axidma_abi_two_way args;
	struct axidma_channel *tx, *rx;
	int ret = -ENOMEM;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	tx = axidma_channel_find(file, args.tx_id, CM_DMA_MM2S);
	rx = axidma_channel_find(file, args.rx_id, CM_DMA_S2MM);
	if (!tx || !rx)
		return -ENODEV;
	sent = waiter_new(READ_ONCE(file->signal), args.tx_id);
	received = waiter_new(args.wait ? 0 : READ_ONCE(file->signal), args.rx_id);
	if (sent && received)
		ret = start_both(file, &args, tx, rx, sent, received);
	if (!ret && args.wait) {
		ret = wait_over(rx, received);
		if (ret == -ETIME)
			cm_channel_cancel(tx->channel);
	}
	if (sent)
		waiter_put(sent);
	if (received)
		waiter_put(received);
	return ret;
}
