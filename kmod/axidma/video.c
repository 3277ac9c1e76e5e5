// SPDX-License-Identifier: GPL-2.0-only
/* Frames that are repeated until they are stopped. */
#include <linux/slab.h>
#include <linux/uaccess.h>

#include "axidma.h"
#include "cm_compat.h"

/**
 * struct axidma_slot - one frame buffer
 * @video: all of them
 * @request: as it is submitted again and again; the buffer is referenced
 */
struct axidma_slot {
	struct axidma_video *video;
	struct cm_request request;
};

/**
 * struct axidma_video - the frames of a channel
 * @channel: channel
 * @work: submits what has ended
 * @lock: protects @begun, @stopping, @first and @ended
 * @begun: every slot was submitted once; what ends before waits for the others
 * @stopping: nothing is submitted any more
 * @first: number of the ended slot to be submitted next
 * @ended: slots that have ended and were not submitted again
 * @count: slots
 * @slots: in the order of the frames
 */
struct axidma_video {
	struct cm_channel *channel;
	struct work_struct work;
	spinlock_t lock; /* protects begun, stopping, first and ended */
	bool begun;
	bool stopping;
	int first;
	int ended;
	int count;
	struct axidma_slot slots[];
};

/* frames end in the order in which they were submitted */
static void slot_done(void *context, const struct cm_result *result)
{
	struct axidma_slot *slot = context;
	struct axidma_video *video = slot->video;

	spin_lock_bh(&video->lock);
	if (result->status)
		video->stopping = true;
	video->ended++;
	if (video->begun && !video->stopping)
		schedule_work(&video->work);
	spin_unlock_bh(&video->lock);
}

static struct axidma_slot *take_ended(struct axidma_video *video)
{
	struct axidma_slot *slot = NULL;

	spin_lock_bh(&video->lock);
	if (video->ended && !video->stopping) {
		slot = &video->slots[video->first];
		video->first = (video->first + 1) % video->count;
		video->ended--;
	}
	spin_unlock_bh(&video->lock);
	return slot;
}

static void video_stop(struct axidma_video *video)
{
	spin_lock_bh(&video->lock);
	video->stopping = true;
	spin_unlock_bh(&video->lock);
}

static void video_work(struct work_struct *work)
{
	struct axidma_video *video = container_of(work, struct axidma_video, work);
	struct axidma_slot *slot;

	while ((slot = take_ended(video))) {
		if (cm_channel_submit(video->channel, &slot->request))
			video_stop(video);
	}
}

static void video_free(struct axidma_video *video)
{
	int i;

	for (i = 0; i < video->count; i++) {
		if (video->slots[i].request.buffer)
			cm_buffer_put(video->slots[i].request.buffer);
	}
	kfree(video);
}

/**
 * axidma_video_end() - stop the frames of a channel
 * @channel: channel; nothing happens if it repeats none
 */
void axidma_video_end(struct axidma_channel *channel)
{
	struct axidma_video *video = channel->video;

	if (!video)
		return;
	channel->video = NULL;
	video_stop(video);
	cancel_work_sync(&video->work);
	cm_channel_cancel(channel->channel);
	video_free(video);
}

static int fill_slot(struct axidma_file *file, struct axidma_video *video,
		     struct axidma_slot *slot, const struct axidma_abi_frame *frame,
		     unsigned long address)
{
	struct cm_request *request = &slot->request;
	int ret = axidma_frame_request(frame, request);
	u64 bytes;

	if (ret)
		return ret;
	bytes = (u64)request->lines * request->line_bytes;
	if (bytes > ULONG_MAX)
		return -EINVAL;
	slot->video = video;
	request->done = slot_done;
	request->context = slot;
	request->buffer = axidma_region_find(file, address, bytes, &request->offset);
	return request->buffer ? 0 : -EFAULT;
}

static struct axidma_video *video_new(struct axidma_file *file, struct cm_channel *channel,
				      const struct axidma_abi_video *args)
{
	const unsigned long __user *array = (const unsigned long __user *)args->array;
	struct axidma_video *video;
	unsigned long address;
	int i, ret = 0;

	video = kzalloc(struct_size(video, slots, args->count), GFP_KERNEL);
	if (!video)
		return ERR_PTR(-ENOMEM);
	video->channel = channel;
	video->count = args->count;
	spin_lock_init(&video->lock);
	INIT_WORK(&video->work, video_work);
	for (i = 0; !ret && i < args->count; i++) {
		ret = get_user(address, array + i);
		if (!ret)
			ret = fill_slot(file, video, &video->slots[i], &args->frame, address);
	}
	if (!ret)
		return video;
	video_free(video);
	return ERR_PTR(ret);
}

static int video_begin(struct axidma_video *video)
{
	int i, ret = 0;

	for (i = 0; !ret && i < video->count; i++)
		ret = cm_channel_submit(video->channel, &video->slots[i].request);
	if (ret)
		return ret;
	/* a frame that ends meanwhile must not come twice before the others came once */
	spin_lock_bh(&video->lock);
	video->begun = true;
	if (video->ended && !video->stopping)
		schedule_work(&video->work);
	spin_unlock_bh(&video->lock);
	return 0;
}

/**
 * axidma_video_start() - AXIDMA_ABI_VIDEO_READ and AXIDMA_ABI_VIDEO_WRITE
 * @file: file
 * @direction: CM_DMA_*
 * @arg: struct axidma_abi_video
 *
 * Return: 0, -ENODEV for a channel that is not a VDMA of this direction,
 * -EBUSY where it repeats frames already, or another negative errno.
 */
long axidma_video_start(struct axidma_file *file, u32 direction, void __user *arg)
{
	struct axidma_channel *channel;
	struct axidma_video *video;
	struct axidma_abi_video args;
	int ret;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	channel = axidma_channel_find(file, args.id, direction);
	if (!channel || channel->channel->info.type != CM_DMA_TYPE_VDMA)
		return -ENODEV;
	if (args.count <= 0 || args.count > AXIDMA_FRAMES_MAX)
		return -EINVAL;
	video = video_new(file, channel->channel, &args);
	if (IS_ERR(video))
		return PTR_ERR(video);
	mutex_lock(&file->lock);
	if (channel->video) {
		ret = -EBUSY;
		video_free(video);
	} else {
		channel->video = video;
		ret = video_begin(video);
		if (ret)
			axidma_video_end(channel);
	}
	mutex_unlock(&file->lock);
	return ret;
}

/**
 * axidma_stop() - AXIDMA_ABI_STOP
 * @file: file
 * @arg: struct axidma_abi_channel
 *
 * Return: 0, -ENODEV for an unknown channel.
 */
long axidma_stop(struct axidma_file *file, void __user *arg)
{
	struct axidma_abi_channel args;
	struct axidma_channel *channel;
	int ret;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	channel = axidma_channel_find(file, args.id, 0);
	if (!channel)
		return -ENODEV;
	/* not the frames of a client that starts anew at this moment */
	mutex_lock(&file->lock);
	axidma_video_end(channel);
	ret = cm_channel_cancel(channel->channel);
	mutex_unlock(&file->lock);
	return ret;
}
