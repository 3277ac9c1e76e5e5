/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * Register models of AXI DMA (PG021), AXI VDMA (PG020) and AXI MCDMA (PG288), written from the
 * product guides; sources.md says where each bit stands.
 *
 * A register of an engine is read and written by axi_model_read() and
 * axi_model_write(), which see each access in order.  Memory is moved by a
 * worker, as the engine does it beside the processor.  The values of the
 * registers also stand in the memory at the engine's address, for whoever only
 * looks at them.
 */
#ifndef _CM_AXI_MODEL_H
#define _CM_AXI_MODEL_H

#include <linux/irqdomain.h>
#include <linux/list.h>
#include <linux/spinlock.h>
#include <linux/types.h>
#include <linux/workqueue.h>

#include "configport.h"

#define AXI_WINDOW 0x1000
#define AXI_FSTORES 32
#define AXI_TRACE 4096
#define AXI_MC_CHANNELS 4
#define AXI_MC_IRQS GENMASK(7, 5) /* MCDMA: of a channel's CR and SR */

/* DMACR and DMASR of a channel: PG021 tables 2-6, 2-7; PG020 tables 2-10, 2-11 */
#define DMACR 0x00
#define CR_RS BIT(0)
#define CR_CIRCULAR BIT(1) /* VDMA */
#define CR_RESET BIT(2)
#define CR_CYCLIC BIT(4) /* AXI DMA */
#define CR_THRESHOLD GENMASK(23, 16)
#define CR_DELAY GENMASK(31, 24)
#define DMASR 0x04
#define SR_HALTED BIT(0)
#define SR_IDLE BIT(1)
#define SR_SG BIT(3)
#define SR_INT_ERR BIT(4)
#define SR_SLV_ERR BIT(5)
#define SR_DEC_ERR BIT(6)
#define SR_SG_INT_ERR BIT(8)
#define SR_SG_SLV_ERR BIT(9)
#define SR_SG_DEC_ERR BIT(10)
#define SR_ERRORS (GENMASK(6, 4) | GENMASK(10, 8)) /* bits 10 to 8: AXI DMA */
/* of AXI VDMA, S2MM: SOFEarlyErr, EOLEarlyErr, SOFLateErr, EOLLateErr; they halt nothing */
#define SR_SOF_EARLY BIT(7)
#define SR_SOF_LATE BIT(11)
#define SR_FRAME_ERRORS (SR_SOF_EARLY | BIT(8) | SR_SOF_LATE | BIT(15))
#define SR_IOC BIT(12)
#define SR_DLY BIT(13)
#define SR_ERR BIT(14)
#define SR_IRQS GENMASK(14, 12)

/**
 * struct axi_packet - data between TLAST and TLAST
 * @node: in a stream
 * @length: bytes
 * @taken: bytes that the engine has received
 * @tdest: MCDMA: channel that it is for
 * @data: bytes
 */
struct axi_packet {
	struct list_head node;
	size_t length;
	size_t taken;
	u32 tdest;
	u8 data[] __aligned(4);
};

struct axi_engine;

/**
 * struct axi_channel - MM2S or S2MM of an engine
 * @engine: engine
 * @there: the engine was built with it
 * @receives: S2MM
 * @offset: of its registers
 * @irq: input of the model's interrupt controller
 * @virq: interrupt of the board's controller in place of it, or 0
 * @cr: DMACR
 * @sr: DMASR without SR_SG
 * @curdesc: CURDESC
 * @taildesc: TAILDESC
 * @address: simple mode: SA or DA
 * @length: simple mode: LENGTH as it reads
 * @armed: a descriptor or a transfer is to be done
 * @begun: descriptors were done since the engine was started
 * @next: descriptor after the last that was done
 * @countdown: packets until the interrupt
 * @resetting: reads of DMACR until a reset is over
 * @packet: MM2S: under way, S2MM: none
 * @stream: S2MM: packets that wait; MM2S: packets that were sent
 * @vsize: VDMA: lines, and the trigger
 * @hsize: VDMA: bytes of a line
 * @stride: VDMA: bytes from line to line
 * @start: VDMA: addresses of the frame stores
 * @store: VDMA, circular: frame store of the next frame
 * @inject: bits of DMASR with which the next transfer ends
 * @hold: nothing moves
 * @sticks: RS = 0 does not halt it
 * @transfers: transfers or descriptors done
 * @bytes: bytes moved
 * @interrupts: rising edges of the interrupt
 * @resets: of the channel
 * @misuse: accesses that the product guide forbids
 */
