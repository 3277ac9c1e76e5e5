/* SPDX-License-Identifier: GPL-2.0-only */
/* A configuration port fed by DMA: what the parts of cm_icap share. */
#ifndef _CM_ICAP_PRIVATE_H
#define _CM_ICAP_PRIVATE_H

#include <linux/completion.h>
#include <linux/kref.h>
#include <linux/miscdevice.h>
#include <linux/mutex.h>
#include <linux/spinlock.h>
#include <linux/wait.h>
#include <linux/workqueue.h>

#include "cm_core.h"
#include "cm_icap.h"
#include "cm_icap_port.h"

struct clk;
struct device_node;
struct fpga_manager;

/**
 * struct cm_icap_part - a range of a buffer
 * @offset: first byte
 * @length: bytes
 */
struct cm_icap_part {
	u64 offset;
	u64 length;
};

/**
 * struct cm_icap_request - one load, or one read
 * @buffer: words, as the port takes them; referenced while it runs
 * @words: what is written to the port
 * @reply: of a read: what comes from it then; a load has none
 * @closing: of a read: what is written at the end
 * @cookie: for the completion
 * @own_bridges: the bridges of the port's own node are disabled meanwhile
 * @done: called once at the end, in process context
 * @context: for @done
 */
struct cm_icap_request {
	struct cm_buffer *buffer;
	struct cm_icap_part words;
	struct cm_icap_part reply;
	struct cm_icap_part closing;
	u64 cookie;
	bool own_bridges;
	void (*done)(void *context, const struct cm_icap_completion *completion);
	void *context;
};

/**
 * enum cm_icap_select - how the port is given the configuration logic
 * @CM_SELECT_NONE: nothing to do
 * @CM_SELECT_ZYNQ: PCAP_PR in devcfg's CTRL
 * @CM_SELECT_ZYNQMP: PCAP_CTRL of the CSU, through the firmware
 */
enum cm_icap_select {
	CM_SELECT_NONE,
	CM_SELECT_ZYNQ,
	CM_SELECT_ZYNQMP,
};

/**
 * struct cm_icap - a port
 * @ref: one of the device, one of each open file
 * @dev: platform device
 * @misc: /dev/cm_icap<N>
 * @id: N
 * @name: of the node
 * @channel: MM2S channel, claimed for as long as the device is there
 * @back: S2MM channel, claimed as long, or NULL
 * @info: what user space is told
 * @status_register: or NULL
 * @port: status without a register
 * @select: how the port is selected
 * @full: it takes full bitstreams
 * @timeout_ms: longest load
 * @hvc: ZynqMP: the firmware is called by HVC, not SMC
 * @devcfg: Zynq-7000: CTRL
 * @devcfg_clock: Zynq-7000: of devcfg's registers
 * @pcap_pr: Zynq-7000: PCAP_PR as it was before the load
 * @platform: node of the platform's own FPGA manager; a reference is held
 * @held: that manager, during a load
 * @manager: FPGA manager
 * @start_lock: one start at a time
 * @lock: protects @gone and @status
 * @gone: the device is unbound
 * @status: as user space sees it
 * @state_before: state to go back to where nothing was touched
 * @request: load under way
 * @queue: runs @work
 * @work: one load
 * @started: it has begun, or failed to with @start_error
 * @start_error: 0 or a negative errno
 * @started_ns: when it was triggered
 * @sent: all descriptors have ended
 * @dma_lock: protects @dma_left and @dma_error
 * @dma_left: descriptors under way
 * @dma_error: first error of one
 * @received: the reply has ended, with @reply
 * @reply: how
 * @idle: woken at the end of each load
 */
struct cm_icap {
	struct kref ref;
	struct device *dev;
	struct miscdevice misc;
	int id;
	char name[16];
	struct cm_channel *channel;
	struct cm_channel *back;
	struct cm_icap_info info;
	void __iomem *status_register;
	struct cm_icap_platform_data port;
	enum cm_icap_select select;
	bool full;
	u32 timeout_ms;
	bool hvc;
	void __iomem *devcfg;
	struct clk *devcfg_clock;
	u32 pcap_pr;
	struct device_node *platform;
	struct fpga_manager *held;
	struct fpga_manager *manager;
	struct mutex start_lock; /* one start at a time */
	struct mutex lock; /* protects gone and status */
	bool gone;
	struct cm_icap_status status;
	u32 state_before;
	struct cm_icap_request request;
	struct workqueue_struct *queue;
	struct work_struct work;
	struct completion started;
	int start_error;
	u64 started_ns;
	struct completion sent;
	spinlock_t dma_lock; /* protects dma_left and dma_error */
	u32 dma_left;
	int dma_error;
	struct completion received;
	struct cm_result reply;
	wait_queue_head_t idle;
};

void cm_icap_put(struct cm_icap *icap);

/* load.c */
int cm_icap_start(struct cm_icap *icap, const struct cm_icap_request *request);
void cm_icap_work(struct work_struct *work);
bool cm_icap_has_status(const struct cm_icap *icap);
int cm_icap_part_check(struct cm_icap *icap, const struct cm_icap_request *request,
		       const struct cm_icap_part *part);
int cm_icap_send(struct cm_icap *icap, const struct cm_icap_part *part);
u32 cm_icap_await_sent(struct cm_icap *icap);
u32 cm_icap_port_errors(struct cm_icap *icap);

/* read.c */
int cm_icap_read_check(struct cm_icap *icap, const struct cm_icap_request *request);
int cm_icap_read_begin(struct cm_icap *icap);
u32 cm_icap_read_end(struct cm_icap *icap);

/* select.c */
int cm_icap_select_init(struct cm_icap *icap);
int cm_icap_select_port(struct cm_icap *icap);
void cm_icap_deselect_port(struct cm_icap *icap);

/* verdict.c */
int cm_icap_verdict(u32 errors);

/* bridges.c */
int cm_icap_bridges_init(struct cm_icap *icap);
int cm_icap_bridges_disable(struct cm_icap *icap);
int cm_icap_bridges_enable(struct cm_icap *icap);

/* manager.c */
int cm_icap_manager_init(struct cm_icap *icap);

extern const struct file_operations cm_icap_fops;

#endif /* _CM_ICAP_PRIVATE_H */
