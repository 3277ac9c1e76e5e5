/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * Registering with the FPGA framework, which took one call less from 5.17 on.
 * Apart from cm_compat.h, because most modules do not need these headers.
 */
#ifndef _CM_FPGA_COMPAT_H
#define _CM_FPGA_COMPAT_H

#include <linux/version.h>

#if IS_REACHABLE(CONFIG_FPGA)
#include <linux/fpga/fpga-mgr.h>

static inline struct fpga_manager *cm_fpga_manager_register(struct device *dev, const char *name,
							    const struct fpga_manager_ops *ops,
							    void *priv)
{
#if LINUX_VERSION_CODE >= KERNEL_VERSION(5, 17, 0)
	return devm_fpga_mgr_register(dev, name, ops, priv);
#else
	struct fpga_manager *manager = devm_fpga_mgr_create(dev, name, ops, priv);
	int ret = manager ? devm_fpga_mgr_register(dev, manager) : -ENOMEM;

	return ret ? ERR_PTR(ret) : manager;
#endif
}
#endif

#if IS_REACHABLE(CONFIG_FPGA_BRIDGE)
#include <linux/fpga/fpga-bridge.h>

static inline struct fpga_bridge *cm_fpga_bridge_register(struct device *dev, const char *name,
							  const struct fpga_bridge_ops *ops,
							  void *priv)
{
#if LINUX_VERSION_CODE >= KERNEL_VERSION(5, 17, 0)
	return fpga_bridge_register(dev, name, ops, priv);
#else
	struct fpga_bridge *bridge = devm_fpga_bridge_create(dev, name, ops, priv);
	int ret = bridge ? fpga_bridge_register(bridge) : -ENOMEM;

	return ret ? ERR_PTR(ret) : bridge;
#endif
}
#endif

#endif /* _CM_FPGA_COMPAT_H */
