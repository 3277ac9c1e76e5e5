// SPDX-License-Identifier: GPL-2.0-only
/*
 * The engines that a device tree describes as they were built, and the
 * interrupt controller that their lines go to.
 */
#include <linux/debugfs.h>
#include <linux/io.h>
#include <linux/irq_sim.h>
#include <linux/module.h>
#include <linux/of.h>
#include <linux/of_address.h>
#include <linux/of_irq.h>
#include <linux/platform_device.h>
#include <linux/slab.h>
#include <linux/vmalloc.h>

#include "model.h"

#define LINES 32
#define S2MM_OFFSET 0x30

static struct dentry *root;

static int read_pl(struct device_node *node, struct axi_engine *engine)
{
	static const char * const kinds[] = {
		[AXI_BENCH] = "bench",
		[AXI_LOOP] = "loop",
		[AXI_CAMERA] = "camera",
		[AXI_PORT] = "port",
	};
	const char *kind;
	u32 address;
	int ret = of_property_read_string(node, "fpga-cm,pl", &kind);

	if (!ret)
		ret = match_string(kinds, ARRAY_SIZE(kinds), kind);
	if (ret < 0)
		return ret;
	engine->pl = ret;
	of_property_read_u32(node, "fpga-cm,frame-length", &engine->frame_length);
	of_property_read_u32(node, "fpga-cm,interval-us", &engine->interval_us);
	of_property_read_u32(node, "fpga-cm,idcode", &engine->port.port.idcode);
	if (!of_property_read_u32(node, "fpga-cm,status", &address))
		engine->port.status = ioremap(address, sizeof(u32));
	if (!of_property_read_u32(node, "fpga-cm,identity", &address))
		engine->port.identity = ioremap(address, sizeof(u32));
	return 0;
}

/* a line of the model's own controller, or one of the board's, by its name */
static void read_line(struct device_node *node, struct axi_channel *channel, const char *name,
		      u32 line)
{
	int irq = of_irq_get_byname(node, name);

	channel->irq = line;
	channel->virq = irq > 0 ? irq : 0;
}

static int read_engine(struct device_node *node, struct axi_engine *engine)
{
	/* beyond the controller's: connected to nothing */
	u32 address, bits = 26, lines[2] = { LINES, LINES };
	char name[16];
	int ret, i;

	ret = of_property_read_u32(node, "reg", &address);
	if (!ret)
		ret = of_property_read_string(node, "label", &engine->label);
	if (ret)
		return ret;
	of_property_read_u32_array(node, "fpga-cm,lines", lines, 2);
	engine->address = address;
	engine->vdma = of_property_read_bool(node, "fpga-cm,vdma");
	engine->mcdma = of_property_read_bool(node, "fpga-cm,mcdma");
	engine->sg = of_property_read_bool(node, "fpga-cm,sg");
	engine->fstores = 3;
	of_property_read_u32(node, "fpga-cm,length-width", &bits);
	engine->length_mask = GENMASK(bits - 1, 0);
	engine->channels[0].there = !of_property_read_bool(node, "fpga-cm,no-mm2s");
	engine->channels[1].there = !of_property_read_bool(node, "fpga-cm,no-s2mm");
	read_line(node, &engine->channels[0], "mm2s", lines[0]);
	read_line(node, &engine->channels[1], "s2mm", lines[1]);
	for (i = 0; i < 2 * AXI_MC_CHANNELS && engine->mcdma; i++) {
		int way = i / AXI_MC_CHANNELS, number = i % AXI_MC_CHANNELS;

		/* as the core's pins are called */
		snprintf(name, sizeof(name), "%s_ch%d", way ? "s2mm" : "mm2s", number + 1);
		read_line(node, &engine->mc[way][number], name, lines[way] + number);
	}
	return read_pl(node, engine);
}

