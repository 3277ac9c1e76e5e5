// SPDX-License-Identifier: GPL-2.0-only
/* cm_plsim: simulated programmable logic. */
#include <linux/debugfs.h>
#include <linux/module.h>
#include <linux/platform_device.h>

#include "cm_compat.h"
#include "plsim.h"

static struct platform_driver * const drivers[] = {
	&plsim_dma_driver,
	&plsim_uio_driver,
};

static int __init plsim_init(void)
{
	int ret;

	plsim_debugfs_root = debugfs_create_dir("cm_plsim", NULL);
	ret = platform_register_drivers(drivers, ARRAY_SIZE(drivers));
	if (ret)
		goto remove_debugfs;
	ret = plsim_configfs_init();
	if (ret)
		goto unregister_drivers;
	return 0;

unregister_drivers:
	platform_unregister_drivers(drivers, ARRAY_SIZE(drivers));
remove_debugfs:
	debugfs_remove_recursive(plsim_debugfs_root);
	return ret;
}
module_init(plsim_init);

static void __exit plsim_exit(void)
{
	plsim_configfs_exit();
	platform_unregister_drivers(drivers, ARRAY_SIZE(drivers));
	debugfs_remove_recursive(plsim_debugfs_root);
}
module_exit(plsim_exit);

MODULE_DESCRIPTION("Simulated programmable logic: DMA channels, registers, configuration port");
MODULE_VERSION(CM_VERSION);
MODULE_LICENSE("GPL");
CM_IMPORT_CORE;
