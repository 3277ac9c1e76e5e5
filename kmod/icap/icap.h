/* SPDX-License-Identifier: GPL-2.0-only */
/* A configuration port fed by DMA: what the parts of cm_icap share. */
#ifndef _CM_ICAP_PRIVATE_H
#define _CM_ICAP_PRIVATE_H

#include <linux/kref.h>
#include <linux/miscdevice.h>
#include <linux/mutex.h>
#include <linux/spinlock.h>
#include <linux/wait.h>
#include <linux/workqueue.h>

#include "cm_core.h"
#include "cm_icap.h"
#include "cm_icap_port.h"

struct fpga_manager;
struct platform_driver;

/**
 * struct cm_icap_request - one load
 * @buffer: words, as the port takes them; referenced while it runs
 * @offset: first byte
 * @length: bytes
 * @cookie: for the completion
 * @own_bridges: the bridges of the port's own node are disabled meanwhile
 * @done: called once at the end, in process context
 * @context: for @done
 */
struct cm_icap_request {
	struct cm_buffer *buffer;
	u64 offset;
	u64 length;
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
 * @info: what user space is told
 * @status_register: or NULL
 * @port: status without a register
 * @select: how the port is selected
 * @full: it takes full bitstreams
 * @timeout_ms: longest load
 * @hvc: ZynqMP: the firmware is called by HVC, not SMC
 * @devcfg: Zynq-7000: CTRL
 * @pcap_pr: Zynq-7000: PCAP_PR as it was before the load
 * @manager: FPGA manager
 * @lock: protects @gone, @status and the start of a load
 * @gone: the device is unbound
 * @status: as user space sees it
 * @request: load under way
 * @started_ns: when it was triggered
 * @deadline: when it should have ended, in jiffies
 * @work: ends a load, or finds that it did not end
 * @dma_lock: protects @dma_left and @dma_error
 * @dma_left: descriptors under way
 * @dma_error: first error of one
 * @idle: woken at the end of each load
 */
struct cm_icap {
	struct kref ref;
	struct device *dev;
	struct miscdevice misc;
	int id;
	char name[16];
	struct cm_channel *channel;
	struct cm_icap_info info;
	void __iomem *status_register;
	struct cm_icap_platform_data port;
	enum cm_icap_select select;
	bool full;
	u32 timeout_ms;
	bool hvc;
	void __iomem *devcfg;
	u32 pcap_pr;
	struct fpga_manager *manager;
	struct mutex lock; /* protects gone, status and the start of a load */
	bool gone;
	struct cm_icap_status status;
	struct cm_icap_request request;
	u64 started_ns;
	unsigned long deadline;
	struct delayed_work work;
	spinlock_t dma_lock; /* protects dma_left and dma_error */
	u32 dma_left;
	int dma_error;
	wait_queue_head_t idle;
};

void cm_icap_put(struct cm_icap *icap);

/* load.c */
int cm_icap_start(struct cm_icap *icap, const struct cm_icap_request *request);
void cm_icap_work(struct work_struct *work);
bool cm_icap_has_status(const struct cm_icap *icap);

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
extern struct platform_driver cm_decoupler_driver;

#endif /* _CM_ICAP_PRIVATE_H */
