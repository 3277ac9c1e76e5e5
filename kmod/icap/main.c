// SPDX-License-Identifier: GPL-2.0-only
/*
 * cm_icap: partial reconfiguration through a configuration port that a DMA
 * channel feeds.  Properties are in docs/kernel.md and the bindings.
 */
#include <linux/clk.h>
#include <linux/idr.h>
#include <linux/mod_devicetable.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/pm.h>
#include <linux/property.h>
#include <linux/slab.h>

#include "cm_compat.h"
#include "icap.h"

#define CM_ICAP_MAX_LENGTH 0x3FFFFFC
#define CM_ICAP_TIMEOUT_MS 2000
#define CM_ICAP_TIMEOUT_MAX_MS 600000

static DEFINE_IDA(cm_icap_ids);

static void icap_free(struct kref *ref)
{
	struct cm_icap *icap = container_of(ref, struct cm_icap, ref);

	if (icap->channel)
		cm_channel_put(icap->channel);
	if (icap->back)
		cm_channel_put(icap->back);
	ida_free(&cm_icap_ids, icap->id);
	mutex_destroy(&icap->lock);
	mutex_destroy(&icap->start_lock);
	kfree(icap);
}

/**
 * cm_icap_put() - give a reference back
 * @icap: port
 */
void cm_icap_put(struct cm_icap *icap)
{
	kref_put(&icap->ref, icap_free);
}

static void put_icap(void *icap)
{
	cm_icap_put(icap);
}

static struct cm_icap *icap_new(struct device *dev)
{
	struct cm_icap *icap = kzalloc(sizeof(*icap), GFP_KERNEL);

	if (!icap)
		return NULL;
	icap->id = ida_alloc(&cm_icap_ids, GFP_KERNEL);
	if (icap->id < 0) {
		kfree(icap);
		return NULL;
	}
	kref_init(&icap->ref);
	mutex_init(&icap->lock);
	spin_lock_init(&icap->dma_lock);
	init_waitqueue_head(&icap->idle);
	mutex_init(&icap->start_lock);
	init_completion(&icap->started);
	init_completion(&icap->sent);
	init_completion(&icap->received);
	INIT_WORK(&icap->work, cm_icap_work);
	icap->dev = dev;
	snprintf(icap->name, sizeof(icap->name), "cm_icap%d", icap->id);
	return icap;
}

static void remove_channel(void *channel)
{
	cm_channel_release(channel);
	cm_channel_remove(channel);
}

static int add_channel(struct cm_icap *icap, const char *name, u32 direction,
		       struct cm_channel **where)
{
	struct cm_channel_config config = {
		.name = name,
		.direction = direction,
		.type = CM_DMA_TYPE_AXIDMA,
		.queue_depth = 1,
	};
	struct cm_channel *channel = cm_channel_create(icap->dev, &config);
	int ret;

	if (IS_ERR(channel))
		return dev_err_probe(icap->dev, PTR_ERR(channel), "no DMA channel \"%s\"\n",
				     name);
	/* one reference for open files, which outlive the device */
	*where = cm_channel_get(channel);
	ret = devm_add_action_or_reset(icap->dev, remove_channel, channel);
	return ret ?: cm_channel_claim(channel);
}

/* a port may have a way back, by which it can be read */
static int add_channels(struct cm_icap *icap)
{
	int ret = add_channel(icap, "icap", CM_DMA_MM2S, &icap->channel);

	if (ret || device_property_match_string(icap->dev, "dma-names", "rx") < 0)
		return ret;
	ret = add_channel(icap, "rx", CM_DMA_S2MM, &icap->back);
	if (ret)
		return ret;
	/* buffers have addresses for one device */
	if (icap->back->dma_dev != icap->channel->dma_dev)
		return dev_err_probe(icap->dev, -EINVAL, "\"rx\" is not of \"icap\"'s engine\n");
	icap->info.caps |= CM_ICAP_CAP_READ;
	return 0;
}

/* bounded by the port's own timeout */
static void await_idle(struct cm_icap *icap)
{
	wait_event(icap->idle, READ_ONCE(icap->status.state) != CM_ICAP_STATE_LOADING);
}

/* a load under way ends first; then nothing can be started any more */
static void end_loads(struct cm_icap *icap)
{
	mutex_lock(&icap->lock);
	WRITE_ONCE(icap->gone, true);
	mutex_unlock(&icap->lock);
	wake_up_all(&icap->idle);
	await_idle(icap);
}

static void stop(void *data)
{
	struct cm_icap *icap = data;

	end_loads(icap);
	destroy_workqueue(icap->queue);
}

/* not the system's: a load may take long */
static int add_queue(struct cm_icap *icap)
{
	icap->queue = alloc_workqueue("%s", WQ_UNBOUND, 1, icap->name);
	if (!icap->queue)
		return -ENOMEM;
	return devm_add_action_or_reset(icap->dev, stop, icap);
}

static void disable_clock(void *clock)
{
	clk_disable_unprepare(clock);
}

