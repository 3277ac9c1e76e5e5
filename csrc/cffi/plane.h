/* SPDX-License-Identifier: Apache-2.0 */
#define CM_PLANE_CLIENT_GONE ...
#define CM_PLANE_STREAM_LOST ...
#define CM_PLANE_CLIENT_LEAVES ...
#define CM_PLANE_RECENT ...

struct cm_plane;
struct cm_plane_event {
	uint32_t kind;
	int32_t id;
	int32_t error;
	...;
};
struct cm_plane_setup {
	bool write;
	bool backpressure;
	bool cyclic;
	uint32_t queue_depth;
	uint64_t length;
	uint32_t lines;
	uint32_t line_bytes;
	uint32_t stride;
	uint64_t period_ns;
	uint32_t lent;
	uint64_t address;
	...;
};
struct cm_plane_stats {
	uint64_t frames;
	uint64_t dropped;
	uint64_t errors;
	uint64_t bytes;
	uint64_t late;
	uint32_t held;
	uint32_t queued;
	uint32_t idle;
	int32_t error;
	uint32_t count;
	uint64_t asked;
	uint64_t came;
	uint64_t at_ns[...];
	uint64_t latency_ns[...];
	...;
};
struct cm_plane_client_stats {
	uint64_t frames;
	uint64_t dropped;
	uint32_t depth;
	uint32_t held;
	...;
};

struct cm_plane *cm_plane_new(void);
void cm_plane_close(struct cm_plane *plane);
int cm_plane_event_fd(struct cm_plane *plane);
int cm_plane_take(struct cm_plane *plane, struct cm_plane_event *event);
int cm_plane_start(struct cm_plane *plane, struct cm_dma *dma, const struct cm_plane_setup *setup);
int cm_plane_add_slot(struct cm_plane *plane, int stream, int fd, uint32_t handle);
int cm_plane_stop(struct cm_plane *plane, int stream, int error);
int cm_plane_adopt(struct cm_plane *plane, int fd);
int cm_plane_attach(struct cm_plane *plane, int client, int stream, uint32_t depth,
		    const void *packet, size_t size);
int cm_plane_tell(struct cm_plane *plane, int stream, const void *packet, size_t size);
void cm_plane_settle(struct cm_plane *plane);
void cm_plane_wrote(struct cm_plane *plane, uint64_t generation);
int cm_plane_drop(struct cm_plane *plane, int client);
int cm_plane_get_stats(struct cm_plane *plane, int stream, struct cm_plane_stats *stats);
int cm_plane_get_client_stats(struct cm_plane *plane, int client,
			      struct cm_plane_client_stats *stats);
