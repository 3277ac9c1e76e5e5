/* SPDX-License-Identifier: Apache-2.0 */
#define CM_DMA_MM2S ...
#define CM_DMA_S2MM ...
#define CM_DMA_TYPE_AXIDMA ...
#define CM_DMA_TYPE_VDMA ...
#define CM_DMA_CAP_CYCLIC ...
#define CM_DMA_CAP_VIDEO ...
#define CM_DMA_CAP_RESIDUE ...
#define CM_DMA_CAP_SIMPLE ...
#define CM_DMA_SUBMIT_CYCLIC ...
#define CM_DMA_COMPLETION_OVERRUN ...

struct cm_dma_info {
	uint32_t direction;
	uint32_t type;
	uint32_t caps;
	uint32_t queue_depth;
	uint64_t max_length;
	uint32_t alignment;
	uint32_t frame_length;
	uint8_t name[...];
	...;
};

struct cm_dma_completion {
	uint64_t cookie;
	uint64_t length;
	uint64_t timestamp_ns;
	uint64_t sequence;
	int32_t status;
	uint32_t flags;
	...;
};

struct cm_dma;
struct cm_dma *cm_dma_open(const char *root, const char *name);
void cm_dma_close(struct cm_dma *dma);
int cm_dma_event_fd(struct cm_dma *dma);
void cm_dma_release(struct cm_dma *dma);
int cm_dma_get_info(struct cm_dma *dma, struct cm_dma_info *info);
int cm_dma_alloc(struct cm_dma *dma, uint64_t length, struct cm_buffer *buffer);
int cm_dma_import(struct cm_dma *dma, int fd, struct cm_buffer *buffer);
int cm_dma_free(struct cm_dma *dma, uint32_t handle);
int cm_dma_submit(struct cm_dma *dma, uint32_t handle, uint64_t offset, uint64_t length,
		  uint64_t cookie, uint32_t flags, uint64_t period);
int cm_dma_submit_video(struct cm_dma *dma, uint32_t handle, uint64_t offset, uint32_t lines,
			uint32_t line_bytes, uint32_t stride, uint64_t cookie, uint32_t flags);
int cm_dma_cancel(struct cm_dma *dma);
ssize_t cm_dma_take(struct cm_dma *dma, struct cm_dma_completion *completions, size_t count);
int cm_dma_wait(struct cm_dma *dma, int64_t timeout_ns, struct cm_dma_completion *completion);
