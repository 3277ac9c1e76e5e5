// SPDX-License-Identifier: GPL-2.0-only
/*
 * cm_dma: DMA channels for user space.
 *
 * A client of the DMA engine framework: any provider serves.  Properties and
 * their meaning are in docs/kernel.md and the bindings.
 */
#include <linux/mod_devicetable.h>
#include <linux/platform_device.h>
#include <linux/property.h>

#include "cm_compat.h"
#include "node.h"

#define CM_QUEUE_DEPTH 64
#define CM_CHANNELS_MAX 64

static void remove_channel(void *channel)
{
	cm_channel_remove(channel);
}

static void remove_node(void *node)
{
	cm_node_remove(node);
}

/* optional array property: one value a channel */
static int per_channel(struct device *dev, const char *property, int index, u32 *value)
{
	u32 values[CM_CHANNELS_MAX];
	int count = device_property_count_u32(dev, property);
	int ret;

	if (count <= 0)
		return 0;
	if (index >= count || count > CM_CHANNELS_MAX)
		return dev_err_probe(dev, -EINVAL, "%s has not one value for each channel\n",
				     property);
	ret = device_property_read_u32_array(dev, property, values, count);
	if (!ret)
		*value = values[index];
	return ret;
}

static int read_config(struct device *dev, int index, struct cm_channel_config *config)
{
	u32 max_length = 0;
	int ret;

	config->type = CM_DMA_TYPE_AXIDMA;
	config->queue_depth = CM_QUEUE_DEPTH;
	ret = per_channel(dev, "fpga-cm,directions", index, &config->direction);
	if (!ret)
		ret = per_channel(dev, "fpga-cm,types", index, &config->type);
	if (!ret)
		ret = per_channel(dev, "fpga-cm,frame-lengths", index, &config->frame_length);
	if (ret)
		return ret;
	if (!config->direction)
		return dev_err_probe(dev, -EINVAL, "fpga-cm,directions is missing\n");
	device_property_read_u32(dev, "fpga-cm,queue-depth", &config->queue_depth);
	device_property_read_u32(dev, "fpga-cm,alignment", &config->alignment);
	device_property_read_u32(dev, "fpga-cm,max-length", &max_length);
	config->max_length = max_length;
	return 0;
}

static int add_channel(struct device *dev, int index, const char *name)
{
	struct cm_channel_config config = { .name = name };
	struct cm_channel *channel;
	struct cm_node *node;
	int ret = read_config(dev, index, &config);

	if (ret)
		return ret;
	channel = cm_channel_create(dev, &config);
	if (IS_ERR(channel))
		return dev_err_probe(dev, PTR_ERR(channel), "no DMA channel \"%s\"\n", name);
	ret = devm_add_action_or_reset(dev, remove_channel, channel);
	if (ret)
		return ret;
	node = cm_node_add(dev, channel);
	if (IS_ERR(node))
		return dev_err_probe(dev, PTR_ERR(node), "no node for channel \"%s\"\n", name);
	return devm_add_action_or_reset(dev, remove_node, node);
}

static int cm_dma_probe(struct platform_device *pdev)
{
	struct device *dev = &pdev->dev;
	const char *names[CM_CHANNELS_MAX];
	int count, i, ret = 0;

	count = device_property_read_string_array(dev, "dma-names", names, CM_CHANNELS_MAX);
	if (count <= 0)
		return dev_err_probe(dev, count ?: -EINVAL, "dma-names cannot be read\n");
	for (i = 0; !ret && i < count; i++)
		ret = add_channel(dev, i, names[i]);
	return ret;
}

static void cm_dma_shutdown(struct platform_device *pdev)
{
	cm_nodes_shutdown(&pdev->dev);
}

static const struct of_device_id cm_dma_of_match[] = {
	{ .compatible = "fpga-cm,dma-client" },
	{}
};
MODULE_DEVICE_TABLE(of, cm_dma_of_match);

static const struct platform_device_id cm_dma_ids[] = {
	{ .name = "cm_dma" },
	{}
};
MODULE_DEVICE_TABLE(platform, cm_dma_ids);

static struct platform_driver cm_dma_driver = {
	.probe = cm_dma_probe,
	.shutdown = cm_dma_shutdown,
	.id_table = cm_dma_ids,
	.driver = {
		.name = "cm_dma",
		.of_match_table = cm_dma_of_match,
	},
};

static int __init cm_dma_init(void)
{
	int ret = cm_buffers_init();

	if (ret)
		return ret;
	ret = cm_nodes_init();
	if (ret)
		goto no_nodes;
	ret = platform_driver_register(&cm_dma_driver);
	if (ret)
		goto no_driver;
	return 0;

no_driver:
	cm_nodes_exit();
no_nodes:
	cm_buffers_exit();
	return ret;
}
module_init(cm_dma_init);

static void __exit cm_dma_exit(void)
{
	platform_driver_unregister(&cm_dma_driver);
	cm_nodes_exit();
	cm_buffers_exit();
}
module_exit(cm_dma_exit);

MODULE_DESCRIPTION("DMA channels for user space, by buffer handle");
MODULE_VERSION(CM_VERSION);
MODULE_LICENSE("GPL");
CM_IMPORT_DMA_BUF;
