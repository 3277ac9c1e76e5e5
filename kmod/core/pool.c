// SPDX-License-Identifier: GPL-2.0-only
/*
 * Memory that a device tree sets aside for a client (memory-region).
 *
 * The kernel assigns it to a device and takes it away again; memory that is
 * freed after that goes to another allocator than it came from.  So it stays
 * assigned while anybody has some of it: a channel, a buffer, a dma-buf or a
 * mapping, of which each may outlive the driver's binding.
 */
#include <linux/of.h>
#include <linux/of_reserved_mem.h>
#include <linux/slab.h>

#include "cm_core.h"

/**
 * struct cm_pool - a device with memory of its own
 * @ref: one of each channel and buffer
 * @node: in the list of all
 * @dev: device; a reference is held
 */
struct cm_pool {
	struct kref ref;
	struct list_head node;
	struct device *dev;
};

static LIST_HEAD(pools);
static DEFINE_MUTEX(pools_lock); /* protects pools, and the assignments */

static struct cm_pool *find_locked(struct device *dev)
{
	struct cm_pool *pool;

	list_for_each_entry(pool, &pools, node) {
		if (pool->dev == dev)
			return pool;
	}
	return NULL;
}

static struct cm_pool *new_locked(struct device *dev)
{
	struct cm_pool *pool = kzalloc(sizeof(*pool), GFP_KERNEL);
	int ret;

	if (!pool)
		return ERR_PTR(-ENOMEM);
	ret = of_reserved_mem_device_init(dev);
	if (ret) {
		kfree(pool);
		return ERR_PTR(ret);
	}
	kref_init(&pool->ref);
	pool->dev = get_device(dev);
	list_add(&pool->node, &pools);
	return pool;
}

/**
 * cm_pool_assign() - have the memory that a device's node names
 * @dev: client device
 *
 * Where memory of an earlier binding is still in use it is the same pool.
 *
 * Return: a pool for cm_pool_put(), NULL where the node has no memory-region,
 * or an ERR_PTR.
 */
struct cm_pool *cm_pool_assign(struct device *dev)
{
	struct cm_pool *pool;

	if (!of_find_property(dev->of_node, "memory-region", NULL))
		return NULL;
	mutex_lock(&pools_lock);
	pool = find_locked(dev);
	if (pool)
		kref_get(&pool->ref);
	else
		pool = new_locked(dev);
	mutex_unlock(&pools_lock);
	return pool;
}

/**
 * cm_pool_get() - keep a device's own memory assigned
 * @dev: device that is allocated against
 *
 * Return: a pool for cm_pool_put(), or NULL where @dev has none.
 */
struct cm_pool *cm_pool_get(struct device *dev)
{
	struct cm_pool *pool;

	mutex_lock(&pools_lock);
	pool = find_locked(dev);
	if (pool)
		kref_get(&pool->ref);
	mutex_unlock(&pools_lock);
	return pool;
}

static void pool_release(struct kref *ref)
{
	struct cm_pool *pool = container_of(ref, struct cm_pool, ref);

	list_del(&pool->node);
	of_reserved_mem_device_release(pool->dev);
	mutex_unlock(&pools_lock);
	put_device(pool->dev);
	kfree(pool);
}

/**
 * cm_pool_put() - give a reference back; may sleep
 * @pool: pool, or NULL
 */
void cm_pool_put(struct cm_pool *pool)
{
	if (pool)
		kref_put_mutex(&pool->ref, pool_release, &pools_lock);
}
