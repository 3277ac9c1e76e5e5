/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * What the module cm_dma offers the other modules: buffers by handle, and DMA
 * channels that take one request as one descriptor.
 */
#ifndef _CM_CORE_H
#define _CM_CORE_H

#include <linux/device.h>
#include <linux/dma-mapping.h>
#include <linux/dmaengine.h>
#include <linux/kref.h>
#include <linux/list.h>
#include <linux/mutex.h>
#include <linux/spinlock.h>
#include <linux/wait.h>
#include <linux/workqueue.h>
#include <linux/xarray.h>

#include "cm_dma.h"

struct cm_active;
struct cm_budget;
struct cm_engine;
struct cm_pool;
struct cm_traits;
struct dma_buf;
struct dma_buf_attachment;
struct dentry;
struct sg_table;

/**
 * enum cm_buffer_kind - where a buffer's memory comes from
 * @CM_BUFFER_PAGES: cached pages; the CPU's accesses are synchronised
 * @CM_BUFFER_COHERENT: needs no synchronising; not cached where the device is not coherent
 * @CM_BUFFER_IMPORTED: somebody else's dma-buf
 */
enum cm_buffer_kind {
	CM_BUFFER_PAGES,
	CM_BUFFER_COHERENT,
	CM_BUFFER_IMPORTED,
};

/**
 * struct cm_buffer - memory that a device can reach
 * @ref: one for the handle, one for each exported dma-buf, one for each request
 * @dev: device the memory is mapped for; a reference is held
 * @budget: of the file that allocated it, or NULL
 * @node: in the list of those that are mapped
 * @mapped: for @dev; not any more where @dev has lost its driver
 * @unmapping: somebody is at it
 * @pool: what keeps memory of @dev's own assigned to it, or NULL
 * @kind: where the memory comes from
 * @length: bytes
 * @cpu: kernel address; NULL for imported buffers
 * @dma: address for the device; imported buffers have a list in @table instead
 * @coherent: the CPU sees what the device did without synchronising
 * @pages: cached pages that are this module's and not @dev's, or NULL
 * @pages_dma: what they are freed by
 * @in_flight: requests that use it now
 * @stale_lock: protects @stale_begin and @stale_end
 * @stale_begin: first byte that a device has written since the CPU last looked
 * @stale_end: behind the last one; equal to @stale_begin where there are none
 * @lock: protects @attachments, and @mapped of cached pages
 * @attachments: other devices that attached to the exported dma-buf
 * @dmabuf: imported: the buffer
 * @attachment: imported: of @dmabuf to @dev
 * @table: imported: its addresses for @dev
 * @direction: imported: what it is mapped for
 * @release: frees it, where the last reference went in atomic context
 */
struct cm_buffer {
	struct kref ref;
	struct device *dev;
	struct cm_budget *budget;
	struct list_head node;
	bool mapped;
	bool unmapping;
	struct cm_pool *pool;
	enum cm_buffer_kind kind;
	size_t length;
	void *cpu;
	dma_addr_t dma;
	bool coherent;
	struct page *pages;
	dma_addr_t pages_dma;
	atomic_t in_flight;
	spinlock_t stale_lock; /* protects stale_begin and stale_end */
	u64 stale_begin;
	u64 stale_end;
	struct mutex lock; /* protects attachments, and mapped */
	struct list_head attachments;
	struct dma_buf *dmabuf;
	struct dma_buf_attachment *attachment;
	struct sg_table *table;
	enum dma_data_direction direction;
	struct work_struct release;
};

struct cm_pool *cm_pool_assign(struct device *dev);
struct cm_pool *cm_pool_get(struct device *dev);
void cm_pool_put(struct cm_pool *pool);

struct cm_budget *cm_budget_new(void);
void cm_budget_put(struct cm_budget *budget);
int cm_budget_charge(struct cm_budget *budget, size_t length);
void cm_budget_uncharge(struct cm_budget *budget, size_t length);
u64 cm_budget_total(void);

