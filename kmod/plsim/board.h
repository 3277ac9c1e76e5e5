/* SPDX-License-Identifier: GPL-2.0-only */
/* A simulated board as configfs describes it. */
#ifndef _CM_PLSIM_BOARD_H
#define _CM_PLSIM_BOARD_H

#include <linux/configfs.h>
#include <linux/list.h>
#include <linux/mutex.h>
#include <linux/platform_device.h>
#include <linux/property.h>

#include "cm_icap_port.h"
#include "plsim.h"

#define PLSIM_NAME_MAX 32
#define PLSIM_UIO_MAX 16
#define PLSIM_TIMEOUT_MS 2000 /* as of a port whose node says nothing */

/**
 * struct plsim_board - a folder in configfs, and its devices while it is live
 * @group: the folder
 * @channels_group: its folder "dma"
 * @uios_group: its folder "uio"
 * @lock: protects everything
 * @id: number in the names of its devices
 * @live: the devices exist
 * @channels: struct plsim_channel_item
 * @uios: struct plsim_uio_item
 * @engine_node: properties of the engine
 * @channel_nodes: properties of its channels
 * @engine: DMA engine
 * @client: its channels for user space
 * @port: the engine's port, for the loader
 * @icap: loader
 * @uio: register windows
 */
struct plsim_board {
	struct config_group group;
	struct config_group channels_group;
	struct config_group uios_group;
	struct mutex lock; /* protects everything */
	int id;
	bool live;
	struct list_head channels;
	struct list_head uios;
	struct fwnode_handle *engine_node;
	struct fwnode_handle *channel_nodes[PLSIM_CHANNELS_MAX];
	struct platform_device *engine;
	struct platform_device *client;
	struct plsim_port port;
	struct platform_device *icap;
	struct platform_device *uio[PLSIM_UIO_MAX];
};

/**
 * struct plsim_channel_item - a folder in "dma"
 * @item: folder; its name is the channel's
 * @board: board
 * @siblings: in the board's list
 * @number: assigned when the board becomes live
 * @kind: "loopback", "source", "sink", "icap" or "readback"
 * @peer: loopback: name of the other channel; readback: of the port's
 * @direction: CM_DMA_*; fixed by @kind but for loopback
 * @video: the client is told that this is a VDMA
 * @frame_length: source: bytes
 * @interval_us: source, cyclic: between frames
 * @fifo: loopback: bytes
 * @idcode: icap: of the device
 * @timeout_ms: icap: longest load
 */
struct plsim_channel_item {
	struct config_item item;
	struct plsim_board *board;
	struct list_head siblings;
	u32 number;
	char kind[PLSIM_NAME_MAX];
	char peer[PLSIM_NAME_MAX];
	u32 direction;
	u32 video;
	u32 frame_length;
	u32 interval_us;
	u32 fifo;
	u32 idcode;
	u32 timeout_ms;
};

/**
 * struct plsim_uio_item - a folder in "uio"
 * @item: folder; its name is the device's
 * @board: board
 * @siblings: in the board's list
 * @address: what sysfs shows as the address
 * @size: bytes
 * @doorbell: offset, or U32_MAX
 */
struct plsim_uio_item {
	struct config_item item;
	struct plsim_board *board;
	struct list_head siblings;
	u64 address;
	u32 size;
	u32 doorbell;
};

int plsim_board_activate(struct plsim_board *board);
void plsim_board_deactivate(struct plsim_board *board);

#endif /* _CM_PLSIM_BOARD_H */
