/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * What has to be known of the engine behind a channel.
 *
 * The DMA engine framework does not say how a provider queues, resets or tells
 * an error.  For Xilinx' engines (drivers/dma/xilinx/xilinx_dma.c, 6.1 to
 * 6.12) it is written here; every other provider is taken at its word.
 */
#ifndef _CM_ENGINE_H
#define _CM_ENGINE_H

#include <linux/interrupt.h>
#include <linux/io.h>
#include <linux/kref.h>
#include <linux/list.h>
#include <linux/mutex.h>
#include <linux/types.h>

struct device;
struct device_node;
struct dma_chan;

/* DMASR, PG021 table "DMA Status Register"; PG020 has the same for AXI VDMA */
#define CM_DMASR 0x04
#define CM_DMASR_SG BIT(3)
#define CM_DMASR_AXIDMA_ERRORS 0x770 /* DMAIntErr, SlvErr, DecErr, and those of the SG port */
#define CM_DMASR_VDMA_ERRORS 0x070   /* the others end a frame, not the channel */
/* LENGTH: in simple mode the bytes that were received, once the transfer has ended */
#define CM_DMA_LENGTH 0x28

/**
 * struct cm_traits - how the engine behind one channel behaves
 * @registers: of the channel, DMACR first, only ever read; NULL where unknown
 * @irq: line of a controller that polls, or 0 where the engine has a wire
 * @errors: bits of DMASR with which the engine has stopped for good
 * @ahead: most transfers that it is given at a time
 * @simple: AXI DMA without scatter/gather
 * @own_cyclic: a cyclic transfer of its own tells the end of each period
 * @interleaved: takes interleaved transfers, whatever its capabilities say
 * @stop_after: goes on writing a frame that it has told the end of
 * @length_register: short packets are told by CM_DMA_LENGTH
 * @residue: short packets are told by the residue
 * @moves: a transfer that moved nothing has failed
 */
struct cm_traits {
	void __iomem *registers;
	unsigned int irq;
	u32 errors;
	u32 ahead;
	bool simple;
	bool own_cyclic;
	bool interleaved;
	bool stop_after;
	bool length_register;
	bool residue;
	bool moves;
};

/**
 * struct cm_engine - what the channels of one provider share
 * @ref: one of each channel
 * @node: in the list of all that have channels
 * @provider: its device; a reference is held, so that no other is taken for it
 *            while files of an engine that is gone are open
 * @lock: orders submit, cancel, claim and the end of all its channels
 * @channels: channels, by cm_channel.siblings; under @lock
 * @shared_reset: terminating one channel resets the others
 */
struct cm_engine {
	struct kref ref;
	struct list_head node;
	struct device *provider;
	struct mutex lock; /* orders submit, cancel, claim and the end of its channels */
	struct list_head channels;
	bool shared_reset;
};

struct cm_engine *cm_engine_get(struct dma_chan *chan);
void cm_engine_put(struct cm_engine *engine);
int cm_traits_read(struct cm_traits *traits, struct dma_chan *chan, u32 direction);
void cm_traits_release(struct cm_traits *traits);

/* whether the engine has stopped with an error, which its driver does not report */
static inline bool cm_traits_failed(const struct cm_traits *traits)
{
	return traits->registers && readl(traits->registers + CM_DMASR) & traits->errors;
}

/* whoever looks for the end of a transfer begins to, or has left off when this returns */
static inline void cm_traits_tell(const struct cm_traits *traits, bool begun)
{
	if (traits->irq)
		irq_set_irqchip_state(traits->irq, IRQCHIP_STATE_PENDING, begun);
}

#endif /* _CM_ENGINE_H */
