/* SPDX-License-Identifier: Apache-2.0 */
#define CM_SIM_QUEUE ...

struct cm_sim_buffer {
	uint8_t *memory;
	uint64_t length;
	uint32_t handle;
	...;
};
struct cm_sim_transfer {
	uint64_t offset;
	uint64_t length;
	uint64_t cookie;
	uint32_t handle;
	...;
};
struct cm_dma_submit {
	uint32_t size;
	...;
};
struct cm_sim_channel {
	int32_t request_fd;
	int32_t event_fd;
	const struct cm_sim_buffer *buffers;
	uint32_t buffer_count;
	uint32_t packet_cost;
	uint64_t sent;
	uint64_t read;
	uint64_t sequence;
	uint64_t moved;
	uint32_t first;
	uint32_t count;
	struct cm_sim_transfer queue[...];
	bool owed;
	struct cm_dma_submit owed_submit;
	...;
};
struct cm_sim_fifo;

struct cm_sim_fifo *cm_sim_fifo_new(void);
void cm_sim_fifo_close(struct cm_sim_fifo *);
int cm_sim_fifo_event_fd(struct cm_sim_fifo *);
int cm_sim_fifo_run(struct cm_sim_fifo *, struct cm_sim_channel *, struct cm_sim_channel *);
void cm_sim_fifo_park(struct cm_sim_fifo *);
