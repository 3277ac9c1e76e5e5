// SPDX-License-Identifier: GPL-2.0-only
/*
 * A node with registers, and an interrupt where it has one: a UIO device for
 * the configuration manager, windows for those to whom it lends pages, and a
 * bridge that takes the pages back before it decouples.
 */
#include <linux/debugfs.h>
#include <linux/interrupt.h>
#include <linux/io.h>
#include <linux/irq.h>
#include <linux/list.h>
#include <linux/mod_devicetable.h>
#include <linux/of.h>
#include <linux/platform_device.h>
#include <linux/property.h>
#include <linux/slab.h>
#include <linux/spinlock.h>
#include <linux/srcu.h>
#include <linux/uio_driver.h>
#include <linux/workqueue.h>

#include "cm_compat.h"
#include "cm_fpga_compat.h"
#include "window.h"

/**
 * struct cm_window_device - one node
 * @dev: platform device
 * @info: UIO's part
 * @lock: protects @masked
 * @masked: the interrupt came, or was switched off
 * @windows: one for each of its ranges
 * @count: how many these are
 * @read_back: a register that may be read at any time, or NULL
 */
struct cm_window_device {
	struct device *dev;
	struct uio_info info;
	spinlock_t lock; /* protects masked */
	bool masked;
	struct cm_window *windows[MAX_UIO_MAPS];
	int count;
	void __iomem *read_back;
};

/* level interrupts stay until what caused them is acknowledged: masked until user space says 1 */
static irqreturn_t window_interrupt(int irq, struct uio_info *info)
{
	struct cm_window_device *self = info->priv;

	spin_lock(&self->lock);
	if (!self->masked) {
		self->masked = true;
		disable_irq_nosync(irq);
	}
	spin_unlock(&self->lock);
	return IRQ_HANDLED;
}

static int window_irqcontrol(struct uio_info *info, s32 on)
{
	struct cm_window_device *self = info->priv;
	unsigned long flags;

	spin_lock_irqsave(&self->lock, flags);
	if (on && self->masked)
		enable_irq(info->irq);
	else if (!on && !self->masked)
		disable_irq_nosync(info->irq);
	self->masked = !on;
	spin_unlock_irqrestore(&self->lock, flags);
	return 0;
}

static int find_interrupt(struct cm_window_device *self, struct platform_device *pdev)
{
	int irq = platform_get_irq_optional(pdev, 0);

	if (irq == -ENXIO) {
		self->info.irq = UIO_IRQ_NONE;
		return 0;
	}
	if (irq < 0)
		return dev_err_probe(self->dev, irq, "its interrupt cannot be had\n");
	/* mask it at once, not when the next one has come: it is level-triggered */
	if (irqd_get_trigger_type(irq_get_irq_data(irq)) & IRQ_TYPE_LEVEL_MASK)
		irq_set_status_flags(irq, IRQ_DISABLE_UNLAZY);
	self->info.irq = irq;
	self->info.handler = window_interrupt;
	self->info.irqcontrol = window_irqcontrol;
	return 0;
}

static unsigned long physical_pfn(void *context, unsigned long page)
{
	struct resource *range = context;

	return PHYS_PFN(range->start) + page;
}

static void unregister_window(void *window)
{
	cm_window_unregister(window);
}

/* pages in which another driver has registers are not lent: a mapping knows no registers */
static int add_window(struct cm_window_device *self, struct resource *range)
{
	struct uio_mem *map = &self->info.mem[self->count];
	struct cm_window_config config = {
		.address = range->start,
		.length = resource_size(range),
		.pfn = physical_pfn,
		.context = range,
	};
	struct cm_window *window;

	if (device_property_read_bool(self->dev, "fpga-cm,shared") ||
	    !devm_request_mem_region(self->dev, range->start, resource_size(range),
				     dev_name(self->dev)))
		config.refusal = -EPERM;
	window = cm_window_register(&config);
	if (IS_ERR(window))
		return dev_err_probe(self->dev, PTR_ERR(window), "%pR is another window's\n",
				     range);
	map->memtype = UIO_MEM_PHYS;
	map->addr = range->start & PAGE_MASK;
	map->offs = range->start & ~PAGE_MASK;
	map->size = PAGE_ALIGN(map->offs + resource_size(range));
	map->name = range->name;
	self->windows[self->count++] = window;
	return devm_add_action_or_reset(self->dev, unregister_window, window);
}

