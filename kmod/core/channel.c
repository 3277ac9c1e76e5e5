// SPDX-License-Identifier: GPL-2.0-only
/* A DMA channel: who has it, and what can be asked of it. */
#include <linux/debugfs.h>
#include <linux/log2.h>
#include <linux/of.h>
#include <linux/seq_file.h>
#include <linux/slab.h>

#include "channel.h"
#include "cm_compat.h"

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

static u32 channel_caps(const struct cm_channel *channel)
{
	struct dma_chan *chan = channel->chan;
	const struct cm_traits *traits = channel->traits;
	/* what xilinx_dma says of itself is right for AXI DMA alone */
	bool known = !traits->own_cyclic && traits->residue;
	struct dma_slave_caps slave;
	u32 caps = 0;

	if (known || dma_has_cap(DMA_CYCLIC, chan->device->cap_mask))
		caps |= CM_DMA_CAP_CYCLIC;
	if (chan->device->device_prep_interleaved_dma &&
	    (traits->interleaved || dma_has_cap(DMA_INTERLEAVE, chan->device->cap_mask)))
		caps |= CM_DMA_CAP_VIDEO;
	if (traits->simple)
		caps |= CM_DMA_CAP_SIMPLE;
	if (known || traits->length_register ||
	    (traits->residue && !dma_get_slave_caps(chan, &slave) &&
	     slave.residue_granularity != DMA_RESIDUE_GRANULARITY_DESCRIPTOR))
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
	info->caps = channel_caps(channel);
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

static int check_engine(struct cm_channel *channel, struct device *dev)
{
	struct device *dma_dev = dmaengine_get_dma_device(channel->chan);

	/* a callback that runs on would find freed memory: xilinx_dma of 5.10 */
	if (!channel->chan->device->device_synchronize)
		return dev_err_probe(dev, -EOPNOTSUPP,
				     "%s has no device_synchronize: a newer kernel's has\n",
				     dev_name(channel->chan->device->dev));
	/* the memory's addresses are not those that the engine has behind an IOMMU */
	if (channel->pool && device_iommu_mapped(dma_dev))
		return dev_err_probe(dev, -EOPNOTSUPP,
				     "memory-region: %s is behind an IOMMU, and cannot reach it\n",
				     dev_name(dma_dev));
	return 0;
}

static int channel_engine(struct cm_channel *channel, struct device *dev,
			  const struct cm_channel_config *config)
{
	int ret;

	channel->chan = request_engine(dev, config->name);
	if (IS_ERR(channel->chan))
		return PTR_ERR(channel->chan);
	ret = check_engine(channel, dev);
	if (ret) {
		dma_release_channel(channel->chan);
		return ret;
	}
	channel->engine = cm_engine_get(channel->chan);
	ret = channel->engine ? 0 : -ENOMEM;
	if (!ret)
		ret = cm_traits_read(channel->traits, channel->chan, config->direction);
	if (ret) {
		cm_engine_put(channel->engine);
		dma_release_channel(channel->chan);
	}
	return ret;
}

static void channel_init(struct cm_channel *channel)
{
	kref_init(&channel->ref);
	spin_lock_init(&channel->active_lock);
	INIT_LIST_HEAD(&channel->active);
	INIT_WORK(&channel->settle, cm_channel_settle);
	INIT_DELAYED_WORK(&channel->watch, cm_channel_watch);
	init_waitqueue_head(&channel->waiting);
}

/**
 * cm_channel_create() - request a DMA channel
 * @dev: client device; the channel's name is looked up in its dma-names
 * @config: what is known of the channel
 *
 * Return: a channel with one reference, to be given back by
 * cm_channel_remove(), or an ERR_PTR: -EPROBE_DEFER while the engine is not
 * there, -ENODEV where it goes away, -EINVAL for a configuration that cannot
 * be, -EOPNOTSUPP for an engine that cannot be stopped safely or does not
 * reach the device's memory-region, or what else is wrong with that.
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
	channel->traits = kzalloc(sizeof(*channel->traits), GFP_KERNEL);
	ret = channel->traits ? 0 : -ENOMEM;
	if (ret)
		goto no_pool;
	channel->pool = cm_pool_assign(dev);
	ret = PTR_ERR_OR_ZERO(channel->pool);
	if (ret)
		goto no_pool;
	ret = channel_engine(channel, dev, config);
	if (ret)
		goto no_engine;
	channel_init(channel);
	channel->dma_dev = get_device(dmaengine_get_dma_device(channel->chan));
	/* with a memory-region of its own the client's device has the memory */
	channel->alloc_dev = get_device(channel->pool ? dev : channel->dma_dev);
	channel_describe(channel, config);
	mutex_lock(&channel->engine->lock);
	list_add_tail(&channel->siblings, &channel->engine->channels);
	mutex_unlock(&channel->engine->lock);
	return channel;

no_engine:
	cm_pool_put(channel->pool);
no_pool:
	kfree(channel->traits);
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
	cm_engine_put(channel->engine);
	kfree(channel->traits);
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
 * Return: 0, -EBUSY if it is in use, -ENODEV where the device is gone.
 */
int cm_channel_claim(struct cm_channel *channel)
{
	int ret = 0;

	mutex_lock(&channel->engine->lock);
	if (!channel->chan)
		ret = -ENODEV;
	else if (channel->claimed)
		ret = -EBUSY;
	else
		channel->claimed = true;
	mutex_unlock(&channel->engine->lock);
	return ret;
}
EXPORT_SYMBOL_CM(cm_channel_claim);

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

	mutex_lock(&channel->engine->lock);
	if (channel->chan) {
		cm_channel_stop(channel);
		ret = 0;
	}
	mutex_unlock(&channel->engine->lock);
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
	mutex_lock(&channel->engine->lock);
	channel->claimed = false;
	mutex_unlock(&channel->engine->lock);
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
	mutex_lock(&channel->engine->lock);
	cm_channel_stop(channel);
	list_del(&channel->siblings);
	cm_traits_release(channel->traits);
	dma_release_channel(channel->chan);
	WRITE_ONCE(channel->chan, NULL);
	/* who unbinds the engine has unbound all its clients first */
	if (list_empty(&channel->engine->channels))
		cm_buffers_unmap(channel->dma_dev);
	mutex_unlock(&channel->engine->lock);
	cancel_work_sync(&channel->settle);
	cancel_delayed_work_sync(&channel->watch);
	wake_up_all(&channel->waiting);
	cm_channel_put(channel);
}
EXPORT_SYMBOL_CM(cm_channel_remove);

