// SPDX-License-Identifier: GPL-2.0-only
/*
 * Channels as device trees written for xilinx_axidma describe them:
 *
 *	axidma_chrdev: axidma_chrdev@0 {
 *		compatible = "xlnx,axidma-chrdev";
 *		dmas = <&axi_dma_0 0 &axi_dma_0 1>;
 *		dma-names = "tx_channel", "rx_channel";
 *	};
 *
 * A child of the engine's node says by its compatible string what a channel is,
 * and by its xlnx,device-id the channel's number.  The cell of dmas is 0 for
 * the MM2S and 1 for the S2MM channel, as xilinx_dma numbers them, whether the
 * engine has both or not; or it is the child's reg, where there is one.  The
 * order of the children says nothing: in an overlay it is turned round.
 */
#include <linux/mod_devicetable.h>
#include <linux/mutex.h>
#include <linux/of.h>
#include <linux/platform_device.h>
#include <linux/property.h>

#include "axidma.h"
#include "cm_compat.h"

#define AXIDMA_QUEUE_DEPTH 64

/**
 * struct axidma_tree - the channels of a device
 * @count: channels
 * @ids: their numbers
 * @channels: channels; removed with the device
 */
struct axidma_tree {
	int count;
	u32 ids[AXIDMA_CHANNELS_MAX];
	struct cm_channel *channels[AXIDMA_CHANNELS_MAX];
};

static DEFINE_MUTEX(tree_lock); /* protects tree */
static struct axidma_tree *tree;

static const struct {
	const char *compatible;
	u32 direction;
	u32 type;
} kinds[] = {
	{ "xlnx,axi-dma-mm2s-channel", CM_DMA_MM2S, CM_DMA_TYPE_AXIDMA },
	{ "xlnx,axi-dma-s2mm-channel", CM_DMA_S2MM, CM_DMA_TYPE_AXIDMA },
	{ "xlnx,axi-vdma-mm2s-channel", CM_DMA_MM2S, CM_DMA_TYPE_VDMA },
	{ "xlnx,axi-vdma-s2mm-channel", CM_DMA_S2MM, CM_DMA_TYPE_VDMA },
};

static int read_kind(struct device_node *node, struct cm_channel_config *config)
{
	int i;

	for (i = 0; i < ARRAY_SIZE(kinds); i++) {
		if (of_device_is_compatible(node, kinds[i].compatible)) {
			config->direction = kinds[i].direction;
			config->type = kinds[i].type;
			return 0;
		}
	}
	return -EINVAL;
}

static bool is_meant(struct device_node *node, u32 cell, bool alone)
{
	struct cm_channel_config config;
	u32 reg;

	if (!of_property_read_u32(node, "reg", &reg))
		return reg == cell;
	if (read_kind(node, &config))
		return false;
	return alone || (config.direction == CM_DMA_MM2S && cell == 0) ||
	       (config.direction == CM_DMA_S2MM && cell == 1);
}

/* the caller gives the node back */
static struct device_node *find_child(struct device_node *parent, u32 cell)
{
	bool alone = of_get_child_count(parent) == 1;
	struct device_node *child;

	for_each_child_of_node(parent, child) {
		if (is_meant(child, cell, alone))
			return child;
	}
	return NULL;
}

static struct device_node *channel_node(struct device *dev, int index)
{
	struct device_node *node = NULL;
	struct of_phandle_args args;

	if (of_parse_phandle_with_args(dev->of_node, "dmas", "#dma-cells", index, &args))
		return NULL;
	if (args.args_count)
		node = find_child(args.np, args.args[0]);
	of_node_put(args.np);
	return node;
}

static int read_channel(struct device *dev, int index, struct cm_channel_config *config, u32 *id)
{
	struct device_node *node = channel_node(dev, index);
	int ret;

	if (!node)
		return dev_err_probe(dev, -EINVAL, "dmas %d names no channel's node\n", index);
	ret = read_kind(node, config);
	if (ret)
		dev_err_probe(dev, ret, "%pOF is not a channel of an AXI DMA or VDMA\n", node);
	else
		ret = of_property_read_u32(node, "xlnx,device-id", id);
	if (ret)
		dev_err_probe(dev, ret, "%pOF: what it is, or its xlnx,device-id, cannot be read\n",
			      node);
	of_node_put(node);
	return ret;
}