static void engine_free(void *data)
{
	struct axi_engine *engine = data;

	debugfs_remove_recursive(engine->debugfs);
	cancel_delayed_work_sync(&engine->camera);
	axi_bus_remove(engine);
	cancel_delayed_work_sync(&engine->work);
	axi_stream_clear(&engine->channels[0]);
	axi_stream_clear(&engine->channels[1]);
	axi_packet_drop(engine->channels[0].packet);
	if (engine->mcdma)
		axi_mcdma_reset(engine);
	if (engine->port.status)
		iounmap(engine->port.status);
	if (engine->port.identity)
		iounmap(engine->port.identity);
	iounmap(engine->mirror);
	kvfree(engine->trace);
	kfree(engine);
}

static int engine_start(struct device *dev, struct axi_engine *engine, struct irq_domain *irqs)
{
	int i;

	spin_lock_init(&engine->lock);
	engine->irqs = irqs;
	for (i = 0; i < 2; i++) {
		struct axi_channel *channel = &engine->channels[i];

		channel->engine = engine;
		channel->receives = i;
		channel->offset = i * S2MM_OFFSET;
		INIT_LIST_HEAD(&channel->stream);
		axi_reset_channel(channel);
	}
	for (i = 0; i < 2 * AXI_MC_CHANNELS && engine->mcdma; i++) {
		struct axi_channel *channel = &engine->mc[i / AXI_MC_CHANNELS][i % AXI_MC_CHANNELS];

		channel->engine = engine;
	}
	if (engine->mcdma)
		axi_mcdma_reset(engine);
	axi_mirror(engine);
	axi_pl_init(engine);
	axi_bus_add(engine);
	return devm_add_action_or_reset(dev, engine_free, engine);
}

static int add_engine(struct device *dev, struct device_node *node, struct irq_domain *irqs)
{
	struct axi_engine *engine = kzalloc(sizeof(*engine), GFP_KERNEL);
	int ret;

	if (!engine)
		return -ENOMEM;
	ret = read_engine(node, engine);
	if (ret) {
		kfree(engine);
		return dev_err_probe(dev, ret, "%pOF is not understood\n", node);
	}
	engine->trace = kvcalloc(AXI_TRACE, sizeof(*engine->trace), GFP_KERNEL);
	engine->mirror = ioremap(engine->address, AXI_WINDOW);
	if (!engine->trace || !engine->mirror)
		return -ENOMEM; /* the module is of no use then, and the test ends */
	ret = engine_start(dev, engine, irqs);
	if (!ret)
		axi_debugfs(engine, root);
	return ret;
}

static int model_probe(struct platform_device *pdev)
{
	struct device *dev = &pdev->dev;
	struct irq_domain *irqs;
	struct device_node *node;
	int ret;

	irqs = devm_irq_domain_create_sim(dev, of_node_to_fwnode(dev->of_node), LINES);
	if (IS_ERR(irqs))
		return PTR_ERR(irqs);
	for_each_child_of_node(dev->of_node, node) {
		ret = add_engine(dev, node, irqs);
		if (ret) {
			of_node_put(node);
			return ret;
		}
	}
	return 0;
}

static const struct of_device_id model_of_match[] = {
	{ .compatible = "fpga-cm,axi-model" },
	{}
};
MODULE_DEVICE_TABLE(of, model_of_match);

static struct platform_driver model_driver = {
	.probe = model_probe,
	.driver = {
		.name = "cm_axi_model",
		.of_match_table = model_of_match,
	},
};

static struct platform_driver * const drivers[] = {
	&model_driver,
	&axi_clocks_driver,
	&axi_manager_driver,
};

static int __init model_init(void)
{
	int ret;

	root = debugfs_create_dir("cm_axi", NULL);
	ret = axi_firmware_start(root);
	if (!ret)
		ret = platform_register_drivers(drivers, ARRAY_SIZE(drivers));
	if (ret)
		debugfs_remove_recursive(root);
	return ret;
}
module_init(model_init);

static void __exit model_exit(void)
{
	platform_unregister_drivers(drivers, ARRAY_SIZE(drivers));
	debugfs_remove_recursive(root);
}
module_exit(model_exit);

MODULE_DESCRIPTION("Register models of AXI DMA and AXI VDMA");
MODULE_LICENSE("GPL");