static int add_clock(struct cm_icap *icap)
{
	struct clk *clock = devm_clk_get_optional(icap->dev, NULL);
	int ret;

	if (IS_ERR(clock))
		return dev_err_probe(icap->dev, PTR_ERR(clock), "its clock cannot be had\n");
	ret = clk_prepare_enable(clock);
	if (ret)
		return ret;
	icap->info.clock_hz = clk_get_rate(clock);
	return devm_add_action_or_reset(icap->dev, disable_clock, clock);
}

static int read_properties(struct cm_icap *icap, struct platform_device *pdev)
{
	const struct cm_icap_platform_data *data = dev_get_platdata(icap->dev);
	u32 max_length = CM_ICAP_MAX_LENGTH;

	icap->timeout_ms = CM_ICAP_TIMEOUT_MS;
	device_property_read_u32(icap->dev, "fpga-cm,timeout-ms", &icap->timeout_ms);
	device_property_read_u32(icap->dev, "fpga-cm,max-length", &max_length);
	device_property_read_u32(icap->dev, "fpga-cm,idcode", &icap->info.idcode);
	if (!icap->timeout_ms || icap->timeout_ms > CM_ICAP_TIMEOUT_MAX_MS)
		return dev_err_probe(icap->dev, -EINVAL, "fpga-cm,timeout-ms must be 1 to %u\n",
				     CM_ICAP_TIMEOUT_MAX_MS);
	if (data)
		icap->port = *data;
	icap->full = icap->port.full;
	icap->info.word_bits = 32;
	icap->info.max_length = round_down(max_length, 4);
	if (platform_get_resource(pdev, IORESOURCE_MEM, 0)) {
		icap->status_register = devm_platform_ioremap_resource(pdev, 0);
		if (IS_ERR(icap->status_register))
			return PTR_ERR(icap->status_register);
	}
	if (cm_icap_has_status(icap))
		icap->info.caps |= CM_ICAP_CAP_STATUS;
	return 0;
}

static void remove_node(void *misc)
{
	misc_deregister(misc);
}

static int add_node(struct cm_icap *icap)
{
	int ret;

	icap->misc.minor = MISC_DYNAMIC_MINOR;
	icap->misc.name = icap->name;
	icap->misc.fops = &cm_icap_fops;
	icap->misc.parent = icap->dev;
	ret = misc_register(&icap->misc);
	return ret ?: devm_add_action_or_reset(icap->dev, remove_node, &icap->misc);
}

static int cm_icap_probe(struct platform_device *pdev)
{
	struct cm_icap *icap = icap_new(&pdev->dev);
	int ret;

	if (!icap)
		return -ENOMEM;
	platform_set_drvdata(pdev, icap);
	ret = devm_add_action_or_reset(&pdev->dev, put_icap, icap);
	if (!ret)
		ret = read_properties(icap, pdev);
	if (!ret)
		ret = cm_icap_select_init(icap);
	if (!ret)
		ret = add_clock(icap);
	if (!ret)
		ret = cm_icap_bridges_init(icap);
	if (!ret)
		ret = add_channels(icap);
	if (!ret)
		ret = add_queue(icap);
	if (!ret)
		ret = cm_icap_manager_init(icap);
	return ret ?: add_node(icap);
}

/*
 * The engine and memory are there until this returns.  Who could start another
 * load is frozen.
 */
static int __maybe_unused cm_icap_suspend(struct device *dev)
{
	await_idle(dev_get_drvdata(dev));
	return 0;
}

/* a half-written configuration would be the next kernel's */
static void cm_icap_shutdown(struct platform_device *pdev)
{
	struct cm_icap *icap = platform_get_drvdata(pdev);

	end_loads(icap);
	cm_channel_shutdown(icap->channel);
	if (icap->back)
		cm_channel_shutdown(icap->back);
}

static SIMPLE_DEV_PM_OPS(cm_icap_pm, cm_icap_suspend, NULL);

static const struct of_device_id cm_icap_of_match[] = {
	{ .compatible = "fpga-cm,icap-loader" },
	{}
};
MODULE_DEVICE_TABLE(of, cm_icap_of_match);

static const struct platform_device_id cm_icap_platform_ids[] = {
	{ .name = "cm_icap" },
	{}
};
MODULE_DEVICE_TABLE(platform, cm_icap_platform_ids);

static struct platform_driver cm_icap_driver = {
	.probe = cm_icap_probe,
	.shutdown = cm_icap_shutdown,
	.id_table = cm_icap_platform_ids,
	.driver = {
		.name = "cm_icap",
		.of_match_table = cm_icap_of_match,
		.pm = &cm_icap_pm,
	},
};

module_platform_driver(cm_icap_driver);

MODULE_DESCRIPTION("Partial reconfiguration through a DMA-fed configuration port");
MODULE_VERSION(CM_VERSION);
MODULE_LICENSE("GPL");
CM_IMPORT_CORE;
