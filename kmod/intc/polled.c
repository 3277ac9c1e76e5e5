// SPDX-License-Identifier: GPL-2.0-only
/*
 * Interrupts of cores whose interrupt output is connected to nothing: an
 * interrupt controller whose lines are found by a timer, so that a driver which
 * knows interrupts alone, as xilinx_dma, needs no change.
 *
 * A line is a status word of the core (reg) with bits that say "pending" and
 * bits that say "at rest".  A word is read only between the moment when somebody
 * said that something was begun,
 *
 *	irq_set_irqchip_state(irq, IRQCHIP_STATE_PENDING, true),
 *
 * and the look that finds the core at rest; and never while the line is masked
 * or after the same call with false.  At rest there is no timer: a PL that is
 * loaded, or whose clock stands, is not read, which would hang the bus.
 */
#include <linux/hrtimer.h>
#include <linux/interrupt.h>
#include <linux/io.h>
#include <linux/irqdomain.h>
#include <linux/of.h>
#include <linux/platform_device.h>
#include <linux/slab.h>
#include <linux/sysfs.h>

#include "cm_compat.h"
#include "intc.h"

#define LINES_MAX 32
#define PERIOD_LEAST_US 10
#define PERIOD_MOST_US 1000000
#define SOON_US 20

static unsigned int period_us = 500;

static int period_set(const char *text, const struct kernel_param *param)
{
	return param_set_uint_minmax(text, param, PERIOD_LEAST_US, PERIOD_MOST_US);
}

static const struct kernel_param_ops period_ops = {
	.set = period_set,
	.get = param_get_uint,
};
module_param_cb(period_us, &period_ops, &period_us, 0644);
MODULE_PARM_DESC(period_us, "polled controllers that come: most microseconds between two looks (500)");

/**
 * struct polled_line - one interrupt
 * @status: word that tells it
 * @watched: unmasked
 * @busy: something was begun, and was not found at rest since
 * @rested: the last look found the core at rest
 * @began: when something was begun, or last happened
 */
struct polled_line {
	void __iomem *status;
	bool watched;
	bool busy;
	bool rested;
	ktime_t began;
};

/**
 * struct polled_intc - a controller
 * @base: its lines, which are levels
 * @lock: protects @timer, @next, @gone, @looks and the lines; inside the lock of a descriptor
 * @timer: looks
 * @next: when, while @timer is queued
 * @gone: no more looks
 * @period_us: most microseconds between two of them
 * @pending: bits of a status word with which the line's handlers run
 * @idle: bits of which one says that nothing is under way
 * @looks: words read
 * @lines: what each line tells
 */
struct polled_intc {
	struct cm_intc base;
	raw_spinlock_t lock; /* protects timer, next, gone, looks and lines */
	struct hrtimer timer;
	ktime_t next;
	bool gone;
	u32 period_us;
	u32 pending;
	u32 idle;
	u64 looks;
	struct polled_line lines[LINES_MAX];
};

/* never puts off a look, however often something is begun */
static void look_by(struct polled_intc *intc, ktime_t when)
{
	if (intc->gone || (hrtimer_is_queued(&intc->timer) && !ktime_before(when, intc->next)))
		return;
	intc->next = when;
	hrtimer_start(&intc->timer, when, HRTIMER_MODE_ABS_HARD);
}

/* soon, and the longer it lasts the later: found at most an eighth of its time too late */
static void look_again(struct polled_intc *intc, const struct polled_line *line, ktime_t now)
{
	u64 most = READ_ONCE(intc->period_us);
	u64 least = min_t(u64, SOON_US, most);
	u64 us = clamp_t(u64, ktime_us_delta(now, line->began) / 8, least, most);

	look_by(intc, ktime_add_us(now, us));
}

/*
 * Whether the handlers are to run.  Their end unmasks the line, which looks
 * again.  An engine may be at rest a few clocks before it says why, so that two
 * looks in a row have to find it so.
 */
