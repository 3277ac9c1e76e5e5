// SPDX-License-Identifier: GPL-2.0-only
/*
 * cm_intc: interrupt controllers of the PL.
 *
 * The kernel's driver of the AXI INTC finds its nodes while it boots, so never
 * one that an overlay brings (IRQCHIP_DECLARE); and a core whose interrupt is
 * connected to nothing has no controller at all.
 */
#include <linux/kernel.h>

#include "cm_compat.h"
#include "intc.h"

static struct platform_driver * const drivers[] = {
	&cm_polled_intc_driver,
	&cm_axi_intc_driver,
};

static int __init cm_intc_init(void)
{
	return platform_register_drivers(drivers, ARRAY_SIZE(drivers));
}
module_init(cm_intc_init);

static void __exit cm_intc_exit(void)
{
	platform_unregister_drivers(drivers, ARRAY_SIZE(drivers));
}
module_exit(cm_intc_exit);

MODULE_DESCRIPTION("Interrupt controllers of the programmable logic, in overlays");
MODULE_VERSION(CM_VERSION);
MODULE_LICENSE("GPL");
