/* SPDX-License-Identifier: Apache-2.0 */
#define CM_UIO_MAPS_MAX 5
#define CM_UIO_NAME_MAX 64

struct cm_uio_map {
	uint64_t address;
	uint64_t size;
	uint64_t offset;
	char name[CM_UIO_NAME_MAX];
	...;
};

struct cm_uio_info {
	unsigned int number;
	unsigned int map_count;
	char name[CM_UIO_NAME_MAX];
	struct cm_uio_map maps[CM_UIO_MAPS_MAX];
	...;
};

int cm_uio_describe(const char *root, unsigned int number, struct cm_uio_info *info);
int cm_uio_list(const char *root, unsigned int *numbers, size_t room);
int cm_uio_find_name(const char *root, const char *name, struct cm_uio_info *info);
int cm_uio_find_address(const char *root, uint64_t address, uint64_t length,
			struct cm_uio_info *info, unsigned int *map);

struct cm_uio;
struct cm_uio *cm_uio_open(const char *root, unsigned int number);
void cm_uio_close(struct cm_uio *uio);
int cm_uio_event_fd(struct cm_uio *uio);
void cm_uio_release(struct cm_uio *uio);
int cm_uio_read(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width,
		uint64_t *value);
bool cm_uio_loads(const struct cm_uio *uio, unsigned int map);
int64_t cm_uio_read32(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width);
int cm_uio_write(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width,
		 uint64_t value);
int cm_uio_read_block(struct cm_uio *uio, unsigned int map, uint64_t offset, void *data,
		      size_t length);
int cm_uio_write_block(struct cm_uio *uio, unsigned int map, uint64_t offset, const void *data,
		       size_t length);
int cm_uio_enable_interrupt(struct cm_uio *uio);
int cm_uio_take(struct cm_uio *uio, uint32_t *count);
int cm_uio_wait(struct cm_uio *uio, int64_t timeout_ns, uint32_t *count);
