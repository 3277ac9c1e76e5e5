/* SPDX-License-Identifier: Apache-2.0 */
#define CM_WINDOW_WRITE ...
#define CM_WINDOW_RELEASED ...
#define CM_WINDOW_REVOKED_CALL ...
#define CM_WINDOW_REVOKED_BRIDGE ...
#define CM_WINDOW_REVOKED_OWNER ...
#define CM_WINDOW_REVOKED_GONE ...
#define CM_WINDOW_REVOKED_SLEEP ...

struct cm_window_event {
	uint32_t id;
	uint32_t reason;
};

struct cm_windows;
struct cm_windows *cm_windows_open(const char *root);
void cm_windows_close(struct cm_windows *windows);
int cm_windows_event_fd(struct cm_windows *windows);
void cm_windows_release(struct cm_windows *windows);
int cm_windows_grant(struct cm_windows *windows, uint64_t address, uint64_t length, uint32_t flags,
		     uint32_t *id);
int cm_windows_revoke(struct cm_windows *windows, uint64_t address, uint64_t length);
int cm_windows_revoke_one(struct cm_windows *windows, uint32_t id);
ssize_t cm_windows_take(struct cm_windows *windows, struct cm_window_event *events, size_t count);

struct cm_grant;
struct cm_grant *cm_grant_map(int fd);
void cm_grant_unmap(struct cm_grant *grant);
void cm_grant_release(struct cm_grant *grant);
uint64_t cm_grant_length(const struct cm_grant *grant);
int cm_grant_writable(const struct cm_grant *grant);
int cm_grant_revoked(const struct cm_grant *grant);
int cm_grant_read(struct cm_grant *grant, uint64_t offset, unsigned int width, uint64_t *value);
int cm_grant_write(struct cm_grant *grant, uint64_t offset, unsigned int width, uint64_t value);
int64_t cm_grant_read32(struct cm_grant *grant, uint64_t offset, unsigned int width);
int cm_grant_read_block(struct cm_grant *grant, uint64_t offset, void *data, size_t length);
int cm_grant_write_block(struct cm_grant *grant, uint64_t offset, const void *data, size_t length);
