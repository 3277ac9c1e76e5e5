// SPDX-License-Identifier: GPL-2.0-only
/* A DMA channel: one request is one descriptor, and they end in order. */
#include <linux/debugfs.h>
#include <linux/ktime.h>
#include <linux/log2.h>
#include <linux/of.h>
#include <linux/seq_file.h>
#include <linux/slab.h>

#include "cm_compat.h"
#include "cm_core.h"

/**
 * struct cm_active - a request under way
 * @node: in the channel's list
 * @channel: channel
 * @request: as given; its buffer is referenced
 * @address: of the first byte, for the device
 * @readable: for its results
 */
struct cm_active {
	struct list_head node;
	struct cm_channel *channel;
	struct cm_request request;
	dma_addr_t address;
	u32 readable;
};

static void active_done(void *param, const struct dmaengine_result *result);

/**
 * cm_channel_direction() - a channel's direction in the DMA API's words
 * @channel: channel
 *
 * Return: DMA_TO_DEVICE or DMA_FROM_DEVICE.
 */
enum dma_data_direction cm_channel_direction(const struct cm_channel *channel)
{
	return channel->info.direction == CM_DMA_MM2S ? DMA_TO_DEVICE : DMA_FROM_DEVICE;
}
EXPORT_SYMBOL_CM(cm_channel_direction);

static enum dma_transfer_direction engine_direction(const struct cm_channel *channel)
{
	return channel->info.direction == CM_DMA_MM2S ? DMA_MEM_TO_DEV : DMA_DEV_TO_MEM;
}

static u32 channel_caps(struct dma_chan *chan)
{
	struct dma_slave_caps slave;
	u32 caps = 0;

	if (dma_has_cap(DMA_CYCLIC, chan->device->cap_mask))
		caps |= CM_DMA_CAP_CYCLIC;
	if (dma_has_cap(DMA_INTERLEAVE, chan->device->cap_mask) &&
	    chan->device->device_prep_interleaved_dma)
		caps |= CM_DMA_CAP_VIDEO;
	if (!dma_get_slave_caps(chan, &slave) &&
	    slave.residue_granularity != DMA_RESIDUE_GRANULARITY_DESCRIPTOR)
		caps |= CM_DMA_CAP_RESIDUE;
	return caps;
}

/*
 * AXI DMA splits a longer request into several descriptors, of which a short
 * packet leaves some armed; its length register has 8 to 26 bits.
 */
static u64 engine_max_length(struct dma_chan *chan)
{
	u32 bits = 23;

	of_property_read_u32(chan->device->dev->of_node, "xlnx,sg-length-width", &bits);
	return BIT_ULL(clamp(bits, 8U, 26U)) - 1;
}

static void channel_describe(struct cm_channel *channel, const struct cm_channel_config *config)
{
	struct cm_dma_info *info = &channel->info;
	u32 align = 1U << channel->chan->device->copy_align;

	strscpy(info->name, config->name, sizeof(info->name));
	info->direction = config->direction;
	info->type = config->type;
	info->queue_depth = config->queue_depth;
	info->frame_length = config->frame_length;
	info->caps = channel_caps(channel->chan);
	info->alignment = max(config->alignment, align);
	info->max_length = config->max_length ?: engine_max_length(channel->chan);
	info->max_length = round_down(info->max_length, info->alignment);
}

static bool config_valid(const struct cm_channel_config *config)
{
	return cm_channel_name_valid(config->name) &&
	       (config->direction == CM_DMA_MM2S || config->direction == CM_DMA_S2MM) &&
	       (config->type == CM_DMA_TYPE_AXIDMA || config->type == CM_DMA_TYPE_VDMA) &&
	       config->queue_depth && config->queue_depth <= 256 &&
	       (!config->alignment || is_power_of_2(config->alignment)) &&
	       config->alignment <= PAGE_SIZE;
}

/* an engine that is unbound unbinds its clients first, and brings them back */
static struct dma_chan *request_engine(struct device *dev, const char *name)
{
	struct dma_chan *chan = dma_request_chan(dev, name);

	if (IS_ERR(chan))
		return chan;
	if (device_link_add(dev, chan->device->dev, DL_FLAG_AUTOPROBE_CONSUMER))
		return chan;
	dma_release_channel(chan);
	return ERR_PTR(-ENODEV);
}

/**
 * cm_channel_create() - request a DMA channel
 * @dev: client device; the channel's name is looked up in its dma-names
 * @config: what is known of the channel
 *
 * Return: a channel with one reference, to be given back by
 * cm_channel_remove(), or an ERR_PTR: -EPROBE_DEFER while the engine is not
 * there, -ENODEV where it goes away, -EINVAL for a configuration that cannot
 * be, or what is wrong with the device's memory-region.
 */