struct axi_channel {
	struct axi_engine *engine;
	bool there;
	bool receives;
	u32 offset;
	u32 irq;
	unsigned int virq;
	u32 cr;
	u32 sr;
	u64 curdesc;
	u64 taildesc;
	u64 address;
	u32 length;
	bool armed;
	bool begun;
	u64 next;
	u32 countdown;
	u32 resetting;
	struct axi_packet *packet;
	struct list_head stream;
	u32 vsize;
	u32 hsize;
	u32 stride;
	u64 start[AXI_FSTORES];
	u32 store;
	u32 inject;
	u32 hold;
	u32 sticks;
	u64 transfers;
	u64 bytes;
	u64 interrupts;
	u64 resets;
	u64 misuse;
};

/**
 * struct axi_access - what the trace holds
 * @what: 'r', 'w', or 'i' for an interrupt, 'd' for a descriptor or transfer that was done
 * @offset: register, or of the channel's first one
 * @value: value
 */
struct axi_access {
	char what;
	u32 offset;
	u32 value;
};

/**
 * struct axi_port - a configuration port behind MM2S
 * @port: packet processor; a load is over when it is desynchronised
 * @status: its status register, in memory that the loader's driver maps
 * @identity: identity register of the region, or NULL
 * @loaded: what that says after the next good load
 * @loads: loads done
 * @errors: CM_ICAP_ERR_* of the last one
 * @words: words of the last one
 * @inject: CM_ICAP_ERR_* that the next one ends with
 * @force: status that the next one ends with, whatever the port thinks; 0: none
 * @delay_us: before the port takes a transfer
 */
struct axi_port {
	struct cm_configport port;
	u32 __iomem *status;
	u32 __iomem *identity;
	u32 loaded;
	u64 loads;
	u32 errors;
	u32 words;
	u32 inject;
	u32 force;
	u32 delay_us;
};

/**
 * enum axi_pl - what is at the streams
 * @AXI_BENCH: packets come from debugfs and are kept for it
 * @AXI_LOOP: what is sent is received
 * @AXI_CAMERA: a frame in each interval is received
 * @AXI_PORT: what is sent is a bitstream
 */
enum axi_pl {
	AXI_BENCH,
	AXI_LOOP,
	AXI_CAMERA,
	AXI_PORT,
};

/**
 * struct axi_engine - an engine as it was built
 * @node: in the model's list
 * @address: of its registers
 * @label: name
 * @mirror: memory at that address
 * @lock: protects everything
 * @vdma: AXI VDMA; else AXI DMA
 * @mcdma: AXI MCDMA
 * @sg: AXI DMA: with scatter/gather
 * @length_mask: AXI DMA: of LENGTH, and of a descriptor's
 * @fstores: VDMA: frame stores
 * @park: VDMA: PARK_PTR
 * @pl: at the streams
 * @frame_length: camera: bytes
 * @interval_us: camera: time between frames
 * @frames: camera: frames made
 * @port: configuration port
 * @fail_next: so many transfers end with DMASlvErr
 * @channels: MM2S, S2MM
 * @mc: MCDMA: channels behind them
 * @chen: MCDMA: CHEN of MM2S and S2MM
 * @errors: MCDMA: ERR of MM2S and S2MM
 * @tdest: MCDMA: of packets that come
 * @work: the engine at work
 * @camera: the next frame
 * @irqs: interrupt controller
 * @debugfs: its files
 * @trace: accesses, the last AXI_TRACE of them
 * @traced: accesses ever
 */