int cm_buffers_init(void);
void cm_buffers_exit(void);
void cm_buffers_unmap(const struct device *dev);
struct cm_buffer *cm_buffer_alloc(struct device *dev, struct cm_budget *budget, u64 length);
struct cm_buffer *cm_buffer_alloc_coherent(struct device *dev, u64 length);
struct cm_buffer *cm_buffer_import(struct device *dev, int fd, enum dma_data_direction direction);
struct cm_buffer *cm_buffer_get(struct cm_buffer *buffer);
void cm_buffer_put(struct cm_buffer *buffer);
void cm_buffer_put_atomic(struct cm_buffer *buffer);
int cm_buffer_address(struct cm_buffer *buffer, u64 offset, u64 length, dma_addr_t *address);
int cm_buffer_mmap(struct cm_buffer *buffer, struct vm_area_struct *vma);
bool cm_buffer_coherent(struct cm_buffer *buffer);
void cm_buffer_written(struct cm_buffer *buffer, u64 offset, u64 length);
void cm_buffer_begin_read(struct cm_buffer *buffer, enum dma_data_direction direction);
u64 cm_buffers_synced(void);
u64 cm_buffers_mapped(void);
void cm_buffer_sync_for_cpu(struct cm_buffer *buffer, enum dma_data_direction direction);
void cm_buffer_sync_for_device(struct cm_buffer *buffer, enum dma_data_direction direction);
struct dma_buf *cm_buffer_export(struct cm_buffer *buffer);

/**
 * struct cm_buffer_table - the buffers of one open file, by handle
 * @lock: orders freeing against submitting
 * @buffers: handle to buffer; a handle is never 0
 * @budget: how much they may be
 */
struct cm_buffer_table {
	struct mutex lock; /* orders freeing against submitting */
	struct xarray buffers;
	struct cm_budget *budget;
};

int cm_buffer_table_init(struct cm_buffer_table *table);
void cm_buffer_table_destroy(struct cm_buffer_table *table);
void cm_buffer_table_unmap(struct cm_buffer_table *table);
struct cm_buffer *cm_buffer_table_get(struct cm_buffer_table *table, u32 handle);
long cm_buffer_ioctl_alloc(struct cm_buffer_table *table, struct device *dev, void __user *arg);
long cm_buffer_ioctl_import(struct cm_buffer_table *table, struct device *dev,
			    enum dma_data_direction direction, void __user *arg);
long cm_buffer_ioctl_free(struct cm_buffer_table *table, void __user *arg);

int cm_args_get(void *args, size_t size, size_t least, const void __user *from);
int cm_args_put(void __user *to, const void *args, size_t size);

/**
 * struct cm_result - how a transfer, or one period of a cyclic one, ended
 * @cookie: as in the request
 * @length: bytes moved
 * @timestamp_ns: CLOCK_MONOTONIC
 * @status: 0 or a negative errno
 * @readable: cyclic: completions whose data is not overwritten yet, at most
 * @last: nothing more comes for this request
 */
struct cm_result {
	u64 cookie;
	u64 length;
	u64 timestamp_ns;
	int status;
	u32 readable;
	bool last;
};

/**
 * struct cm_request - one transfer to be started
 * @buffer: memory
 * @offset: first byte
 * @length: bytes; with a video frame computed from its shape
 * @period: cyclic: bytes per completion
 * @lines: video: lines; 0 for a plain transfer
 * @line_bytes: video: bytes moved per line
 * @stride: video: bytes from line to line
 * @cyclic: repeat until cancelled
 * @cookie: for the result
 * @done: called once for each completion, in softirq context, or in the
 *        context of cm_channel_cancel() with its lock held
 * @context: for @done
 */
struct cm_request {
	struct cm_buffer *buffer;
	u64 offset;
	u64 length;
	u64 period;
	u32 lines;
	u32 line_bytes;
	u32 stride;
	bool cyclic;
	u64 cookie;
	void (*done)(void *context, const struct cm_result *result);
	void *context;
};

