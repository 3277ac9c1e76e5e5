// SPDX-License-Identifier: GPL-2.0-only
/* The character devices, one for each channel, and the list of channels. */
#include <linux/debugfs.h>
#include <linux/dma-map-ops.h>
#include <linux/fs.h>
#include <linux/idr.h>
#include <linux/slab.h>

#include "cm_compat.h"
#include "node.h"

#define CM_MINORS 256

/* for those who look without opening: opening takes the channel */
static const struct cm_dma_info *info_of(struct device *dev)
{
	return &container_of(dev, struct cm_node, dev)->channel->info;
}

static ssize_t caps_show(struct device *dev, struct device_attribute *attribute, char *to)
{
	static const struct {
		u32 bit;
		const char *word;
	} words[] = {
		{ CM_DMA_CAP_CYCLIC, "cyclic" },
		{ CM_DMA_CAP_VIDEO, "video" },
		{ CM_DMA_CAP_RESIDUE, "residue" },
		{ CM_DMA_CAP_SIMPLE, "simple" },
	};
	ssize_t length = 0;
	int i;

	for (i = 0; i < ARRAY_SIZE(words); i++) {
		if (info_of(dev)->caps & words[i].bit)
			length += sysfs_emit_at(to, length, "%s%s", length ? " " : "",
						words[i].word);
	}
	return length + sysfs_emit_at(to, length, "\n");
}
static DEVICE_ATTR_RO(caps);

static ssize_t max_length_show(struct device *dev, struct device_attribute *attribute, char *to)
{
	return sysfs_emit(to, "%llu\n", info_of(dev)->max_length);
}
static DEVICE_ATTR_RO(max_length);

static ssize_t direction_show(struct device *dev, struct device_attribute *attribute, char *to)
{
	return sysfs_emit(to, "%s\n", info_of(dev)->direction == CM_DMA_MM2S ? "mm2s" : "s2mm");
}
static DEVICE_ATTR_RO(direction);

static ssize_t coherent_show(struct device *dev, struct device_attribute *attribute, char *to)
{
	struct cm_node *node = container_of(dev, struct cm_node, dev);

	return sysfs_emit(to, "%d\n", dev_is_dma_coherent(node->channel->alloc_dev));
}
static DEVICE_ATTR_RO(coherent);

static struct attribute *cm_dma_attrs[] = {
	&dev_attr_caps.attr,
	&dev_attr_max_length.attr,
	&dev_attr_direction.attr,
	&dev_attr_coherent.attr,
	NULL,
};
ATTRIBUTE_GROUPS(cm_dma);

static struct class cm_dma_class = {
	.name = "cm_dma",
	.dev_groups = cm_dma_groups,
};

static DEFINE_IDA(cm_minors);
static DEFINE_MUTEX(cm_nodes_lock);
static LIST_HEAD(cm_nodes);
static dev_t cm_dma_devt;
static struct dentry *cm_debugfs;

static void node_release(struct device *dev)
{
	struct cm_node *node = container_of(dev, struct cm_node, dev);

	ida_free(&cm_minors, MINOR(dev->devt));
	cm_channel_put(node->channel);
	kfree(node);
}

static struct cm_node *find_locked(const char *name)
{
	struct cm_node *node;

	list_for_each_entry(node, &cm_nodes, siblings) {
		if (!strcmp(node->channel->info.name, name))
			return node;
	}
	return NULL;
}

/* kernel-wide: two boards with a channel of the same name cannot be told apart */
static int register_node(struct cm_node *node)
{
	int ret = -EEXIST;

	mutex_lock(&cm_nodes_lock);
	if (!find_locked(node->channel->info.name))
		ret = cdev_device_add(&node->cdev, &node->dev);
	if (!ret)
		list_add_tail(&node->siblings, &cm_nodes);
	mutex_unlock(&cm_nodes_lock);
	return ret;
}

/**
 * cm_node_add() - make /dev/cm_dma/<name>
 * @parent: the client device
 * @channel: channel; the node takes its own reference
 *
 * Return: a node for cm_node_remove(), or an ERR_PTR: -EEXIST for a name that
 * is taken.
 */
struct cm_node *cm_node_add(struct device *parent, struct cm_channel *channel)
{
	struct cm_node *node = kzalloc(sizeof(*node), GFP_KERNEL);
	int minor, ret;