static bool look(struct polled_intc *intc, struct polled_line *line, ktime_t now)
{
	u32 word = readl(line->status);

	intc->looks++;
	if (word & intc->pending) {
		line->began = now;
		line->rested = false;
		return true;
	}
	line->busy = !(word & intc->idle && line->rested);
	line->rested = word & intc->idle;
	if (line->busy)
		look_again(intc, line, now);
	return false;
}

static enum hrtimer_restart fire(struct hrtimer *timer)
{
	struct polled_intc *intc = container_of(timer, struct polled_intc, timer);
	ktime_t now = ktime_get();
	unsigned long due = 0;
	u32 i;

	raw_spin_lock(&intc->lock);
	for (i = 0; i < intc->base.count; i++) {
		struct polled_line *line = &intc->lines[i];

		if (line->watched && line->busy && look(intc, line, now))
			due |= BIT(i);
	}
	raw_spin_unlock(&intc->lock);
	for_each_set_bit(i, &due, intc->base.count)
		generic_handle_domain_irq(intc->base.domain, i);
	return HRTIMER_NORESTART;
}

static struct polled_intc *controller(struct irq_data *data)
{
	return container_of(irq_data_get_irq_chip_data(data), struct polled_intc, base);
}

static struct polled_line *lock_line(struct irq_data *data, unsigned long *flags)
	__acquires(&controller(data)->lock)
{
	struct polled_intc *intc = controller(data);

	raw_spin_lock_irqsave(&intc->lock, *flags);
	return &intc->lines[irqd_to_hwirq(data)];
}

static void unlock_line(struct irq_data *data, struct polled_line *line, unsigned long flags)
	__releases(&controller(data)->lock)
{
	struct polled_intc *intc = controller(data);

	if (line->watched && line->busy)
		look_again(intc, line, ktime_get());
	raw_spin_unlock_irqrestore(&intc->lock, flags);
}

static void polled_mask(struct irq_data *data)
{
	unsigned long flags;
	struct polled_line *line = lock_line(data, &flags);

	line->watched = false;
	unlock_line(data, line, flags);
}

static void polled_unmask(struct irq_data *data)
{
	unsigned long flags;
	struct polled_line *line = lock_line(data, &flags);

	line->watched = true;
	line->rested = false;
	unlock_line(data, line, flags);
}

/* true: something was begun; false: it was ended, and no look is under way when this returns */
static int polled_set_state(struct irq_data *data, enum irqchip_irq_state which, bool begun)
{
	struct polled_line *line;
	unsigned long flags;

	if (which != IRQCHIP_STATE_PENDING)
		return -EINVAL;
	line = lock_line(data, &flags);
	line->busy = begun;
	line->rested = false;
	line->began = ktime_get();
	unlock_line(data, line, flags);
	return 0;
}

static struct irq_chip polled_chip = {
	.name = "cm_polled",
	.irq_mask = polled_mask,
	.irq_unmask = polled_unmask,
	.irq_set_irqchip_state = polled_set_state,
	.irq_request_resources = cm_intc_request_resources,
	.irq_release_resources = cm_intc_release_resources,
};

static void polled_init(struct polled_intc *intc)
{
	intc->base.chip = &polled_chip;
	raw_spin_lock_init(&intc->lock);
	cm_hrtimer_setup(&intc->timer, fire, CLOCK_MONOTONIC, HRTIMER_MODE_ABS_HARD);
}

static void polled_end(void *data)
{
	struct polled_intc *intc = data;

	raw_spin_lock_irq(&intc->lock);
	intc->gone = true;
	raw_spin_unlock_irq(&intc->lock);
	hrtimer_cancel(&intc->timer);
	if (cm_intc_remove(&intc->base))
		kfree(intc);
}

static ssize_t period_us_show(struct device *dev, struct device_attribute *attribute, char *to)
{
	struct polled_intc *intc = dev_get_drvdata(dev);

	return sysfs_emit(to, "%u\n", READ_ONCE(intc->period_us));
}

