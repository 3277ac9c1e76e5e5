// SPDX-License-Identifier: GPL-2.0-only
/* A decoupler: one register, bit 0 holds the region's outputs. */
#include <linux/clk.h>
#include <linux/io.h>
#include <linux/mod_devicetable.h>
#include <linux/module.h>
#include <linux/platform_device.h>

#include "cm_compat.h"
#include "cm_fpga_compat.h"
#include "icap.h"

#if IS_REACHABLE(CONFIG_FPGA_BRIDGE)

#define DECOUPLE BIT(0)

/**
 * struct cm_decoupler - one decoupler
 * @base: its register
 * @clock: of its bus; runs while the register is used
 */
struct cm_decoupler {
	void __iomem *base;
	struct clk *clock;
};

static int decoupler_enable_set(struct fpga_bridge *bridge, bool enable)
{
	struct cm_decoupler *decoupler = bridge->priv;
	u32 value = enable ? 0 : DECOUPLE;
	bool took;
	int ret = clk_prepare_enable(decoupler->clock);

	if (ret)
		return ret;
	writel(value, decoupler->base);
	took = (readl(decoupler->base) & DECOUPLE) == value;
	clk_disable_unprepare(decoupler->clock);
	return took ? 0 : -EIO;
}

static int decoupler_enable_show(struct fpga_bridge *bridge)
{
	struct cm_decoupler *decoupler = bridge->priv;
	int ret = clk_prepare_enable(decoupler->clock);

	if (ret)
		return ret;
	ret = !(readl(decoupler->base) & DECOUPLE);
	clk_disable_unprepare(decoupler->clock);
	return ret;
}

static const struct fpga_bridge_ops decoupler_ops = {
	.enable_set = decoupler_enable_set,
	.enable_show = decoupler_enable_show,
};

static void unregister_bridge(void *bridge)
{
	fpga_bridge_unregister(bridge);
}

static int cm_decoupler_probe(struct platform_device *pdev)
{
	struct device *dev = &pdev->dev;
	struct cm_decoupler *decoupler = devm_kzalloc(dev, sizeof(*decoupler), GFP_KERNEL);
	struct fpga_bridge *bridge;

	if (!decoupler)
		return -ENOMEM;
	decoupler->base = devm_platform_ioremap_resource(pdev, 0);
	if (IS_ERR(decoupler->base))
		return PTR_ERR(decoupler->base);
	decoupler->clock = devm_clk_get_optional(dev, "aclk");
	if (IS_ERR(decoupler->clock))
		return dev_err_probe(dev, PTR_ERR(decoupler->clock), "no clock \"aclk\"\n");
	bridge = cm_fpga_bridge_register(dev, dev_name(dev), &decoupler_ops, decoupler);
	if (IS_ERR(bridge))
		return dev_err_probe(dev, PTR_ERR(bridge), "no bridge\n");
	return devm_add_action_or_reset(dev, unregister_bridge, bridge);
}
#else
static int cm_decoupler_probe(struct platform_device *pdev)
{
	return dev_err_probe(&pdev->dev, -EOPNOTSUPP, "this kernel has no FPGA bridges\n");
}
#endif

static const struct of_device_id cm_decoupler_of_match[] = {
	{ .compatible = "fpga-cm,decoupler" },
	{}
};
MODULE_DEVICE_TABLE(of, cm_decoupler_of_match);

struct platform_driver cm_decoupler_driver = {
	.probe = cm_decoupler_probe,
	.driver = {
		.name = "cm_decoupler",
		.of_match_table = cm_decoupler_of_match,
		/* a region calls the bridge that it found until its overlay is removed */
		.suppress_bind_attrs = true,
	},
};
