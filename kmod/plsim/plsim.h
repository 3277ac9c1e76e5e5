/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * The simulated programmable logic: what its parts know of each other.
 *
 * Every part is a platform device that reads its properties, whether they come
 * from a device tree or from configfs (configfs.c makes software nodes).
 */
#ifndef _CM_PLSIM_H
#define _CM_PLSIM_H

#include <linux/dmaengine.h>
#include <linux/list.h>
#include <linux/spinlock.h>
#include <linux/wait.h>
#include <linux/workqueue.h>

#include "configport.h"

#define PLSIM_CHANNELS_MAX 32

struct platform_device;
struct plsim_dma;

/**
 * enum plsim_kind - what is behind a DMA channel
 * @PLSIM_LOOPBACK: what the MM2S channel sends, its peer receives
 * @PLSIM_SOURCE: S2MM: frames of a pattern
 * @PLSIM_SINK: MM2S: takes all and counts
 * @PLSIM_ICAP: MM2S: a configuration port
 * @PLSIM_READBACK: S2MM: what comes back from it
 */
enum plsim_kind {
	PLSIM_LOOPBACK,
	PLSIM_SOURCE,
	PLSIM_SINK,
	PLSIM_ICAP,
	PLSIM_READBACK,
};

/**
 * struct plsim_faults - to be set in debugfs
 * @delay_us: before each transfer ends
 * @fail_next: so many transfers end with a DMA error
 * @short_next: the next packet has so many bytes; 0 leaves it
 * @hang: nothing moves while it is not 0
 */
struct plsim_faults {
	u32 delay_us;
	u32 fail_next;
	u32 short_next;
	u32 hang;
};

/**
 * struct plsim_packet - data between an MM2S channel and its peer
 * @node: in the peer's list
 * @length: bytes
 * @taken: bytes already received
 * @data: the bytes
 */
struct plsim_packet {
	struct list_head node;
	size_t length;
	size_t taken;
	u8 data[] __aligned(4);
};

/**
 * struct plsim_desc - a transfer: @lines pieces of memory
 * @tx: what the client has
 * @node: in one of the channel's lists
 * @address: of the first byte
 * @lines: pieces; 1 but for video frames
 * @line_bytes: bytes of a piece
 * @stride: bytes from piece to piece
 * @period: cyclic: bytes per callback; else 0
 * @done: bytes moved, in the period under way if cyclic
 * @position: cyclic: start of the period under way
 */
struct plsim_desc {
	struct dma_async_tx_descriptor tx;
	struct list_head node;
	dma_addr_t address;
	u32 lines;
	size_t line_bytes;
	size_t stride;
	size_t period;
	size_t done;
	size_t position;
};

/**
 * struct plsim_chan - a DMA channel
 * @chan: the framework's part
 * @dma: engine
 * @label: name
 * @kind: what is behind it
 * @direction: CM_DMA_MM2S or CM_DMA_S2MM
 * @peer: loopback: the other end; ICAP, readback: each other
 * @frame_length: source: bytes of a frame
 * @interval_us: source, cyclic: time between frames; 0 on demand
 * @fifo: loopback: bytes that wait at most between the ends
 * @lock: protects what follows
 * @submitted: not issued yet
 * @issued: to be done, in order
 * @current_desc: begun; NULL while @work has it in hand
 * @stopped: counts terminations, so that @work sees one
 * @packets: loopback: data that the S2MM end has not received
 * @packet_bytes: bytes in @packets
 * @work: moves data
 * @next_frame: source: when it is due, in ns
 * @faults: injected
 * @frames: source: frames made
 * @lost: source: frames without room
 * @bytes: bytes moved
 * @crc32: of the data of the last transfer (sink, ICAP)
 * @port: ICAP: the port
 * @loads: ICAP: loads taken
 * @reads: ICAP: answers given
 * @load_errors: ICAP: CM_ICAP_ERR_* of the last load
 * @load_words: ICAP: words of the last load
 * @inject_errors: ICAP: CM_ICAP_ERR_* that the next load ends with
 */
struct plsim_chan {
	struct dma_chan chan;
	struct plsim_dma *dma;
	const char *label;
	enum plsim_kind kind;
	u32 direction;
	struct plsim_chan *peer;
	u32 frame_length;
	u32 interval_us;
	u32 fifo;
	spinlock_t lock; /* protects what follows */
	struct list_head submitted;
	struct list_head issued;
	struct plsim_desc *current_desc;
	u32 stopped;
	struct list_head packets;
	size_t packet_bytes;
	struct delayed_work work;
	u64 next_frame;
	struct plsim_faults faults;
	u64 frames;
	u64 lost;
	u64 bytes;
	u32 crc32;
	struct cm_configport port;
	u64 loads;
	u64 reads;
	u32 load_errors;
	u32 load_words;
	u32 inject_errors;
};

/**
 * struct plsim_dma - a DMA engine
 * @device: the framework's part
 * @dev: platform device
 * @queue: where channels work
 * @debugfs: faults and reports
 * @status: ICAP's status register, if it lies in memory that others read too
 * @count: channels
 * @maps: names for clients without a device tree
 * @channels: channels
 */
struct plsim_dma {
	struct dma_device device;
	struct device *dev;
	struct workqueue_struct *queue;
	struct dentry *debugfs;
	u32 __iomem *status;
	int count;
	struct dma_slave_map *maps;
	struct plsim_chan channels[];
};

/**
 * struct plsim_port - a configuration port as its loader's driver knows it
 * @engine: platform device of the engine
 * @number: of its channel
 */
struct plsim_port {
	struct platform_device *engine;
	u32 number;
};

static inline struct plsim_chan *to_plsim_chan(struct dma_chan *chan)
{
	return container_of(chan, struct plsim_chan, chan);
}

static inline bool plsim_receives(const struct plsim_chan *chan)
{
	return chan->kind == PLSIM_SOURCE || chan->kind == PLSIM_READBACK ||
	       (chan->kind == PLSIM_LOOPBACK && chan->direction == 2);
}

/* move.c */
void plsim_work(struct work_struct *work);
void plsim_kick(struct plsim_chan *chan);
void plsim_drop_packets(struct plsim_chan *chan);
void plsim_give(struct plsim_chan *chan, struct plsim_packet *packet);

/* source.c */
struct plsim_packet *plsim_packet_new(size_t length);
struct plsim_packet *plsim_source_frame(struct plsim_chan *chan);
void plsim_pattern(u8 *data, size_t length, u64 frame);

/* icap.c */
void plsim_icap_take(struct plsim_chan *chan, const u8 *data, size_t length);
struct cm_icap_platform_data;
void plsim_icap_platform_data(struct plsim_port *port, struct cm_icap_platform_data *data);

/* debugfs.c */
void plsim_debugfs(struct plsim_dma *dma);
extern struct dentry *plsim_debugfs_root;

/* configfs.c */
int plsim_configfs_init(void);
void plsim_configfs_exit(void);

extern struct platform_driver plsim_dma_driver;
extern struct platform_driver plsim_uio_driver;

#endif /* _CM_PLSIM_H */
