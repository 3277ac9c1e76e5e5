/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * The interface of /dev/axidma, as programs built for the xilinx_axidma driver
 * use it: numbers and structures in memory, described anew.
 *
 * It has pointers and long words inside, so it is one of the native word size
 * only.  What the driver gave out of its own memory (name, chan) is 0 here.
 */
#ifndef _CM_AXIDMA_ABI_H
#define _CM_AXIDMA_ABI_H

#include <linux/ioctl.h>
#include <linux/types.h>

#define AXIDMA_ABI_MAGIC 'W'

#define AXIDMA_ABI_WRITE 0 /* memory to stream */
#define AXIDMA_ABI_READ 1

#define AXIDMA_ABI_DMA 0
#define AXIDMA_ABI_VDMA 1

struct axidma_abi_counts {
	__s32 channels;
	__s32 dma_tx;
	__s32 dma_rx;
	__s32 vdma_tx;
	__s32 vdma_rx;
};

struct axidma_abi_channel {
	__s32 direction;
	__s32 type;
	__s32 id;
	unsigned long name; /* always 0 */
	unsigned long chan; /* always 0 */
};

struct axidma_abi_channels {
	unsigned long array; /* user address of as many channels as counted */
};

struct axidma_abi_frame {
	__s32 height;
	__s32 width;
	__s32 depth; /* bytes of a pixel */
};

struct axidma_abi_register {
	__s32 fd;
	unsigned long size;
	unsigned long address;
};

struct axidma_abi_transfer {
	__u8 wait;
	__s32 id;
	unsigned long address;
	unsigned long length;
	struct axidma_abi_frame frame;
};

struct axidma_abi_two_way {
	__u8 wait;
	__s32 tx_id;
	unsigned long tx_address;
	unsigned long tx_length;
	struct axidma_abi_frame tx_frame;
	__s32 rx_id;
	unsigned long rx_address;
	unsigned long rx_length;
	struct axidma_abi_frame rx_frame;
};

struct axidma_abi_video {
	__s32 id;
	__s32 count;
	unsigned long array; /* user address of as many frame addresses */
	struct axidma_abi_frame frame;
};

#define AXIDMA_ABI_GET_COUNTS _IOW(AXIDMA_ABI_MAGIC, 0, struct axidma_abi_counts)
#define AXIDMA_ABI_GET_CHANNELS _IOR(AXIDMA_ABI_MAGIC, 1, struct axidma_abi_channels)
#define AXIDMA_ABI_SET_SIGNAL _IO(AXIDMA_ABI_MAGIC, 2)
#define AXIDMA_ABI_REGISTER _IOR(AXIDMA_ABI_MAGIC, 3, struct axidma_abi_register)
#define AXIDMA_ABI_DMA_READ _IOR(AXIDMA_ABI_MAGIC, 4, struct axidma_abi_transfer)
#define AXIDMA_ABI_DMA_WRITE _IOR(AXIDMA_ABI_MAGIC, 5, struct axidma_abi_transfer)
#define AXIDMA_ABI_DMA_TWO_WAY _IOR(AXIDMA_ABI_MAGIC, 6, struct axidma_abi_two_way)
#define AXIDMA_ABI_VIDEO_READ _IOR(AXIDMA_ABI_MAGIC, 7, struct axidma_abi_video)
#define AXIDMA_ABI_VIDEO_WRITE _IOR(AXIDMA_ABI_MAGIC, 8, struct axidma_abi_video)
#define AXIDMA_ABI_STOP _IOR(AXIDMA_ABI_MAGIC, 9, struct axidma_abi_channel)
#define AXIDMA_ABI_UNREGISTER _IO(AXIDMA_ABI_MAGIC, 10)

#endif /* _CM_AXIDMA_ABI_H */
