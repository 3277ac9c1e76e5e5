// SPDX-License-Identifier: GPL-2.0-only
/*
 * cm_clock: clocks that a design needs, as files.
 *
 * The clock framework sets rates and opens gates for drivers alone.  A node
 * fpga-cm,clocks is the consumer of the clocks that no driver of the PL takes:
 * /sys/class/cm_clock/<name>/rate, round and enable, <name> out of clock-names.
 */
#include <linux/clk.h>
#include <linux/device.h>
#include <linux/mod_devicetable.h>
#include <linux/module.h>
#include <linux/mutex.h>
#include <linux/of.h>
#include <linux/platform_device.h>
#include <linux/slab.h>
#include <linux/sysfs.h>

#include "cm_compat.h"

/**
 * struct cm_clock - one clock
 * @dev: in the class
 * @clk: clock; its consumer's, which outlives @dev
 * @lock: protects @on
 * @on: held running by this module
 * @rounded: what the clock would make of the rate that was last asked about
 */
struct cm_clock {
	struct device dev;
	struct clk *clk;
	struct mutex lock; /* protects on */
	bool on;
	unsigned long rounded;
};

static struct cm_clock *to_clock(struct device *dev)
{
	return container_of(dev, struct cm_clock, dev);
}

static ssize_t rate_show(struct device *dev, struct device_attribute *attribute, char *to)
{
	return sysfs_emit(to, "%lu\n", clk_get_rate(to_clock(dev)->clk));
}

/* the clock takes the nearest rate that it can have, and tells it when it is read */
static ssize_t rate_store(struct device *dev, struct device_attribute *attribute, const char *from,
			  size_t count)
{
	unsigned long rate;
	int ret = kstrtoul(from, 10, &rate);

	if (!ret && !rate)
		ret = -EINVAL;
	if (!ret)
		ret = clk_set_rate(to_clock(dev)->clk, rate);
	return ret ?: count;
}
static DEVICE_ATTR_RW(rate);

/* what a rate would become, with nothing set */
static ssize_t round_show(struct device *dev, struct device_attribute *attribute, char *to)
{
	return sysfs_emit(to, "%lu\n", READ_ONCE(to_clock(dev)->rounded));
}

static ssize_t round_store(struct device *dev, struct device_attribute *attribute,
			   const char *from, size_t count)
{
	unsigned long rate;
	long rounded;
	int ret = kstrtoul(from, 10, &rate);

	if (ret)
		return ret;
	rounded = clk_round_rate(to_clock(dev)->clk, rate);
	if (rounded < 0)
		return rounded;
	WRITE_ONCE(to_clock(dev)->rounded, rounded);
	return count;
}
static DEVICE_ATTR_RW(round);

static ssize_t enable_show(struct device *dev, struct device_attribute *attribute, char *to)
{
	return sysfs_emit(to, "%d\n", READ_ONCE(to_clock(dev)->on));
}

static int switch_clock(struct cm_clock *clock, bool on)
{
	int ret = 0;

	mutex_lock(&clock->lock);
	if (on && !clock->on)
		ret = clk_prepare_enable(clock->clk);
	else if (!on && clock->on)
		clk_disable_unprepare(clock->clk);
	if (!ret)
		WRITE_ONCE(clock->on, on);
	mutex_unlock(&clock->lock);
	return ret;
}

static ssize_t enable_store(struct device *dev, struct device_attribute *attribute,
			    const char *from, size_t count)
{
	bool on;
	int ret = kstrtobool(from, &on);

	if (!ret)
		ret = switch_clock(to_clock(dev), on);
	return ret ?: count;
}
static DEVICE_ATTR_RW(enable);

static struct attribute *cm_clock_attrs[] = {
	&dev_attr_rate.attr,
	&dev_attr_round.attr,
	&dev_attr_enable.attr,
	NULL,
};
ATTRIBUTE_GROUPS(cm_clock);

static struct class cm_clock_class = {
	.name = "cm_clock",
	.dev_groups = cm_clock_groups,
};

static void clock_release(struct device *dev)
{
	struct cm_clock *clock = to_clock(dev);

	mutex_destroy(&clock->lock);
	kfree(clock);
}

static void clock_remove(void *data)
{
	struct cm_clock *clock = data;

	/* waits until no process is in one of the files */
	device_del(&clock->dev);
	switch_clock(clock, false);
	put_device(&clock->dev);
}

static bool name_free(const char *name)
{
	struct device *other = class_find_device_by_name(&cm_clock_class, name);

	put_device(other);
	return !other;
}

static int clock_add(struct device *parent, const char *name)
{
	struct clk *clk = devm_clk_get(parent, name);
	struct cm_clock *clock;
	int ret;

	if (IS_ERR(clk))
		return dev_err_probe(parent, PTR_ERR(clk), "no clock \"%s\"\n", name);
	if (strchr(name, '/') || !name_free(name))
		return dev_err_probe(parent, -EEXIST, "\"%s\" is not a name, or another's\n", name);
	clock = kzalloc(sizeof(*clock), GFP_KERNEL);
	if (!clock)
		return -ENOMEM;
	clock->clk = clk;
	mutex_init(&clock->lock);
	device_initialize(&clock->dev);
	clock->dev.class = &cm_clock_class;
	clock->dev.parent = parent;
	clock->dev.release = clock_release;
	ret = dev_set_name(&clock->dev, "%s", name);
	if (!ret)
		ret = device_add(&clock->dev);
	if (ret) {
		put_device(&clock->dev);
		return ret;
	}
	return devm_add_action_or_reset(parent, clock_remove, clock);
}

static int cm_clock_probe(struct platform_device *pdev)
{
	struct device *dev = &pdev->dev;
	struct property *property;
	const char *name;
	int ret = 0, count = 0;

	of_property_for_each_string(dev->of_node, "clock-names", property, name) {
		ret = clock_add(dev, name);
		if (ret)
			return ret;
		count++;
	}
	return count ? 0 : dev_err_probe(dev, -EINVAL, "clock-names is missing\n");
}

static const struct of_device_id cm_clock_of_match[] = {
	{ .compatible = "fpga-cm,clocks" },
	{}
};
MODULE_DEVICE_TABLE(of, cm_clock_of_match);

static struct platform_driver cm_clock_driver = {
	.probe = cm_clock_probe,
	.driver = {
		.name = "cm_clock",
		.of_match_table = cm_clock_of_match,
	},
};

static int __init cm_clock_init(void)
{
	int ret = class_register(&cm_clock_class);

	if (ret)
		return ret;
	ret = platform_driver_register(&cm_clock_driver);
	if (ret)
		class_unregister(&cm_clock_class);
	return ret;
}
module_init(cm_clock_init);

static void __exit cm_clock_exit(void)
{
	platform_driver_unregister(&cm_clock_driver);
	class_unregister(&cm_clock_class);
}
module_exit(cm_clock_exit);

MODULE_DESCRIPTION("Rates and gates of the programmable logic's clocks");
MODULE_VERSION(CM_VERSION);
MODULE_LICENSE("GPL");