struct cm_channel *cm_channel_create(struct device *dev, const struct cm_channel_config *config)
{
	struct cm_channel *channel;
	int ret;

	if (!config_valid(config))
		return ERR_PTR(-EINVAL);
	channel = kzalloc(sizeof(*channel), GFP_KERNEL);
	if (!channel)
		return ERR_PTR(-ENOMEM);
	channel->pool = cm_pool_assign(dev);
	ret = PTR_ERR_OR_ZERO(channel->pool);
	if (ret)
		goto no_pool;
	channel->chan = request_engine(dev, config->name);
	ret = PTR_ERR_OR_ZERO(channel->chan);
	if (ret)
		goto no_engine;
	kref_init(&channel->ref);
	mutex_init(&channel->lock);
	spin_lock_init(&channel->active_lock);
	INIT_LIST_HEAD(&channel->active);
	init_waitqueue_head(&channel->waiting);
	channel->dma_dev = get_device(cm_dma_device(channel->chan));
	/* with a memory-region of its own the client's device has the memory */
	channel->alloc_dev = get_device(channel->pool ? dev : channel->dma_dev);
	channel_describe(channel, config);
	return channel;

no_engine:
	cm_pool_put(channel->pool);
no_pool:
	kfree(channel);
	return ERR_PTR(ret);
}
EXPORT_SYMBOL_CM(cm_channel_create);

static void channel_free(struct kref *ref)
{
	struct cm_channel *channel = container_of(ref, struct cm_channel, ref);

	cm_pool_put(channel->pool);
	put_device(channel->alloc_dev);
	put_device(channel->dma_dev);
	mutex_destroy(&channel->lock);
	kfree(channel);
}

/**
 * cm_channel_get() - take a reference
 * @channel: channel
 *
 * Return: @channel.
 */
struct cm_channel *cm_channel_get(struct cm_channel *channel)
{
	kref_get(&channel->ref);
	return channel;
}
EXPORT_SYMBOL_CM(cm_channel_get);

/**
 * cm_channel_put() - give a reference back
 * @channel: channel
 */
void cm_channel_put(struct cm_channel *channel)
{
	kref_put(&channel->ref, channel_free);
}
EXPORT_SYMBOL_CM(cm_channel_put);

/**
 * cm_channel_claim() - have a channel to oneself
 * @channel: channel
 *
 * Return: 0, -EBUSY where somebody has it, -ENODEV where the device is gone.
 */
int cm_channel_claim(struct cm_channel *channel)
{
	int ret = 0;

	mutex_lock(&channel->lock);
	if (!channel->chan)
		ret = -ENODEV;
	else if (channel->claimed)
		ret = -EBUSY;
	else
		channel->claimed = true;
	mutex_unlock(&channel->lock);
	return ret;
}
EXPORT_SYMBOL_CM(cm_channel_claim);

static void active_free(struct cm_active *active)
{
	atomic_dec(&active->request.buffer->in_flight);
	cm_buffer_put_atomic(active->request.buffer);
	kfree(active);
}

static struct cm_result result_of(const struct cm_active *active, u64 length, int status, bool last)
{
	return (struct cm_result){
		.cookie = active->request.cookie,
		.length = length,
		.timestamp_ns = ktime_get_ns(),
		.status = status,
		.readable = active->readable,
		.last = last,
	};
}

/* in this order: who hears of the end may free the buffer at once */
static void active_finish(struct cm_active *active, u64 length, int status)
{
	struct cm_result result = result_of(active, length, status, true);
	struct cm_request request = active->request;

	active_free(active);
	request.done(request.context, &result);
}

static void active_period(struct cm_active *active, u64 length, int status)
{
	struct cm_result result = result_of(active, length, status, false);

	active->request.done(active->request.context, &result);
}

/* the engine has stopped, so no callback runs beside this */
static void cancel_all(struct cm_channel *channel)
{
	struct cm_active *active, *next;
	LIST_HEAD(cancelled);

	spin_lock_bh(&channel->active_lock);
	list_splice_init(&channel->active, &cancelled);
	spin_unlock_bh(&channel->active_lock);
	list_for_each_entry_safe(active, next, &cancelled, node) {
		channel->stats.cancelled++;
		active_finish(active, 0, -ECANCELED);
	}
}

static void stop_locked(struct cm_channel *channel)
{
	spin_lock_bh(&channel->active_lock);
	channel->stopping = true;
	spin_unlock_bh(&channel->active_lock);
	dmaengine_terminate_sync(channel->chan);
	/* a callback that had not seen the flag may have repeated its frame */
	if (channel->info.caps & CM_DMA_CAP_VIDEO)
		dmaengine_terminate_sync(channel->chan);
	cancel_all(channel);
	channel->stopping = false;
}

