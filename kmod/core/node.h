/* SPDX-License-Identifier: GPL-2.0-only */
/* /dev/cm_dma/<name> */
#ifndef _CM_NODE_PRIVATE_H
#define _CM_NODE_PRIVATE_H

#include <linux/cdev.h>
#include <linux/device.h>

#include "cm_core.h"

/**
 * struct cm_node - the character device of a channel
 * @dev: /dev/cm_dma/<name>
 * @cdev: its file operations
 * @channel: channel; a reference is held
 * @debugfs: its statistics
 * @siblings: in the list of all nodes
 */
struct cm_node {
	struct device dev;
	struct cdev cdev;
	struct cm_channel *channel;
	struct dentry *debugfs;
	struct list_head siblings;
};

int cm_nodes_init(void);
void cm_nodes_exit(void);
struct cm_node *cm_node_add(struct device *parent, struct cm_channel *channel);
void cm_node_remove(struct cm_node *node);
void cm_nodes_shutdown(const struct device *parent);

extern const struct file_operations cm_dma_fops;

#endif /* _CM_NODE_PRIVATE_H */