static int add_ranges(struct cm_window_device *self, struct platform_device *pdev)
{
	struct resource *range;
	int ret = 0;

	while (!ret && (range = platform_get_resource(pdev, IORESOURCE_MEM, self->count))) {
		if (self->count == MAX_UIO_MAPS)
			return dev_err_probe(self->dev, -EINVAL, "more than %d ranges\n",
					     MAX_UIO_MAPS);
		ret = add_window(self, range);
	}
	if (!self->count)
		return dev_err_probe(self->dev, -EINVAL, "no registers\n");
	return ret;
}

static int find_read_back(struct cm_window_device *self, struct platform_device *pdev)
{
	struct resource *range = platform_get_resource(pdev, IORESOURCE_MEM, 0);
	u32 offset;

	if (device_property_read_u32(self->dev, "fpga-cm,read-back", &offset))
		return 0;
	if (offset & 3 || offset + sizeof(u32) > resource_size(range))
		return dev_err_probe(self->dev, -EINVAL, "fpga-cm,read-back %#x is no register\n",
				     offset);
	self->read_back = devm_ioremap(self->dev, range->start + offset, sizeof(u32));
	return self->read_back ? 0 : -ENOMEM;
}

#if IS_REACHABLE(CONFIG_FPGA_BRIDGE)
/*
 * Its decoupler, where it has one; the holder of a bridge holds a mutex, so for one call.
 * Looked for when it is needed: a probe that is deferred leaves the node to
 * uio_pdrv_genirq.  Where it is not there, what asked for the bridge fails.
 */
static int with_decoupler(struct cm_window_device *self, int (*call)(struct fpga_bridge *bridge))
{
	struct device_node *node = of_parse_phandle(self->dev->of_node, "fpga-bridges", 0);
	struct fpga_bridge *bridge;
	int ret;

	if (!node)
		return 0;
	bridge = of_fpga_bridge_get(node, NULL);
	of_node_put(node);
	if (IS_ERR(bridge)) {
		dev_err(self->dev, "its decoupler cannot be had (%ld)\n", PTR_ERR(bridge));
		return PTR_ERR(bridge);
	}
	ret = call(bridge);
	fpga_bridge_put(bridge);
	return ret;
}

static int shut(struct cm_window_device *self)
{
	int i;

	for (i = 0; i < self->count; i++)
		cm_window_shut(self->windows[i], CM_WINDOW_REVOKED_BRIDGE);
	/* what was written before is behind the port when a read comes back through it */
	if (self->read_back)
		readl(self->read_back);
	return with_decoupler(self, fpga_bridge_disable);
}

static int admit(struct cm_window_device *self)
{
	int i, ret = with_decoupler(self, fpga_bridge_enable);

	for (i = 0; !ret && i < self->count; i++)
		cm_window_admit(self->windows[i]);
	return ret;
}

/* a region calls the bridge that it found, however long ago its device was unbound */
DEFINE_STATIC_SRCU(bridge_calls);

static int window_bridge_set(struct fpga_bridge *bridge, bool enable)
{
	int calls = srcu_read_lock(&bridge_calls);
	struct cm_window_device *self = READ_ONCE(bridge->priv);
	int ret = -ENODEV;

	if (self)
		ret = enable ? admit(self) : shut(self);
	srcu_read_unlock(&bridge_calls, calls);
	return ret;
}

static const struct fpga_bridge_ops window_bridge_ops = {
	.enable_set = window_bridge_set,
};

/*
 * Mainline's fpga_bridges_put() takes a bridge off a region's list after it has
 * given back its reference, so that reference must not be the last one: ours is,
 * and goes when for a second nobody else had one.  Nobody can get a new one.  A
 * region holds this module, too: when it goes, no list has any of them.
 */
struct window_bridge {
	struct fpga_bridge *bridge;
	struct list_head gone;
	bool last; /* at the look before */
};

static atomic_t bridges; /* registered, or not given back yet */
static LIST_HEAD(gone_bridges);
static DEFINE_MUTEX(gone_lock); /* protects gone_bridges */

static void give_back_locked(struct window_bridge *window)
{
	list_del(&window->gone);
	atomic_dec(&bridges);
	put_device(&window->bridge->dev);
	kfree(window);
}

