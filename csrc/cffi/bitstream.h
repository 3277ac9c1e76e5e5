/* SPDX-License-Identifier: Apache-2.0 */
/* What cm.device.native.bitstream calls of csrc/bitstream.h. */
enum cm_config_event_kind {
	CM_CONFIG_SYNC,
	CM_CONFIG_WRITE,
	CM_CONFIG_FRAMES,
	CM_CONFIG_MULTI,
	CM_CONFIG_CRC,
	CM_CONFIG_DESYNC,
	CM_CONFIG_FILL,
	CM_CONFIG_STRAY,
	CM_CONFIG_OPAQUE,
	CM_CONFIG_FAULT,
	...
};

struct cm_config_event {
	uint64_t word;
	uint32_t kind;
	uint32_t reg;
	uint32_t value;
	uint32_t count;
	uint32_t extra;
	uint32_t frames;
};

struct cm_config_port {
	uint64_t position;
	uint32_t crc;
	uint32_t far;
	uint32_t head_count;
	uint32_t head[...];
	...;
};

void cm_config_reset(struct cm_config_port *port, uint32_t capture);
size_t cm_config_feed(struct cm_config_port *port, const uint8_t *words, size_t count, int swapped,
		      struct cm_config_event *events, size_t capacity, size_t *made);
int cm_config_phase(const struct cm_config_port *port);
uint32_t cm_config_crc(uint32_t crc, uint32_t reg, const uint8_t *words, size_t count, int swapped);
void cm_config_swap(uint8_t *to, const uint8_t *from, size_t count);
