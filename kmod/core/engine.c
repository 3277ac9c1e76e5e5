// SPDX-License-Identifier: GPL-2.0-only
/*
 * Xilinx' DMA engines as their driver handles them, and what channels of one
 * engine share.
 *
 * - Interrupts are raised after as many descriptors as were queued when the
 *   engine was started, so a frame is told when the last of them is there; in
 *   simple mode the whole queue is told to be done when its first is.  So the
 *   engine gets two transfers at a time, or one in simple mode.
 * - A reset, which every terminate makes, is one of both channels (PG021,
 *   DMACR.Reset; PG288 the same).  AXI VDMA resets each channel (PG020).
 * - Cyclic transfers never call back.
 * - An error only sets a flag in the driver: nothing is told, and the failed
 *   transfer counts as done when the next one is.  DMASR keeps the error.
 * - AXI VDMA goes on with the frame it is parked at until it is stopped.
 * - Where the interrupt of a channel is connected to nothing, cm_intc looks for
 *   it from the moment when it is told that something was begun (intc/polled.c).
 */
#include <linux/dmaengine.h>
#include <linux/of.h>
#include <linux/of_address.h>
#include <linux/of_irq.h>
#include <linux/slab.h>

#include "cm_compat.h"
#include "cm_dma.h"
#include "engine.h"

#define S2MM_OFFSET 0x30

static LIST_HEAD(engines);
static DEFINE_MUTEX(engines_lock); /* protects engines */

static bool is_engine(struct dma_chan *chan, const char *compatible)
{
	return of_device_is_compatible(chan->device->dev->of_node, compatible);
}

static struct cm_engine *find_locked(struct device *provider)
{
	struct cm_engine *engine;

	list_for_each_entry(engine, &engines, node) {
		if (engine->provider == provider)
			return engine;
	}
	return NULL;
}

static struct cm_engine *new_locked(struct dma_chan *chan)
{
	struct cm_engine *engine = kzalloc(sizeof(*engine), GFP_KERNEL);

	if (!engine)
		return NULL;
	kref_init(&engine->ref);
	mutex_init(&engine->lock);
	INIT_LIST_HEAD(&engine->channels);
	engine->provider = get_device(chan->device->dev);
	engine->shared_reset = is_engine(chan, "xlnx,axi-dma-1.00.a") ||
			       is_engine(chan, "xlnx,axi-mcdma-1.00.a");
	list_add(&engine->node, &engines);
	return engine;
}

/**
 * cm_engine_get() - the engine of a channel
 * @chan: channel, requested by the caller
 *
 * Return: an engine for cm_engine_put(), or NULL where there is no memory.
 */
struct cm_engine *cm_engine_get(struct dma_chan *chan)
{
	struct cm_engine *engine;

	mutex_lock(&engines_lock);
	engine = find_locked(chan->device->dev);
	if (engine)
		kref_get(&engine->ref);
	else
		engine = new_locked(chan);
	mutex_unlock(&engines_lock);
	return engine;
}

static void engine_release(struct kref *ref)
{
	struct cm_engine *engine = container_of(ref, struct cm_engine, ref);

	list_del(&engine->node);
	mutex_unlock(&engines_lock);
	mutex_destroy(&engine->lock);
	put_device(engine->provider);
	kfree(engine);
}

/**
 * cm_engine_put() - give an engine back
 * @engine: engine, or NULL
 */
void cm_engine_put(struct cm_engine *engine)
{
	if (engine)
		kref_put_mutex(&engine->ref, engine_release, &engines_lock);
}

/* not requested: the range is that of the engine's driver */
static void __iomem *map_channel(struct dma_chan *chan, u32 direction)
{
	struct resource range;
	u32 offset = direction == CM_DMA_S2MM ? S2MM_OFFSET : 0;

	if (of_address_to_resource(chan->device->dev->of_node, 0, &range) ||
	    resource_size(&range) < offset + CM_DMA_LENGTH + sizeof(u32))
		return NULL;
	return ioremap(range.start + offset, CM_DMA_LENGTH + sizeof(u32));
}

static bool is_channel(const struct device_node *node, u32 direction)
{
	if (direction == CM_DMA_S2MM)
		return of_device_is_compatible(node, "xlnx,axi-dma-s2mm-channel") ||
		       of_device_is_compatible(node, "xlnx,axi-vdma-s2mm-channel");
	return of_device_is_compatible(node, "xlnx,axi-dma-mm2s-channel") ||
	       of_device_is_compatible(node, "xlnx,axi-vdma-mm2s-channel");
}

/* a controller with a wire would take what this line is told for an interrupt */
static unsigned int polled_line(struct dma_chan *chan, u32 direction)
{
	struct device_node *node;
	struct of_phandle_args args;
	int irq = 0;

	for_each_child_of_node(chan->device->dev->of_node, node) {
		if (!is_channel(node, direction) || of_irq_parse_one(node, 0, &args))
			continue;
		if (of_device_is_compatible(args.np, "fpga-cm,polled-intc"))
			irq = of_irq_get(node, 0);
		of_node_put(args.np);
	}
	return irq > 0 ? irq : 0;
}

/**
 * cm_traits_read() - find out how the engine of a channel behaves
 * @traits: filled in; to be given to cm_traits_release()
 * @chan: channel, requested by the caller
 * @direction: CM_DMA_MM2S or CM_DMA_S2MM
 *
 * Return: 0, or -ENOMEM where the engine's registers cannot be mapped.
 */
int cm_traits_read(struct cm_traits *traits, struct dma_chan *chan, u32 direction)
{
	bool axidma = is_engine(chan, "xlnx,axi-dma-1.00.a");
	bool mcdma = is_engine(chan, "xlnx,axi-mcdma-1.00.a");
	bool vdma = is_engine(chan, "xlnx,axi-vdma-1.00.a");
	bool sg = true;

	*traits = (struct cm_traits){ .ahead = U32_MAX, .own_cyclic = true, .residue = true };
	if (!axidma && !mcdma && !vdma)
		return 0;
	if (!mcdma) {
		traits->registers = map_channel(chan, direction);
		if (!traits->registers)
			return -ENOMEM;
		traits->errors = axidma ? CM_DMASR_AXIDMA_ERRORS : CM_DMASR_VDMA_ERRORS;
	}
	if (!mcdma)
		traits->irq = polled_line(chan, direction);
	if (axidma)
		sg = readl(traits->registers + CM_DMASR) & CM_DMASR_SG;
	traits->simple = !sg;
	traits->own_cyclic = false;
	traits->ahead = vdma || !sg ? 1 : 2;
	traits->interleaved = vdma;
	traits->stop_after = vdma;
	traits->residue = sg && !vdma;
	traits->moves = traits->residue;
	traits->length_register = !sg && direction == CM_DMA_S2MM;
	return 0;
}

/**
 * cm_traits_release() - unmap what cm_traits_read() mapped
 * @traits: traits
 */
void cm_traits_release(struct cm_traits *traits)
{
	if (traits->registers)
		iounmap(traits->registers);
	traits->registers = NULL;
}
