// SPDX-License-Identifier: GPL-2.0-only
/*
 * cm_window: register windows for user space, as UIO devices whose pages can
 * also be lent.  Properties are in docs/kernel.md and the bindings.
 */
#include <linux/platform_device.h>

#include "cm_compat.h"
#include "window.h"

static int __init cm_window_init(void)
{
	int ret = cm_windows_init();

	if (ret)
		return ret;
	ret = platform_driver_register(&cm_window_driver);
	if (ret)
		cm_windows_exit();
	return ret;
}
module_init(cm_window_init);

static void __exit cm_window_exit(void)
{
	platform_driver_unregister(&cm_window_driver);
	cm_window_bridges_exit();
	cm_windows_exit();
}
module_exit(cm_window_exit);

MODULE_DESCRIPTION("Register windows whose pages can be lent and taken back");
MODULE_VERSION(CM_VERSION);
MODULE_LICENSE("GPL");
CM_IMPORT_CORE;
