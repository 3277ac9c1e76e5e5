/* SPDX-License-Identifier: Apache-2.0 */
struct cm_buffer {
	int fd;
	uint32_t handle;
	bool coherent;
	uint64_t length;
	uint64_t address;
	...;
};

void *cm_buffer_map(const struct cm_buffer *buffer, bool writable);
int cm_buffer_unmap(void *memory, uint64_t length);
int cm_buffer_sync(const struct cm_buffer *buffer, bool begin, bool write);
void cm_buffer_close(struct cm_buffer *buffer);
