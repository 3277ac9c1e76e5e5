/* SPDX-License-Identifier: Apache-2.0 */
#define CM_ICAP_CAP_STATUS ...
#define CM_ICAP_CAP_DENIED ...
#define CM_ICAP_CAP_READ ...
#define CM_ICAP_LOAD_FULL ...
#define CM_ICAP_LOAD_ENCRYPTED ...
#define CM_ICAP_STATE_IDLE ...
#define CM_ICAP_STATE_LOADING ...
#define CM_ICAP_STATE_ERROR ...
#define CM_ICAP_ERR_CRC ...
#define CM_ICAP_ERR_ID ...
#define CM_ICAP_ERR_DMA ...
#define CM_ICAP_ERR_TIMEOUT ...
#define CM_ICAP_ERR_NOSYNC ...
#define CM_ICAP_ERR_PORT ...

struct cm_icap_info {
	uint32_t word_bits;
	uint32_t clock_hz;
	uint64_t max_length;
	uint32_t idcode;
	uint32_t caps;
	...;
};

struct cm_icap_status {
	uint32_t state;
	uint32_t errors;
	uint64_t bytes_done;
	uint64_t bytes_total;
	uint64_t loads;
	...;
};

struct cm_icap_completion {
	uint64_t cookie;
	uint64_t length;
	uint64_t started_ns;
	uint64_t finished_ns;
	int32_t status;
	uint32_t errors;
	...;
};

struct cm_icap_parts {
	uint64_t request_offset;
	uint64_t request_length;
	uint64_t reply_offset;
	uint64_t reply_length;
	uint64_t closing_offset;
	uint64_t closing_length;
};

struct cm_icap;
struct cm_icap *cm_icap_open(const char *root, const char *name);
void cm_icap_close(struct cm_icap *icap);
int cm_icap_event_fd(struct cm_icap *icap);
void cm_icap_release(struct cm_icap *icap);
int cm_icap_get_info(struct cm_icap *icap, struct cm_icap_info *info);
int cm_icap_get_status(struct cm_icap *icap, struct cm_icap_status *status);
int cm_icap_alloc(struct cm_icap *icap, uint64_t length, struct cm_buffer *buffer);
int cm_icap_import(struct cm_icap *icap, int fd, struct cm_buffer *buffer);
int cm_icap_free(struct cm_icap *icap, uint32_t handle);
int cm_icap_load(struct cm_icap *icap, uint32_t handle, uint64_t offset, uint64_t length,
		 uint64_t cookie, uint32_t flags);
int cm_icap_read_back(struct cm_icap *icap, uint32_t handle, const struct cm_icap_parts *parts,
		      uint64_t cookie);
int cm_icap_take(struct cm_icap *icap, struct cm_icap_completion *completion);
int cm_icap_wait(struct cm_icap *icap, int64_t timeout_ns, struct cm_icap_completion *completion);