struct axi_engine {
	struct list_head node;
	u64 address;
	const char *label;
	u32 __iomem *mirror;
	spinlock_t lock; /* protects everything */
	bool vdma;
	bool mcdma;
	bool sg;
	u32 length_mask;
	u32 fstores;
	u32 park;
	enum axi_pl pl;
	u32 frame_length;
	u32 interval_us;
	u64 frames;
	struct axi_port port;
	u32 fail_next;
	struct axi_channel channels[2];
	struct axi_channel mc[2][AXI_MC_CHANNELS];
	u32 chen[2];
	u32 errors[2];
	u32 tdest;
	struct delayed_work work;
	struct delayed_work camera;
	struct irq_domain *irqs;
	struct dentry *debugfs;
	struct axi_access *trace;
	u64 traced;
};

/* bus.c: what the driver under test sees */
struct platform_device;
void __iomem *axi_model_map(struct platform_device *pdev);
u32 axi_model_read(const void __iomem *address);
void axi_model_write(u32 value, void __iomem *address);
void axi_bus_add(struct axi_engine *engine);
void axi_bus_remove(struct axi_engine *engine);
void axi_trace(struct axi_engine *engine, char what, u32 offset, u32 value);
void axi_mirror(struct axi_engine *engine);

/* dma.c */
void axi_reset_channel(struct axi_channel *channel);
u32 axi_status(const struct axi_channel *channel);
bool axi_running(const struct axi_channel *channel);
u32 axi_dma_read(struct axi_channel *channel, u32 offset);
void axi_dma_write(struct axi_channel *channel, u32 offset, u32 value);
bool axi_dma_step(struct axi_channel *channel);
void axi_write_control(struct axi_channel *channel, u32 value);
void axi_write_status(struct axi_channel *channel, u32 value);
void axi_raise(struct axi_channel *channel, u32 bits);
void axi_fail(struct axi_channel *channel, u32 error);
void axi_count_packet(struct axi_channel *channel);

/* vdma.c */
u32 axi_vdma_read(struct axi_channel *channel, u32 offset);
void axi_vdma_write(struct axi_channel *channel, u32 offset, u32 value);
bool axi_vdma_step(struct axi_channel *channel);

/* mcdma.c */
void axi_mcdma_reset(struct axi_engine *engine);
u32 axi_mcdma_read(struct axi_engine *engine, u32 offset);
void axi_mcdma_write(struct axi_engine *engine, u32 offset, u32 value);
bool axi_mcdma_step(struct axi_engine *engine);

/* stream.c */
struct axi_packet *axi_packet_new(size_t length, gfp_t flags);
struct axi_packet *axi_packet_first(struct axi_channel *channel);
void axi_packet_drop(struct axi_packet *packet);
void axi_stream_clear(struct axi_channel *channel);
void *axi_memory(u64 address, size_t length);

/* pl.c */
void axi_pl_sent(struct axi_engine *engine, struct axi_packet *packet);
void axi_pl_camera(struct work_struct *work);
void axi_pl_init(struct axi_engine *engine);
void axi_kick(struct axi_engine *engine);

/* clock.c */
extern struct platform_driver axi_clocks_driver;

/* manager.c */
extern struct platform_driver axi_manager_driver;

/* firmware.c */
struct dentry;
#ifdef CONFIG_ARM64
int axi_firmware_start(struct dentry *root);
#else
static inline int axi_firmware_start(struct dentry *root)
{
	return 0;
}
#endif

/* debugfs.c */
void axi_debugfs(struct axi_engine *engine, struct dentry *root);

#endif /* _CM_AXI_MODEL_H */
