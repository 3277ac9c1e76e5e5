// SPDX-License-Identifier: GPL-2.0
/* Bridges of the port's own node, for loads that no fpga-region asked for. */
#include <linux/of.h>

#include "icap.h"

#if IS_REACHABLE(CONFIG_FPGA_BRIDGE)
#include <linux/fpga/fpga-bridge.h>

static void put_bridges(void *icap)
{
	fpga_bridges_put(&((struct cm_icap *)icap)->bridges);
}

/**
 * cm_icap_bridges_init() - find the bridges
 * @icap: port
 *
 * Return: 0, -EPROBE_DEFER while one is not there, or another negative errno.
 */
int cm_icap_bridges_init(struct cm_icap *icap)
{
	struct device_node *node;
	int i, ret;

	INIT_LIST_HEAD(&icap->bridges);
	ret = devm_add_action(icap->dev, put_bridges, icap);
	for (i = 0; !ret; i++) {
		node = of_parse_phandle(icap->dev->of_node, "fpga-bridges", i);
		if (!node)
			break;
		ret = of_fpga_bridge_get_to_list(node, NULL, &icap->bridges);
		of_node_put(node);
	}
	return ret == -ENODEV ? -EPROBE_DEFER : ret;
}

/**
 * cm_icap_bridges_disable() - decouple
 * @icap: port
 *
 * Return: 0 or what a bridge said.
 */
int cm_icap_bridges_disable(struct cm_icap *icap)
{
	return fpga_bridges_disable(&icap->bridges);
}

/**
 * cm_icap_bridges_enable() - couple again
 * @icap: port
 *
 * Return: 0 or what a bridge said.
 */
int cm_icap_bridges_enable(struct cm_icap *icap)
{
	return fpga_bridges_enable(&icap->bridges);
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
