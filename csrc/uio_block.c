// SPDX-License-Identifier: Apache-2.0
#include <errno.h>
#include <string.h>

#include "bus.h"
#include "cm_node.h"
#include "uio_private.h"

/* Bytes after which a real device may be closed, and for which a simulated one gets one message. */
#define PIECE CM_NODE_BLOCK_MAX

struct message {
	struct cm_node_block block;
	unsigned char data[CM_NODE_BLOCK_MAX];
};

static int check_range(const struct cm_uio *uio, unsigned int map, uint64_t offset, size_t length)
{
	if (map < uio->info.map_count && offset % 4 == 0 && length % 4 == 0 &&
	    length <= uio->info.maps[map].size && offset <= uio->info.maps[map].size - length)
		return 0;
	errno = EINVAL;
	return -1;
}

/* Without block messages: one message for each word. */
static int read_words(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned char *data,
		      size_t length)
{
	size_t done;

	for (done = 0; done < length; done += 4) {
		uint64_t value;
		uint32_t word;

		if (cm_uio_read(uio, map, offset + done, 32, &value))
			return -1;
		word = (uint32_t)value;
		memcpy(data + done, &word, sizeof(word));
	}
	return 0;
}

static int write_words(struct cm_uio *uio, unsigned int map, uint64_t offset,
		       const unsigned char *data, size_t length)
{
	size_t done;

	for (done = 0; done < length; done += 4) {
		uint32_t word;

		memcpy(&word, data + done, sizeof(word));
		if (cm_uio_write(uio, map, offset + done, 32, word))
			return -1;
	}
	return 0;
}

static int ask_to_read(struct cm_uio *uio, unsigned int map, uint64_t offset, void *data,
		       size_t length)
{
	struct cm_node_block block = { .map = map, .length = (uint32_t)length, .offset = offset };

	if (!cm_node_offers(uio->node, CM_NODE_OFFERS_BLOCKS))
		return read_words(uio, map, offset, data, length);
	return cm_node_exchange(uio->node, CM_NODE_OP_BLOCK_READ, &block, sizeof(block), data,
				length);
}

static int ask_to_write(struct cm_uio *uio, unsigned int map, uint64_t offset, const void *data,
			size_t length)
{
	struct message message;

	if (!cm_node_offers(uio->node, CM_NODE_OFFERS_BLOCKS))
		return write_words(uio, map, offset, data, length);
	message.block = (struct cm_node_block){ map, (uint32_t)length, offset };
	memcpy(message.data, data, length);
	return cm_node_exchange(uio->node, CM_NODE_OP_BLOCK_WRITE, &message,
				sizeof(message.block) + length, NULL, 0);
}

static int read_piece(struct cm_uio *uio, unsigned int map, uint64_t offset, void *data,
		      size_t length)
{
	bool loaded = true;
	int result = 0;

	if (cm_node_enter(uio->node))
		return -1;
	if (!cm_node_simulated(uio->node))
		result = cm_bus_read_block(cm_uio_at(uio, map, offset), data, length);
	else
		loaded = map == 0 && uio->mirror.values &&
			 cm_mirror_read_block(&uio->mirror, offset, data, length) &&
			 cm_node_connected(uio->node);
	cm_node_leave(uio->node);
	return loaded ? result : ask_to_read(uio, map, offset, data, length);
}

static int write_piece(struct cm_uio *uio, unsigned int map, uint64_t offset, const void *data,
		       size_t length)
{
	int result;

	if (cm_node_simulated(uio->node))
		return ask_to_write(uio, map, offset, data, length);
	if (cm_node_enter(uio->node))
		return -1;
	result = cm_bus_write_block(cm_uio_at(uio, map, offset), data, length);
	cm_node_leave(uio->node);
	return result;
}

int cm_uio_read_block(struct cm_uio *uio, unsigned int map, uint64_t offset, void *data,
		      size_t length)
{
	size_t done, piece;

	if (check_range(uio, map, offset, length))
		return -1;
	for (done = 0; done < length; done += piece) {
		piece = length - done < PIECE ? length - done : PIECE;
		if (read_piece(uio, map, offset + done, (char *)data + done, piece))
			return -1;
	}
	return 0;
}

int cm_uio_write_block(struct cm_uio *uio, unsigned int map, uint64_t offset, const void *data,
		       size_t length)
{
	size_t done, piece;

	if (check_range(uio, map, offset, length))
		return -1;
	for (done = 0; done < length; done += piece) {
		piece = length - done < PIECE ? length - done : PIECE;
		if (write_piece(uio, map, offset + done, (const char *)data + done, piece))
			return -1;
	}
	return 0;
}
