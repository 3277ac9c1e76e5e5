// SPDX-License-Identifier: GPL-2.0-only
/*
 * Clocks as Zynq-7000's FCLK (UG585, FPGA0_CLK_CTRL): 1 GHz by two divisors of
 * 1 to 63, the nearest rate that is not above the one asked for, a gate.
 */
#include <linux/clk-provider.h>
#include <linux/module.h>
#include <linux/of.h>
#include <linux/platform_device.h>
#include <linux/slab.h>

#include "model.h"

#define CLOCKS 4
#define PLL 1000000000UL
#define DIVISOR_MAX 63

struct model_clock {
	struct clk_hw hw;
	unsigned long divisor;
	bool open;
};

/* the first is the one that the tree's cell names as @first: 15 on Zynq-7000, 71 on ZynqMP */
struct model_clocks {
	u32 first;
	struct model_clock clocks[CLOCKS];
};

static struct model_clock *to_model(struct clk_hw *hw)
{
	return container_of(hw, struct model_clock, hw);
}

/* the smallest product of two divisors that divides far enough */
static unsigned long divisor_for(unsigned long rate)
{
	/* rates are whole numbers: what was rounded once must not be rounded again */
	unsigned long wanted = DIV_ROUND_UP(PLL, rate + 1), best = DIVISOR_MAX * DIVISOR_MAX;
	unsigned long first, second;

	for (first = 1; first <= DIVISOR_MAX; first++) {
		second = min_t(unsigned long, DIV_ROUND_UP(wanted, first), DIVISOR_MAX);
		if (first * second >= wanted && first * second < best)
			best = first * second;
	}
	return best;
}

static unsigned long model_recalc(struct clk_hw *hw, unsigned long parent)
{
	return PLL / to_model(hw)->divisor;
}

static long model_round(struct clk_hw *hw, unsigned long rate, unsigned long *parent)
{
	return PLL / divisor_for(rate);
}

static int model_set(struct clk_hw *hw, unsigned long rate, unsigned long parent)
{
	to_model(hw)->divisor = divisor_for(rate);
	return 0;
}

static int model_enable(struct clk_hw *hw)
{
	to_model(hw)->open = true;
	return 0;
}

static void model_disable(struct clk_hw *hw)
{
	to_model(hw)->open = false;
}

static int model_is_enabled(struct clk_hw *hw)
{
	return to_model(hw)->open;
}

static const struct clk_ops model_ops = {
	.recalc_rate = model_recalc,
	.round_rate = model_round,
	.set_rate = model_set,
	.enable = model_enable,
	.disable = model_disable,
	.is_enabled = model_is_enabled,
};

static struct clk_hw *model_get(struct of_phandle_args *args, void *data)
{
	struct model_clocks *all = data;
	u32 index = args->args[0] - all->first;

	return index < CLOCKS ? &all->clocks[index].hw : ERR_PTR(-EINVAL);
}

static int clocks_probe(struct platform_device *pdev)
{
	struct device *dev = &pdev->dev;
	struct model_clocks *all = devm_kzalloc(dev, sizeof(*all), GFP_KERNEL);
	struct clk_init_data init = { .ops = &model_ops };
	char name[32];
	int i, ret;

	if (!all)
		return -ENOMEM;
	of_property_read_u32(dev->of_node, "fpga-cm,first", &all->first);
	init.name = name;
	for (i = 0; i < CLOCKS; i++) {
		snprintf(name, sizeof(name), "model_fclk%u", all->first + i);
		all->clocks[i].divisor = 20;
		all->clocks[i].hw.init = &init;
		ret = devm_clk_hw_register(dev, &all->clocks[i].hw);
		if (ret)
			return ret;
	}
	return devm_of_clk_add_hw_provider(dev, model_get, all);
}

static const struct of_device_id clocks_of_match[] = {
	{ .compatible = "fpga-cm,model-clocks" },
	{}
};

struct platform_driver axi_clocks_driver = {
	.probe = clocks_probe,
	.driver = {
		.name = "cm_model_clocks",
		.of_match_table = clocks_of_match,
	},
};
