// SPDX-License-Identifier: GPL-2.0-only
/* The register windows, as the driver under test sees them. */
#include <linux/io.h>
#include <linux/module.h>
#include <linux/platform_device.h>

#include "model.h"

static LIST_HEAD(engines);
static DEFINE_SPINLOCK(engines_lock); /* protects engines */

/**
 * axi_bus_add() - make an engine's registers reachable
 * @engine: engine
 */
void axi_bus_add(struct axi_engine *engine)
{
	spin_lock(&engines_lock);
	list_add(&engine->node, &engines);
	spin_unlock(&engines_lock);
}

/**
 * axi_bus_remove() - take an engine away; no driver may have it
 * @engine: engine
 */
void axi_bus_remove(struct axi_engine *engine)
{
	spin_lock(&engines_lock);
	list_del(&engine->node);
	spin_unlock(&engines_lock);
}

/**
 * axi_model_map() - in place of devm_platform_ioremap_resource()
 * @pdev: device of the driver
 *
 * Return: its engine's memory, which only serves as an address, or
 * -EPROBE_DEFER while there is no such engine.
 */
void __iomem *axi_model_map(struct platform_device *pdev)
{
	struct resource *range = platform_get_resource(pdev, IORESOURCE_MEM, 0);
	void __iomem *found = IOMEM_ERR_PTR(-EPROBE_DEFER);
	struct axi_engine *engine;

	spin_lock(&engines_lock);
	list_for_each_entry(engine, &engines, node) {
		if (range && engine->address == range->start)
			found = engine->mirror;
	}
	spin_unlock(&engines_lock);
	return found;
}
EXPORT_SYMBOL_GPL(axi_model_map);

/* engines go when no driver has them, so this list does not change under an access */
static struct axi_engine *find(const void __iomem *address, u32 *offset)
{
	struct axi_engine *engine;

	list_for_each_entry(engine, &engines, node) {
		if (address >= (void __iomem *)engine->mirror &&
		    address < (void __iomem *)engine->mirror + AXI_WINDOW) {
			*offset = address - (void __iomem *)engine->mirror;
			return engine;
		}
	}
	WARN(1, "access to no engine");
	return NULL;
}

static struct axi_channel *channel_at(struct axi_engine *engine, u32 offset)
{
	bool receives = engine->vdma ? (offset >= 0x30 && offset < 0x50) || offset >= 0xa0 :
				       offset >= 0x30;

	return &engine->channels[receives];
}

/**
 * axi_trace() - note what happened
 * @engine: engine; its lock is held
 * @what: see struct axi_access
 * @offset: register
 * @value: value
 */
void axi_trace(struct axi_engine *engine, char what, u32 offset, u32 value)
{
	engine->trace[engine->traced++ % AXI_TRACE] =
		(struct axi_access){ .what = what, .offset = offset, .value = value };
}

/**
 * axi_mirror() - show the registers to those who only look
 * @engine: engine; its lock is held
 */
void axi_mirror(struct axi_engine *engine)
{
	int i;

	for (i = 0; i < 2 && !engine->mcdma; i++) {
		struct axi_channel *channel = &engine->channels[i];
		u32 __iomem *base = engine->mirror + channel->offset / sizeof(u32);

		writel(channel->cr, base + DMACR / 4);
		writel(axi_status(channel), base + DMASR / 4);
		if (!engine->vdma)
			writel(channel->length, base + 0x28 / 4);
	}
}

/**
 * axi_model_read() - in place of ioread32()
 * @address: from axi_model_map(), and an offset
 *
 * Return: the register.
 */
u32 axi_model_read(const void __iomem *address)
{
	struct axi_engine *engine;
	unsigned long flags;
	u32 offset, value;

	engine = find(address, &offset);
	if (!engine)
		return ~0;
	spin_lock_irqsave(&engine->lock, flags);
	if (engine->mcdma)
		value = axi_mcdma_read(engine, offset);
	else
		value = engine->vdma ? axi_vdma_read(channel_at(engine, offset), offset) :
			       axi_dma_read(channel_at(engine, offset), offset);
	axi_trace(engine, 'r', offset, value);
	axi_mirror(engine);
	spin_unlock_irqrestore(&engine->lock, flags);
	return value;
}
EXPORT_SYMBOL_GPL(axi_model_read);

/**
 * axi_model_write() - in place of iowrite32()
 * @value: value
 * @address: from axi_model_map(), and an offset
 */
void axi_model_write(u32 value, void __iomem *address)
{
	struct axi_engine *engine;
	unsigned long flags;
	u32 offset;

	engine = find(address, &offset);
	if (!engine)
		return;
	spin_lock_irqsave(&engine->lock, flags);
	axi_trace(engine, 'w', offset, value);
	if (engine->mcdma)
		axi_mcdma_write(engine, offset, value);
	else if (engine->vdma)
		axi_vdma_write(channel_at(engine, offset), offset, value);
	else
		axi_dma_write(channel_at(engine, offset), offset, value);
	axi_mirror(engine);
	spin_unlock_irqrestore(&engine->lock, flags);
	axi_kick(engine);
}
EXPORT_SYMBOL_GPL(axi_model_write);
