// SPDX-License-Identifier: GPL-2.0-only
/* Bridges of the port's own node, for loads that no fpga-region asked for. */
#include <linux/of.h>

#include "icap.h"

#if IS_REACHABLE(CONFIG_FPGA_BRIDGE)
#include <linux/fpga/fpga-bridge.h>

static int look_only(struct fpga_bridge *bridge)
{
	return 0;
}

/*
 * The holder of a bridge holds a mutex, which is for one call and not for a load
 * that ends in another context, or for the time that the port is there.
 */
static int with_bridges(struct cm_icap *icap, int (*call)(struct fpga_bridge *bridge))
{
	struct fpga_bridge *bridge;
	struct device_node *node;
	int i, ret = 0;

	for (i = 0; !ret; i++) {
		node = of_parse_phandle(icap->dev->of_node, "fpga-bridges", i);
		if (!node)
			break;
		bridge = of_fpga_bridge_get(node, NULL);
		of_node_put(node);
		if (IS_ERR(bridge))
			return PTR_ERR(bridge);
		ret = call(bridge);
		fpga_bridge_put(bridge);
	}
	return ret;
}

/**
 * cm_icap_bridges_init() - see that the bridges are there
 * @icap: port
 *
 * Return: 0, -EPROBE_DEFER while one is not there, or another negative errno.
 */
int cm_icap_bridges_init(struct cm_icap *icap)
{
	int ret = with_bridges(icap, look_only);

	return ret == -ENODEV ? -EPROBE_DEFER : ret;
}

/**
 * cm_icap_bridges_disable() - decouple
 * @icap: port
 *
 * Return: 0, -ENODEV for a bridge that is gone, -EBUSY for one that a region
 * has, or what a bridge said.
 */
int cm_icap_bridges_disable(struct cm_icap *icap)
{
	return with_bridges(icap, fpga_bridge_disable);
}

/**
 * cm_icap_bridges_enable() - couple again
 * @icap: port
 *
 * Return: as cm_icap_bridges_disable().
 */
int cm_icap_bridges_enable(struct cm_icap *icap)
{
	return with_bridges(icap, fpga_bridge_enable);
}
#else
int cm_icap_bridges_init(struct cm_icap *icap)
{
	if (!of_find_property(icap->dev->of_node, "fpga-bridges", NULL))
		return 0;
	return dev_err_probe(icap->dev, -EOPNOTSUPP, "this kernel has no FPGA bridges\n");
}

int cm_icap_bridges_disable(struct cm_icap *icap)
{
	return 0;
}

int cm_icap_bridges_enable(struct cm_icap *icap)
{
	return 0;
}
#endif