/**
 * struct cm_channel_config - what is known of a channel beforehand
 * @name: of the DMA channel (dma-names), and of the node
 * @direction: CM_DMA_MM2S or CM_DMA_S2MM
 * @type: CM_DMA_TYPE_*
 * @queue_depth: most transfers not yet read back
 * @max_length: most bytes of one transfer, 0 to ask the engine
 * @alignment: in bytes, 0 to ask the engine
 * @frame_length: usual bytes of one packet, or 0
 */
struct cm_channel_config {
	const char *name;
	u32 direction;
	u32 type;
	u32 queue_depth;
	u64 max_length;
	u32 alignment;
	u32 frame_length;
};

/**
 * struct cm_channel_stats - counters shown in debugfs
 * @submitted: requests handed to the engine
 * @completed: completions without an error, periods of cyclic ones included
 * @failed: completions with an error of the engine
 * @cancelled: requests ended by a cancel
 * @rearmed: times that the end of another channel of the engine reset this one
 * @bytes: bytes moved
 * @short_packets: completions with fewer bytes than asked for
 */
struct cm_channel_stats {
	u64 submitted;
	u64 completed;
	u64 failed;
	u64 cancelled;
	u64 rearmed;
	u64 bytes;
	u64 short_packets;
};

/**
 * struct cm_channel - one DMA channel of a device
 * @ref: references; the last put frees it, never before the device is unbound
 * @alloc_dev: device that buffers are allocated against; a reference is held
 * @pool: memory of @alloc_dev's own, or NULL; a reference is held
 * @dma_dev: the engine's device; a reference is held
 * @chan: the engine's channel; NULL once the device is gone
 * @info: what user space is told
 * @engine: what it shares with other channels; its lock orders submit, cancel,
 *          claim and the device's end
 * @traits: how the engine behaves
 * @siblings: in the engine's list
 * @claimed: the channel is in use
 * @shut: the system goes down; nothing is started any more
 * @active_lock: protects the members below
 * @active: requests under way, in order
 * @in_engine: transfers that the engine has
 * @stopping: nothing is given to the engine any more
 * @over: a frame that has ended, while the engine is being stopped
 * @settle: stops the engine, and tells the end of @over
 * @watch: looks for an error that is not reported
 * @stats: counters
 * @waiting: for the holder's use; woken when the device goes away
 */
struct cm_channel {
	struct kref ref;
	struct device *alloc_dev;
	struct cm_pool *pool;
	struct device *dma_dev;
	struct dma_chan *chan;
	struct cm_dma_info info;
	struct cm_engine *engine;
	struct cm_traits *traits;
	struct list_head siblings;
	bool claimed;
	bool shut;
	spinlock_t active_lock; /* protects the members below */
	struct list_head active;
	u32 in_engine;
	bool stopping;
	struct cm_active *over;
	struct work_struct settle;
	struct delayed_work watch;
	struct cm_channel_stats stats;
	wait_queue_head_t waiting;
};

int cm_request_check(const struct cm_dma_info *info, const struct cm_request *request);
u64 cm_request_footprint(const struct cm_request *request);
u32 cm_request_readable(const struct cm_request *request);
bool cm_channel_name_valid(const char *name);

struct cm_channel *cm_channel_create(struct device *dev, const struct cm_channel_config *config);
struct cm_channel *cm_channel_get(struct cm_channel *channel);
void cm_channel_put(struct cm_channel *channel);
void cm_channel_remove(struct cm_channel *channel);
int cm_channel_claim(struct cm_channel *channel);
void cm_channel_release(struct cm_channel *channel);
int cm_channel_submit(struct cm_channel *channel, const struct cm_request *request);
int cm_channel_cancel(struct cm_channel *channel);
void cm_channel_shutdown(struct cm_channel *channel);
enum dma_data_direction cm_channel_direction(const struct cm_channel *channel);
void cm_channel_debugfs(struct cm_channel *channel, struct dentry *parent);

struct cm_channel *cm_channel_find(const char *name);
struct cm_channel *cm_channel_next(struct cm_channel *previous);

#endif /* _CM_CORE_H */