static int check_id(struct device *dev, const struct axidma_tree *self, u32 id)
{
	int i;

	if (id > INT_MAX)
		return dev_err_probe(dev, -EINVAL, "xlnx,device-id %u cannot be\n", id);
	for (i = 0; i < self->count; i++) {
		if (self->ids[i] == id)
			return dev_err_probe(dev, -EINVAL, "two channels have xlnx,device-id %u\n",
					     id);
	}
	return 0;
}

static void remove_channel(void *channel)
{
	cm_channel_remove(channel);
}

static int add_channel(struct device *dev, struct axidma_tree *self, const char *name)
{
	struct cm_channel_config config = { .name = name, .queue_depth = AXIDMA_QUEUE_DEPTH };
	struct cm_channel *channel;
	u32 id;
	int ret = read_channel(dev, self->count, &config, &id);

	if (!ret)
		ret = check_id(dev, self, id);
	if (ret)
		return ret;
	channel = cm_channel_create(dev, &config);
	if (IS_ERR(channel))
		return dev_err_probe(dev, PTR_ERR(channel), "no DMA channel \"%s\"\n", name);
	ret = devm_add_action_or_reset(dev, remove_channel, channel);
	if (ret)
		return ret;
	self->ids[self->count] = id;
	self->channels[self->count++] = channel;
	return 0;
}

static void withdraw(void *unused)
{
	mutex_lock(&tree_lock);
	tree = NULL;
	mutex_unlock(&tree_lock);
}

/* there is one /dev/axidma */
static int offer(struct device *dev, struct axidma_tree *self)
{
	int ret = 0;

	mutex_lock(&tree_lock);
	if (tree)
		ret = -EBUSY;
	else
		tree = self;
	mutex_unlock(&tree_lock);
	if (ret)
		return dev_err_probe(dev, ret, "another node describes /dev/axidma\n");
	return devm_add_action_or_reset(dev, withdraw, NULL);
}

static int axidma_probe(struct platform_device *pdev)
{
	const char *names[AXIDMA_CHANNELS_MAX];
	struct device *dev = &pdev->dev;
	struct axidma_tree *self = devm_kzalloc(dev, sizeof(*self), GFP_KERNEL);
	int count = of_property_count_strings(dev->of_node, "dma-names");
	int i, ret = 0;

	if (!self)
		return -ENOMEM;
	if (count <= 0 || count > AXIDMA_CHANNELS_MAX ||
	    count != of_count_phandle_with_args(dev->of_node, "dmas", "#dma-cells"))
		return dev_err_probe(dev, -EINVAL, "dmas and dma-names must be 1 to %d pairs\n",
				     AXIDMA_CHANNELS_MAX);
	count = device_property_read_string_array(dev, "dma-names", names, count);
	for (i = 0; !ret && i < count; i++)
		ret = add_channel(dev, self, names[i]);
	return ret ?: offer(dev, self);
}

/**
 * axidma_tree_channel() - a channel that a device tree describes
 * @index: from 0
 * @id: its number, filled in
 *
 * Return: the channel with a reference for the caller, or NULL at the end, or
 * where no device tree describes any.
 */
struct cm_channel *axidma_tree_channel(int index, int *id)
{
	struct cm_channel *channel = NULL;

	mutex_lock(&tree_lock);
	if (tree && index < tree->count) {
		channel = cm_channel_get(tree->channels[index]);
		*id = tree->ids[index];
	}
	mutex_unlock(&tree_lock);
	return channel;
}

static const struct of_device_id axidma_of_match[] = {
	{ .compatible = "xlnx,axidma-chrdev" },
	{}
};
MODULE_DEVICE_TABLE(of, axidma_of_match);

static void axidma_shutdown(struct platform_device *pdev)
{
	int i;

	mutex_lock(&tree_lock);
	for (i = 0; tree && i < tree->count; i++)
		cm_channel_shutdown(tree->channels[i]);
	mutex_unlock(&tree_lock);
}

struct platform_driver axidma_driver = {
	.probe = axidma_probe,
	.shutdown = axidma_shutdown,
	.driver = {
		.name = "cm_axidma_compat",
		.of_match_table = axidma_of_match,
	},
};