/**
 * cm_channel_cancel() - end all transfers
 * @channel: channel, claimed by the caller
 *
 * When it returns the engine has stopped, and every request under way has been
 * told -ECANCELED.
 *
 * Return: 0 or -ENODEV where the device is gone.
 */
int cm_channel_cancel(struct cm_channel *channel)
{
	int ret = -ENODEV;

	mutex_lock(&channel->lock);
	if (channel->chan) {
		stop_locked(channel);
		ret = 0;
	}
	mutex_unlock(&channel->lock);
	return ret;
}
EXPORT_SYMBOL_CM(cm_channel_cancel);

/**
 * cm_channel_release() - end all transfers and give the channel back
 * @channel: channel, claimed by the caller
 */
void cm_channel_release(struct cm_channel *channel)
{
	cm_channel_cancel(channel);
	mutex_lock(&channel->lock);
	channel->claimed = false;
	mutex_unlock(&channel->lock);
}
EXPORT_SYMBOL_CM(cm_channel_release);

/**
 * cm_channel_remove() - the device goes away
 * @channel: channel; the caller's reference is given back
 *
 * Ends all transfers.  A holder of the channel gets -ENODEV from then on.
 */
void cm_channel_remove(struct cm_channel *channel)
{
	mutex_lock(&channel->lock);
	stop_locked(channel);
	dma_release_channel(channel->chan);
	WRITE_ONCE(channel->chan, NULL);
	mutex_unlock(&channel->lock);
	wake_up_all(&channel->waiting);
	cm_channel_put(channel);
}
EXPORT_SYMBOL_CM(cm_channel_remove);

static struct dma_async_tx_descriptor *prepare_video(struct cm_channel *channel,
						     const struct cm_active *active)
{
	const struct cm_request *request = &active->request;
	struct dma_async_tx_descriptor *tx;
	struct dma_interleaved_template *template;
	bool to_device = channel->info.direction == CM_DMA_MM2S;

	template = kzalloc(struct_size(template, sgl, 1), GFP_ATOMIC);
	if (!template)
		return NULL;
	template->dir = engine_direction(channel);
	template->src_start = to_device ? active->address : 0;
	template->dst_start = to_device ? 0 : active->address;
	template->src_inc = to_device;
	template->src_sgl = to_device;
	template->dst_inc = !to_device;
	template->dst_sgl = !to_device;
	template->numf = request->lines;
	template->frame_size = 1;
	template->sgl[0].size = request->line_bytes;
	template->sgl[0].icg = request->stride - request->line_bytes;
	tx = dmaengine_prep_interleaved_dma(channel->chan, template,
					    DMA_PREP_INTERRUPT | DMA_CTRL_ACK);
	kfree(template);
	return tx;
}

static struct dma_async_tx_descriptor *prepare(struct cm_channel *channel,
					       const struct cm_active *active)
{
	const struct cm_request *request = &active->request;
	enum dma_transfer_direction direction = engine_direction(channel);
	unsigned long flags = DMA_PREP_INTERRUPT | DMA_CTRL_ACK;

	if (request->lines)
		return prepare_video(channel, active);
	if (request->cyclic)
		return dmaengine_prep_dma_cyclic(channel->chan, active->address, request->length,
						 request->period, direction, flags);
	return dmaengine_prep_slave_single(channel->chan, active->address, request->length,
					   direction, flags);
}

static int start(struct cm_channel *channel, struct cm_active *active)
{
	struct dma_async_tx_descriptor *tx = prepare(channel, active);
	dma_cookie_t cookie;

	if (!tx)
		return -ENOMEM;
	tx->callback_result = active_done;
	tx->callback_param = active;
	cookie = dmaengine_submit(tx);
	if (dma_submit_error(cookie))
		return -EIO;
	dma_async_issue_pending(channel->chan);
	return 0;
}

static u64 moved_bytes(const struct cm_active *active, const struct dmaengine_result *result)
{
	const struct cm_request *request = &active->request;

	if (request->lines)
		return (u64)request->lines * request->line_bytes;
	if (request->cyclic)
		return request->period;
	return result && result->residue <= request->length ? request->length - result->residue :
							      request->length;
}

static bool account(struct cm_channel *channel, const struct cm_active *active, u64 length,
		    int status)
{
	bool again;

	spin_lock_bh(&channel->active_lock);
	if (status)
		channel->stats.failed++;
	else
		channel->stats.completed++;
	channel->stats.bytes += length;
	if (!status && !active->request.lines && !active->request.cyclic &&
	    length < active->request.length)
		channel->stats.short_packets++;
	again = active->request.cyclic && !channel->stopping;
	spin_unlock_bh(&channel->active_lock);
	return again;
}

