/* SPDX-License-Identifier: Apache-2.0 */
#define CM_GUARD_CAUSES ...
#define CM_GUARD_NONE ...
#define CM_GUARD_REQUESTS ...
#define CM_GUARD_TOPICS ...
struct cm_guard_limits {
	uint32_t connections;
	uint32_t each;
	uint32_t newcomers;
	uint32_t descriptors;
	uint32_t parts;
	uint64_t bytes;
	uint32_t topics;
	...;
};
struct cm_guard_peer {
	uint64_t serial;
	int32_t fd;
	uint32_t kind;
	int32_t pid;
	uint32_t uid;
	uint32_t gid;
	uint8_t address[16];
	...;
};
struct cm_guard_counts {
	uint32_t connections;
	uint64_t refused[...];
	struct cm_guard_peer last;
	uint32_t last_cause;
	...;
};
int cm_guard_install(void);
void cm_guard_limit(const struct cm_guard_limits *limits);
void cm_guard_expect(uint32_t kind);
int cm_guard_peers(struct cm_guard_peer *peers, int max);
int cm_guard_peer(int fd, struct cm_guard_peer *peer);
uint64_t cm_guard_serial(int fd);
int cm_guard_cut(int fd);
void cm_guard_taken(int fd, uint64_t bytes);
void cm_guard_count(struct cm_guard_counts *counts);
int cm_guard_hold(int fd, int hold);
int cm_guard_cut_slowest(uint32_t kind);
void cm_guard_look_on(void);
