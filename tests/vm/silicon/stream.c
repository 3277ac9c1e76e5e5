// SPDX-License-Identifier: GPL-2.0-only
/* Packets, and the memory that an engine reaches. */
#include <linux/io.h>
#include <linux/mm.h>
#include <linux/slab.h>

#include "model.h"

/**
 * axi_packet_new() - memory for a packet
 * @length: bytes
 * @flags: as for kmalloc()
 *
 * Return: a packet for axi_packet_drop(), or NULL.
 */
struct axi_packet *axi_packet_new(size_t length, gfp_t flags)
{
	struct axi_packet *packet = kmalloc(struct_size(packet, data, length), flags);

	if (packet) {
		INIT_LIST_HEAD(&packet->node);
		packet->length = length;
		packet->taken = 0;
		packet->tdest = 0;
	}
	return packet;
}

/**
 * axi_packet_first() - the packet that a channel receives next
 * @channel: channel; the engine's lock is held
 *
 * Return: the packet, or NULL.
 */
struct axi_packet *axi_packet_first(struct axi_channel *channel)
{
	return list_first_entry_or_null(&channel->stream, struct axi_packet, node);
}

/**
 * axi_packet_drop() - a packet is done with
 * @packet: packet, or NULL
 */
void axi_packet_drop(struct axi_packet *packet)
{
	if (!packet)
		return;
	list_del(&packet->node);
	kfree(packet);
}

/**
 * axi_stream_clear() - nothing waits any more
 * @channel: channel; the engine's lock is held
 */
void axi_stream_clear(struct axi_channel *channel)
{
	struct axi_packet *packet;

	while ((packet = axi_packet_first(channel)))
		axi_packet_drop(packet);
}

/**
 * axi_memory() - memory at a bus address
 * @address: as the engine has it; there is no IOMMU
 * @length: bytes
 *
 * Return: the kernel's view of it, in which KASAN sees what is freed, or NULL
 * where there is no memory: what the interconnect answers with DECERR.
 */
void *axi_memory(u64 address, size_t length)
{
	if (!length || !pfn_valid(PHYS_PFN(address)) ||
	    !pfn_valid(PHYS_PFN(address + length - 1)))
		return NULL;
	return phys_to_virt(address);
}