	if (!node)
		return ERR_PTR(-ENOMEM);
	minor = ida_alloc_max(&cm_minors, CM_MINORS - 1, GFP_KERNEL);
	if (minor < 0) {
		kfree(node);
		return ERR_PTR(minor);
	}
	device_initialize(&node->dev);
	node->dev.class = &cm_dma_class;
	node->dev.parent = parent;
	node->dev.devt = MKDEV(MAJOR(cm_dma_devt), minor);
	node->dev.release = node_release;
	node->channel = cm_channel_get(channel);
	cdev_init(&node->cdev, &cm_dma_fops);
	node->cdev.owner = THIS_MODULE;
	/* devtmpfs makes a folder of the exclamation mark */
	ret = dev_set_name(&node->dev, "cm_dma!%s", channel->info.name);
	if (!ret)
		ret = register_node(node);
	if (ret) {
		put_device(&node->dev);
		return ERR_PTR(ret);
	}
	node->debugfs = debugfs_create_dir(channel->info.name, cm_debugfs);
	cm_channel_debugfs(channel, node->debugfs);
	return node;
}

/**
 * cm_node_remove() - take the node away
 * @node: node; open files keep what they need of it
 */
void cm_node_remove(struct cm_node *node)
{
	debugfs_remove_recursive(node->debugfs);
	mutex_lock(&cm_nodes_lock);
	list_del(&node->siblings);
	mutex_unlock(&cm_nodes_lock);
	cdev_device_del(&node->cdev, &node->dev);
	put_device(&node->dev);
}

/**
 * cm_channel_find() - the channel behind /dev/cm_dma/<name>
 * @name: name
 *
 * Return: the channel with a reference for the caller, or NULL.
 */
struct cm_channel *cm_channel_find(const char *name)
{
	struct cm_channel *channel = NULL;
	struct cm_node *node;

	mutex_lock(&cm_nodes_lock);
	node = find_locked(name);
	if (node)
		channel = cm_channel_get(node->channel);
	mutex_unlock(&cm_nodes_lock);
	return channel;
}
EXPORT_SYMBOL_CM(cm_channel_find);

/**
 * cm_channel_next() - go through all channels that have a node
 * @previous: NULL, or the last answer, whose reference stays the caller's
 *
 * Return: the channel after it with a reference for the caller, or NULL at the
 * end, or where @previous is gone.
 */
struct cm_channel *cm_channel_next(struct cm_channel *previous)
{
	struct cm_channel *channel = NULL;
	bool found = !previous;
	struct cm_node *node;

	mutex_lock(&cm_nodes_lock);
	list_for_each_entry(node, &cm_nodes, siblings) {
		if (found) {
			channel = cm_channel_get(node->channel);
			break;
		}
		found = node->channel == previous;
	}
	mutex_unlock(&cm_nodes_lock);
	return channel;
}
EXPORT_SYMBOL_CM(cm_channel_next);

/**
 * cm_nodes_shutdown() - the system goes down
 * @parent: device of the channels to be stopped
 */
void cm_nodes_shutdown(const struct device *parent)
{
	struct cm_node *node;

	mutex_lock(&cm_nodes_lock);
	list_for_each_entry(node, &cm_nodes, siblings) {
		if (node->dev.parent == parent)
			cm_channel_shutdown(node->channel);
	}
	mutex_unlock(&cm_nodes_lock);
}

static int synced_get(void *data, u64 *value)
{
	*value = cm_buffers_synced();
	return 0;
}
DEFINE_DEBUGFS_ATTRIBUTE(synced_fops, synced_get, NULL, "%llu\n");

static int mapped_get(void *data, u64 *value)
{
	*value = cm_buffers_mapped();
	return 0;
}
DEFINE_DEBUGFS_ATTRIBUTE(mapped_fops, mapped_get, NULL, "%llu\n");

static int allocated_get(void *data, u64 *value)
{
	*value = cm_budget_total();
	return 0;
}
DEFINE_DEBUGFS_ATTRIBUTE(allocated_fops, allocated_get, NULL, "%llu\n");

/**
 * cm_nodes_init() - at the module's start
 *
 * Return: 0 or a negative errno.
 */
int cm_nodes_init(void)
{
	int ret = alloc_chrdev_region(&cm_dma_devt, 0, CM_MINORS, "cm_dma");

	if (ret)
		return ret;
	ret = class_register(&cm_dma_class);
	if (ret) {
		unregister_chrdev_region(cm_dma_devt, CM_MINORS);
		return ret;
	}
	cm_debugfs = debugfs_create_dir("cm_dma", NULL);
	debugfs_create_file_unsafe("synced", 0444, cm_debugfs, NULL, &synced_fops);
	debugfs_create_file_unsafe("mapped", 0444, cm_debugfs, NULL, &mapped_fops);
	debugfs_create_file_unsafe("allocated", 0444, cm_debugfs, NULL, &allocated_fops);
	return 0;
}

/**
 * cm_nodes_exit() - at the module's end
 */
void cm_nodes_exit(void)
{
	debugfs_remove_recursive(cm_debugfs);
	class_unregister(&cm_dma_class);
	unregister_chrdev_region(cm_dma_devt, CM_MINORS);
	ida_destroy(&cm_minors);
}