static bool period_valid(u32 us)
{
	return us >= PERIOD_LEAST_US && us <= PERIOD_MOST_US;
}

static ssize_t period_us_store(struct device *dev, struct device_attribute *attribute,
			       const char *from, size_t count)
{
	struct polled_intc *intc = dev_get_drvdata(dev);
	u32 us;
	int ret = kstrtou32(from, 10, &us);

	if (ret)
		return ret;
	if (!period_valid(us))
		return -EINVAL;
	WRITE_ONCE(intc->period_us, us);
	return count;
}
static DEVICE_ATTR_RW(period_us);

static ssize_t looks_show(struct device *dev, struct device_attribute *attribute, char *to)
{
	struct polled_intc *intc = dev_get_drvdata(dev);
	u64 looks;

	raw_spin_lock_irq(&intc->lock);
	looks = intc->looks;
	raw_spin_unlock_irq(&intc->lock);
	return sysfs_emit(to, "%llu\n", looks);
}
static DEVICE_ATTR_RO(looks);

static struct attribute *polled_attrs[] = {
	&dev_attr_period_us.attr,
	&dev_attr_looks.attr,
	NULL,
};
ATTRIBUTE_GROUPS(polled);

static int read_bits(struct device *dev, struct polled_intc *intc)
{
	struct device_node *node = dev->of_node;

	if (of_property_read_u32(node, "fpga-cm,pending", &intc->pending) || !intc->pending ||
	    of_property_read_u32(node, "fpga-cm,idle", &intc->idle) || !intc->idle)
		return dev_err_probe(dev, -EINVAL, "fpga-cm,pending or fpga-cm,idle is missing\n");
	intc->period_us = READ_ONCE(period_us);
	of_property_read_u32(node, "fpga-cm,period-us", &intc->period_us);
	if (!period_valid(intc->period_us))
		return dev_err_probe(dev, -EINVAL, "fpga-cm,period-us is not %u to %u\n",
				     PERIOD_LEAST_US, PERIOD_MOST_US);
	return 0;
}

/* not requested: the words are registers of cores that have drivers of their own */
static int map_words(struct platform_device *pdev, struct polled_intc *intc)
{
	struct resource *word;
	u32 i;

	for (i = 0; (word = platform_get_resource(pdev, IORESOURCE_MEM, i)); i++) {
		if (i == LINES_MAX || resource_size(word) != sizeof(u32))
			return dev_err_probe(&pdev->dev, -EINVAL,
					     "reg: 1 to %u words of 4 bytes\n", LINES_MAX);
		intc->lines[i].status = devm_ioremap(&pdev->dev, word->start, sizeof(u32));
		if (!intc->lines[i].status)
			return -ENOMEM;
	}
	intc->base.count = i;
	return i ? 0 : dev_err_probe(&pdev->dev, -EINVAL, "reg is missing\n");
}

static int polled_probe(struct platform_device *pdev)
{
	struct polled_intc *intc = kzalloc(sizeof(*intc), GFP_KERNEL);
	struct device *dev = &pdev->dev;
	int ret;

	if (!intc)
		return -ENOMEM;
	polled_init(intc);
	platform_set_drvdata(pdev, intc);
	ret = map_words(pdev, intc);
	if (!ret)
		ret = read_bits(dev, intc);
	if (ret) {
		kfree(intc);
		return ret;
	}
	/* behind the mappings: ends before them */
	ret = devm_add_action_or_reset(dev, polled_end, intc);
	return ret ?: cm_intc_add(&intc->base, dev_fwnode(dev));
}

static const struct of_device_id polled_of_match[] = {
	{ .compatible = "fpga-cm,polled-intc" },
	{}
};
MODULE_DEVICE_TABLE(of, polled_of_match);

struct platform_driver cm_polled_intc_driver = {
	.probe = polled_probe,
	.driver = {
		.name = "cm_polled_intc",
		.of_match_table = polled_of_match,
		.dev_groups = polled_groups,
		/* its users would keep dead lines */
		.suppress_bind_attrs = true,
	},
};
