// SPDX-License-Identifier: GPL-2.0-only
/*
 * What stands for a chip's own configuration port (devcfg, or the platform
 * firmware's PCAP) on a board that has none: an FPGA manager that takes any
 * image and looks at nothing but how long it is.  It tests regions, overlays
 * and who is asked for what; it does not stand for a driver of the kernel.
 */
#include <linux/debugfs.h>
#include <linux/delay.h>
#include <linux/fpga/fpga-mgr.h>
#include <linux/module.h>
#include <linux/of.h>
#include <linux/platform_device.h>

#include "model.h"

/**
 * struct model_manager - what it has seen
 * @debugfs: its files: /sys/kernel/debug/cm_pcap
 * @loads: images taken
 * @full: full ones among them
 * @bytes: of the last one
 * @fail: so many loads end with -EIO
 * @hold: a load takes as long as this is set
 */
struct model_manager {
	struct dentry *debugfs;
	u64 loads;
	u64 full;
	u64 bytes;
	u32 fail;
	bool hold;
};

static int manager_init(struct fpga_manager *mgr, struct fpga_image_info *info, const char *buf,
			size_t count)
{
	struct model_manager *model = mgr->priv;

	if (model->fail) {
		model->fail--;
		return -EIO;
	}
	model->bytes = 0;
	return 0;
}

static int manager_write(struct fpga_manager *mgr, const char *buf, size_t count)
{
	struct model_manager *model = mgr->priv;

	while (READ_ONCE(model->hold))
		msleep(10);
	model->bytes += count;
	return 0;
}

static int manager_complete(struct fpga_manager *mgr, struct fpga_image_info *info)
{
	struct model_manager *model = mgr->priv;

	model->loads++;
	model->full += !(info->flags & FPGA_MGR_PARTIAL_RECONFIG);
	return 0;
}

static enum fpga_mgr_states manager_state(struct fpga_manager *mgr)
{
	return FPGA_MGR_STATE_OPERATING;
}

static const struct fpga_manager_ops manager_ops = {
	.state = manager_state,
	.write_init = manager_init,
	.write = manager_write,
	.write_complete = manager_complete,
};

static void forget(void *debugfs)
{
	debugfs_remove_recursive(debugfs);
}

static int manager_probe(struct platform_device *pdev)
{
	struct device *dev = &pdev->dev;
	struct model_manager *model = devm_kzalloc(dev, sizeof(*model), GFP_KERNEL);
	struct fpga_manager *mgr;

	if (!model)
		return -ENOMEM;
	mgr = devm_fpga_mgr_register(dev, "Model of a PCAP", &manager_ops, model);
	if (IS_ERR(mgr))
		return PTR_ERR(mgr);
	model->debugfs = debugfs_create_dir("cm_pcap", NULL);
	debugfs_create_u64("loads", 0400, model->debugfs, &model->loads);
	debugfs_create_u64("full", 0400, model->debugfs, &model->full);
	debugfs_create_u64("bytes", 0400, model->debugfs, &model->bytes);
	debugfs_create_u32("fail", 0600, model->debugfs, &model->fail);
	debugfs_create_bool("hold", 0600, model->debugfs, &model->hold);
	return devm_add_action_or_reset(dev, forget, model->debugfs);
}

static const struct of_device_id manager_of_match[] = {
	{ .compatible = "fpga-cm,model-manager" },
	{}
};

struct platform_driver axi_manager_driver = {
	.probe = manager_probe,
	.driver = {
		.name = "cm_model_manager",
		.of_match_table = manager_of_match,
	},
};
