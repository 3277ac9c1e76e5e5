/* SPDX-License-Identifier: GPL-2.0-only */
/* /dev/axidma on top of cm_dma's channels: what the parts share. */
#ifndef _CM_AXIDMA_H
#define _CM_AXIDMA_H

#include <linux/list.h>
#include <linux/mutex.h>
#include <linux/workqueue.h>

#include "abi.h"
#include "cm_core.h"

#define AXIDMA_CHANNELS_MAX 32
#define AXIDMA_FRAMES_MAX 32

struct axidma_video;
struct platform_driver;

/**
 * struct axidma_channel - a channel as this interface numbers it
 * @channel: claimed; a reference is held
 * @id: number
 * @video: repeated frames, or NULL
 */
struct axidma_channel {
	struct cm_channel *channel;
	int id;
	struct axidma_video *video;
};

/**
 * struct axidma_file - one open file
 * @lock: protects @regions and each channel's @video
 * @regions: struct axidma_region: memory by user address
 * @signal: to be sent at the end of transfers without a waiter, or 0
 * @count: channels
 * @channels: channels
 */
struct axidma_file {
	struct mutex lock; /* protects regions and each channel's video */
	struct list_head regions;
	int signal;
	int count;
	struct axidma_channel channels[AXIDMA_CHANNELS_MAX];
};

/* channels.c */
int axidma_channels_claim(struct axidma_file *file);
void axidma_channels_release(struct axidma_file *file);
struct axidma_channel *axidma_channel_find(struct axidma_file *file, int id, u32 direction);
long axidma_get_counts(struct axidma_file *file, void __user *arg);
long axidma_get_channels(struct axidma_file *file, void __user *arg);

/* region.c */
int axidma_region_mmap(struct axidma_file *file, struct vm_area_struct *vma);
long axidma_region_register(struct axidma_file *file, void __user *arg);
long axidma_region_unregister(struct axidma_file *file, unsigned long address);
void axidma_regions_destroy(struct axidma_file *file);
struct cm_buffer *axidma_region_find(struct axidma_file *file, unsigned long address,
				     unsigned long length, u64 *offset);

/* tree.c */
struct cm_channel *axidma_tree_channel(int index, int *id);
extern struct platform_driver axidma_driver;

/* frame.c */
int axidma_frame_request(const struct axidma_abi_frame *frame, struct cm_request *request);

/* transfer.c */
long axidma_one_way(struct axidma_file *file, u32 direction, void __user *arg);
long axidma_two_way(struct axidma_file *file, void __user *arg);

/* video.c */
long axidma_video_start(struct axidma_file *file, u32 direction, void __user *arg);
long axidma_stop(struct axidma_file *file, void __user *arg);
void axidma_video_end(struct axidma_channel *channel);

#endif /* _CM_AXIDMA_H */