static void active_end(struct cm_active *active, u64 length, int status)
{
	struct cm_channel *channel = active->channel;

	spin_lock_bh(&channel->active_lock);
	list_del(&active->node);
	spin_unlock_bh(&channel->active_lock);
	active_finish(active, length, status);
}

/* softirq context; a running terminate waits for it */
static void active_done(void *param, const struct dmaengine_result *result)
{
	struct cm_active *active = param;
	struct cm_channel *channel = active->channel;
	int status = result && result->result != DMA_TRANS_NOERROR ? -EIO : 0;
	u64 length = status ? 0 : moved_bytes(active, result);
	bool again = account(channel, active, length, status);
	int ret;

	if (!active->request.cyclic) {
		active_end(active, length, status);
		return;
	}
	active_period(active, length, status);
	/* engines have no cyclic video transfer: the same frame again */
	if (active->request.lines && again) {
		ret = start(channel, active);
		if (ret)
			active_end(active, 0, ret);
	}
}

/* a cyclic request has the channel alone */
static bool room_for(struct cm_channel *channel, const struct cm_request *request)
{
	struct cm_active *first;
	bool room;

	spin_lock_bh(&channel->active_lock);
	first = list_first_entry_or_null(&channel->active, struct cm_active, node);
	room = !first || (!request->cyclic && !first->request.cyclic);
	spin_unlock_bh(&channel->active_lock);
	return room;
}

static int submit_locked(struct cm_channel *channel, struct cm_active *active)
{
	int ret;

	if (!channel->chan)
		return -ENODEV;
	if (!room_for(channel, &active->request))
		return -EBUSY;
	spin_lock_bh(&channel->active_lock);
	list_add_tail(&active->node, &channel->active);
	channel->stats.submitted++;
	spin_unlock_bh(&channel->active_lock);
	ret = start(channel, active);
	if (ret) {
		spin_lock_bh(&channel->active_lock);
		list_del(&active->node);
		channel->stats.submitted--;
		spin_unlock_bh(&channel->active_lock);
	}
	return ret;
}

/**
 * cm_channel_submit() - start a transfer
 * @channel: channel, claimed by the caller
 * @request: copied; the channel takes its own reference to the buffer
 *
 * Return: 0, and @request's done will be called; or a negative errno, and it
 * will not: -EINVAL for a range outside the buffer or against the alignment,
 * -EMSGSIZE above the longest transfer, -EOPNOTSUPP for what the engine cannot
 * do, -EBUSY beside a cyclic one, -ENODEV where the device is gone.
 */
int cm_channel_submit(struct cm_channel *channel, const struct cm_request *request)
{
	struct cm_active *active;
	int ret = cm_request_check(&channel->info, request);

	if (ret)
		return ret;
	active = kzalloc(sizeof(*active), GFP_KERNEL);
	if (!active)
		return -ENOMEM;
	active->channel = channel;
	active->request = *request;
	active->readable = cm_request_readable(request);
	ret = cm_buffer_address(request->buffer, request->offset, cm_request_footprint(request),
				&active->address);
	if (ret) {
		kfree(active);
		return ret;
	}
	cm_buffer_get(request->buffer);
	atomic_inc(&request->buffer->in_flight);
	mutex_lock(&channel->lock);
	ret = submit_locked(channel, active);
	mutex_unlock(&channel->lock);
	if (ret)
		active_free(active);
	return ret;
}
EXPORT_SYMBOL_CM(cm_channel_submit);

static int statistics_show(struct seq_file *file, void *unused)
{
	struct cm_channel *channel = file->private;
	struct cm_channel_stats stats;
	u32 active = 0;
	struct list_head *node;

	spin_lock_bh(&channel->active_lock);
	stats = channel->stats;
	list_for_each(node, &channel->active)
		active++;
	spin_unlock_bh(&channel->active_lock);
	seq_printf(file, "active: %u\nsubmitted: %llu\ncompleted: %llu\nfailed: %llu\n", active,
		   stats.submitted, stats.completed, stats.failed);
	seq_printf(file, "cancelled: %llu\nbytes: %llu\nshort_packets: %llu\n", stats.cancelled,
		   stats.bytes, stats.short_packets);
	return 0;
}
DEFINE_SHOW_ATTRIBUTE(statistics);

/**
 * cm_channel_debugfs() - show a channel's counters
 * @channel: channel; must outlive @parent
 * @parent: folder
 */
void cm_channel_debugfs(struct cm_channel *channel, struct dentry *parent)
{
	debugfs_create_file(channel->info.name, 0444, parent, channel, &statistics_fops);
}
EXPORT_SYMBOL_CM(cm_channel_debugfs);
