// SPDX-License-Identifier: GPL-2.0-only
/*
 * AXI INTC (PG099) behind a line of the processor's controller, in an overlay:
 * the node is that of the kernel's binding (xlnx,intc), whose driver takes those
 * of the board's own tree while the kernel boots, and leaves no device of them.
 */
#include <linux/clk.h>
#include <linux/interrupt.h>
#include <linux/io.h>
#include <linux/irqchip/chained_irq.h>
#include <linux/irqdomain.h>
#include <linux/of.h>
#include <linux/platform_device.h>
#include <linux/slab.h>

#include "cm_compat.h"
#include "intc.h"

/* PG099, "Register Space" */
#define ISR 0x00
#define IER 0x08
#define IAR 0x0c
#define SIE 0x10
#define CIE 0x14
#define MER 0x1c
#define MER_ENABLE 3 /* outputs, and inputs of the hardware */

#define INPUTS_MAX 32

/**
 * struct axi_intc - a controller
 * @base: its inputs; edges as it was built (C_KIND_OF_INTR)
 * @registers: registers
 * @parent: line of its output
 */
struct axi_intc {
	struct cm_intc base;
	void __iomem *registers;
	int parent;
};

static void write_bit(struct irq_data *data, u32 at)
{
	struct axi_intc *intc = container_of(irq_data_get_irq_chip_data(data),
					     struct axi_intc, base);

	writel(BIT(irqd_to_hwirq(data)), intc->registers + at);
}

static void axi_mask(struct irq_data *data)
{
	write_bit(data, CIE);
}

static void axi_ack(struct irq_data *data)
{
	write_bit(data, IAR);
}

/* ISR keeps a level that its handlers have ended meanwhile */
static void axi_unmask(struct irq_data *data)
{
	if (irqd_is_level_type(data))
		write_bit(data, IAR);
	write_bit(data, SIE);
}

static struct irq_chip axi_chip = {
	.name = "cm_axi_intc",
	.irq_mask = axi_mask,
	.irq_ack = axi_ack,
	.irq_unmask = axi_unmask,
	.irq_request_resources = cm_intc_request_resources,
	.irq_release_resources = cm_intc_release_resources,
};

static void axi_handle(struct irq_desc *desc)
{
	struct axi_intc *intc = irq_desc_get_handler_data(desc);
	struct irq_chip *chip = irq_desc_get_chip(desc);
	unsigned long pending;
	u32 input;

	chained_irq_enter(chip, desc);
	/* not by IPR and IVR, which a core may be built without */
	pending = readl(intc->registers + ISR) & readl(intc->registers + IER);
	for_each_set_bit(input, &pending, intc->base.count)
		generic_handle_domain_irq(intc->base.domain, input);
	chained_irq_exit(chip, desc);
}

static int axi_start(struct axi_intc *intc, struct fwnode_handle *node)
{
	int ret;

	writel(0, intc->registers + IER);
	writel(~0, intc->registers + IAR);
	intc->base.chip = &axi_chip;
	ret = cm_intc_add(&intc->base, node);
	if (ret)
		return ret;
	writel(MER_ENABLE, intc->registers + MER);
	irq_set_chained_handler_and_data(intc->parent, axi_handle, intc);
	return 0;
}

/* whether all of it is gone */
static bool axi_stop(struct axi_intc *intc)
{
	irq_set_chained_handler_and_data(intc->parent, NULL, NULL);
	writel(0, intc->registers + MER);
	return cm_intc_remove(&intc->base);
}

static void axi_end(void *data)
{
	if (axi_stop(data))
		kfree(data);
}

static void stop_clock(void *clock)
{
	clk_disable_unprepare(clock);
}

static int start_clock(struct device *dev)
{
	struct clk *clock = devm_clk_get_optional(dev, NULL);
	int ret = PTR_ERR_OR_ZERO(clock);

	if (!ret)
		ret = clk_prepare_enable(clock);
	return ret ?: devm_add_action_or_reset(dev, stop_clock, clock);
}

static int axi_describe(struct platform_device *pdev, struct axi_intc *intc)
{
	struct device *dev = &pdev->dev;
	int ret = of_property_read_u32(dev->of_node, "xlnx,num-intr-inputs", &intc->base.count);

	if (!ret && (!intc->base.count || intc->base.count > INPUTS_MAX))
		ret = -EINVAL;
	if (ret)
		return dev_err_probe(dev, ret, "xlnx,num-intr-inputs is not 1 to %u\n", INPUTS_MAX);
	of_property_read_u32(dev->of_node, "xlnx,kind-of-intr", &intc->base.edges);
	intc->parent = platform_get_irq(pdev, 0);
	if (intc->parent < 0)
		return intc->parent;
	ret = start_clock(dev);
	if (ret)
		return dev_err_probe(dev, ret, "its clock\n");
	intc->registers = devm_platform_ioremap_resource(pdev, 0);
	return PTR_ERR_OR_ZERO(intc->registers);
}

static int axi_probe(struct platform_device *pdev)
{
	struct axi_intc *intc = kzalloc(sizeof(*intc), GFP_KERNEL);
	int ret;

	if (!intc)
		return -ENOMEM;
	ret = axi_describe(pdev, intc);
	if (!ret)
		ret = axi_start(intc, dev_fwnode(&pdev->dev));
	if (ret) {
		kfree(intc);
		return ret;
	}
	return devm_add_action_or_reset(&pdev->dev, axi_end, intc);
}

static const struct of_device_id axi_of_match[] = {
	{ .compatible = "xlnx,xps-intc-1.00.a" },
	{}
};
MODULE_DEVICE_TABLE(of, axi_of_match);

struct platform_driver cm_axi_intc_driver = {
	.probe = axi_probe,
	.driver = {
		.name = "cm_axi_intc",
		.of_match_table = axi_of_match,
		.suppress_bind_attrs = true,
	},
};