static void give_back_bridges(struct work_struct *work)
{
	struct window_bridge *window, *next;

	mutex_lock(&gone_lock);
	list_for_each_entry_safe(window, next, &gone_bridges, gone) {
		if (window->last)
			give_back_locked(window);
		else
			window->last = kref_read(&window->bridge->dev.kobj.kref) == 1;
	}
	if (!list_empty(&gone_bridges))
		schedule_delayed_work(to_delayed_work(work), HZ);
	mutex_unlock(&gone_lock);
}

static DECLARE_DELAYED_WORK(gone_work, give_back_bridges);

static void unregister_bridge(void *data)
{
	struct window_bridge *window = data;

	WRITE_ONCE(window->bridge->priv, NULL);
	synchronize_srcu(&bridge_calls);
	get_device(&window->bridge->dev);
	fpga_bridge_unregister(window->bridge);
	mutex_lock(&gone_lock);
	list_add_tail(&window->gone, &gone_bridges);
	mutex_unlock(&gone_lock);
	schedule_delayed_work(&gone_work, HZ);
}

static int add_bridge(struct cm_window_device *self)
{
	struct window_bridge *window;
	int ret;

	/* without a decoupler behind it no region names it */
	if (!of_find_property(self->dev->of_node, "fpga-bridges", NULL))
		return 0;
	window = kzalloc(sizeof(*window), GFP_KERNEL);
	if (!window)
		return -ENOMEM;
	window->bridge = cm_fpga_bridge_register(self->dev, dev_name(self->dev),
						 &window_bridge_ops, self);
	if (IS_ERR(window->bridge)) {
		ret = PTR_ERR(window->bridge);
		kfree(window);
		return dev_err_probe(self->dev, ret, "no bridge\n");
	}
	atomic_inc(&bridges);
	return devm_add_action_or_reset(self->dev, unregister_bridge, window);
}

void cm_window_bridges_show(struct dentry *parent)
{
	debugfs_create_atomic_t("bridges", 0444, parent, &bridges);
}

void cm_window_bridges_exit(void)
{
	struct window_bridge *window, *next;

	cancel_delayed_work_sync(&gone_work);
	mutex_lock(&gone_lock);
	list_for_each_entry_safe(window, next, &gone_bridges, gone)
		give_back_locked(window);
	mutex_unlock(&gone_lock);
}
#else
void cm_window_bridges_show(struct dentry *parent)
{
}

void cm_window_bridges_exit(void)
{
}

static int add_bridge(struct cm_window_device *self)
{
	if (!of_find_property(self->dev->of_node, "fpga-bridges", NULL))
		return 0;
	return dev_err_probe(self->dev, -EOPNOTSUPP, "this kernel has no FPGA bridges\n");
}
#endif

static int name_it(struct cm_window_device *self)
{
	if (!device_property_read_string(self->dev, "linux,uio-name", &self->info.name))
		return 0;
	self->info.name = devm_kasprintf(self->dev, GFP_KERNEL, "%pOFn", self->dev->of_node);
	return self->info.name ? 0 : -ENOMEM;
}

static int cm_window_probe(struct platform_device *pdev)
{
	struct device *dev = &pdev->dev;
	struct cm_window_device *self = devm_kzalloc(dev, sizeof(*self), GFP_KERNEL);
	int ret;

	if (!self)
		return -ENOMEM;
	self->dev = dev;
	spin_lock_init(&self->lock);
	self->info.version = CM_VERSION;
	self->info.priv = self;
	ret = name_it(self);
	if (!ret)
		ret = find_interrupt(self, pdev);
	if (!ret)
		ret = add_ranges(self, pdev);
	if (!ret)
		ret = find_read_back(self, pdev);
	if (!ret)
		ret = add_bridge(self);
	if (ret)
		return ret;
	ret = devm_uio_register_device(dev, &self->info);
	return ret ? dev_err_probe(dev, ret, "no UIO device\n") : 0;
}

static const struct of_device_id cm_window_of_match[] = {
	{ .compatible = "fpga-cm,window" },
	{}
};
MODULE_DEVICE_TABLE(of, cm_window_of_match);

struct platform_driver cm_window_driver = {
	.probe = cm_window_probe,
	.driver = {
		.name = "cm_window",
		.of_match_table = cm_window_of_match,
	},
};