/**
 * cm_channel_shutdown() - the system goes down
 * @channel: channel
 *
 * Ends all transfers: the next kernel does not know of them, and an engine that
 * goes on would write into its memory.  Whoever holds the channel may still run;
 * it gets -ENODEV.
 */
void cm_channel_shutdown(struct cm_channel *channel)
{
	mutex_lock(&channel->engine->lock);
	channel->shut = true;
	cm_channel_stop(channel);
	mutex_unlock(&channel->engine->lock);
}
EXPORT_SYMBOL_CM(cm_channel_shutdown);

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

	if (!channel->chan || channel->shut)
		return -ENODEV;
	if (!room_for(channel, &active->request))
		return -EBUSY;
	spin_lock_bh(&channel->active_lock);
	list_add_tail(&active->node, &channel->active);
	channel->stats.submitted++;
	spin_unlock_bh(&channel->active_lock);
	ret = cm_channel_feed(channel, active);
	if (ret) {
		spin_lock_bh(&channel->active_lock);
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
	mutex_lock(&channel->engine->lock);
	ret = submit_locked(channel, active);
	mutex_unlock(&channel->engine->lock);
	if (ret)
		cm_active_free(active);
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
	seq_printf(file, "cancelled: %llu\nbytes: %llu\nshort_packets: %llu\nrearmed: %llu\n",
		   stats.cancelled, stats.bytes, stats.short_packets, stats.rearmed);
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
