/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * Messages of a simulated node.
 *
 * A simulated board has, where a board has a character device, a listening
 * Unix SOCK_SEQPACKET socket.  One connection is one open file.  The server's
 * first packet is a struct cm_node_reply: op CM_NODE_OP_OPEN, error 0 or the
 * errno with which open() fails, and with SCM_RIGHTS one descriptor, the
 * event socket.  Where a device file would be read or polled, the event
 * socket is: one packet is what one read() would have returned (an
 * interrupt's u32 count, or one completion); writing to it is a write() of
 * the device file.
 *
 * After that every request is answered by exactly one reply, in order.  A
 * request is a struct cm_node_request and the ioctl's structure; where an
 * ioctl takes a file descriptor it travels as SCM_RIGHTS, and so does one
 * that it returns.  The reply's structure is that of the ioctl, as filled in.
 * A descriptor that stands for an open file of its own (a line of a GPIO chip,
 * a grant of a window) is a connection of this kind too, with its greeting under
 * way.  A grant's takes register accesses, counted from its first byte, and ends
 * them with ESTALE once it was taken back.
 * The connection's end is close().  The client shuts down its writing side and
 * waits until the server has closed its own, so a server first releases what
 * the file held and then closes: as with a driver's release(), the node can be
 * opened again when close() returns.  An attribute's client does not wait, and
 * its server may leave out the event socket.
 */
#ifndef _UAPI_CM_NODE_H
#define _UAPI_CM_NODE_H

#include <linux/types.h>

#define CM_NODE_PAYLOAD_MAX 65536

#define CM_NODE_OP_OPEN 0u /* first reply only */
/* any ioctl number of cm_dma.h, cm_icap.h, cm_window.h and linux/gpio.h is an op, and these: */
#define CM_NODE_OP_REG_READ 1u	 /* struct cm_node_reg */
#define CM_NODE_OP_REG_WRITE 2u	 /* struct cm_node_reg */
#define CM_NODE_OP_ATTR_READ 3u	 /* reply payload: the attribute's bytes */
#define CM_NODE_OP_ATTR_WRITE 4u /* request payload: the bytes */
#define CM_NODE_OP_MKDIR 5u	 /* payload: the name; sent to a folder's ".node" */
#define CM_NODE_OP_RMDIR 6u
#define CM_NODE_OP_MIRROR 7u /* struct cm_node_mirror; only where it is offered */
#define CM_NODE_OP_BLOCK_READ \
	8u /* struct cm_node_block; its reply: the bytes. Only where offered */
#define CM_NODE_OP_BLOCK_WRITE 9u /* struct cm_node_block and the bytes behind it; empty reply */

#define CM_NODE_OP_GRANT 10u /* struct cm_node_grant; of a grant's connection */

/* Bits of a greeting's flags. */
#define CM_NODE_OFFERS_MIRROR 1u
#define CM_NODE_OFFERS_BLOCKS 2u

#define CM_NODE_BLOCK_MAX \
	65520u /* bytes in one request: with struct cm_node_block a whole payload */

/**
 * struct cm_node_request - header of a request
 * @op: ioctl number or CM_NODE_OP_*
 * @length: bytes of payload behind this header
 */
struct cm_node_request {
	__u32 op;
	__u32 length;
};

/**
 * struct cm_node_reply - header of a reply
 * @op: as requested
 * @error: 0 or a positive errno
 * @length: bytes of payload behind this header
 * @flags: in the greeting CM_NODE_OFFERS_*, else 0
 */
struct cm_node_reply {
	__u32 op;
	__s32 error;
	__u32 length;
	__u32 flags;
};

/**
 * struct cm_node_reg - one access to a mapped register
 * @map: number of the UIO map
 * @width: 8, 16, 32 or 64 bits
 * @offset: bytes from the start of the map, multiple of the width
 * @value: written, or read
 */
struct cm_node_reg {
	__u32 map;
	__u32 width;
	__u64 offset;
	__u64 value;
};

/**
 * struct cm_node_block - several 32-bit words of a mapped window in one message
 * @map: number of the UIO map
 * @length: bytes, a multiple of 4 from 4 to CM_NODE_BLOCK_MAX
 * @offset: bytes from the start of the map, a multiple of 4
 *
 * Each word is one access of 32 bits, in ascending order, as if it had been
 * asked for by CM_NODE_OP_REG_READ or _WRITE; bytes are little-endian.
 */
struct cm_node_block {
	__u32 map;
	__u32 length;
	__u64 offset;
};

/**
 * struct cm_node_mirror - a UIO node's registers, as memory
 * @map: number of the UIO map
 * @fd: a memfd of twice @size bytes
 * @size: bytes of the window, in whole pages
 *
 * The memfd's first half is the window as a read finds it.  Where a byte of its
 * second half is not 0, the byte at the same place in the first is not what a
 * read would return, or a read does more than return it, and only
 * CM_NODE_OP_REG_READ will do.  A client maps it for reading, and looks at the
 * second half before and after it has read the first, and whether the
 * connection stands.  The server has changed it when it answers a write.
 * A node whose hardware has to see each access does not offer it.
 */
struct cm_node_mirror {
	__u32 map;
	__s32 fd;
	__u64 size;
};

/**
 * struct cm_node_grant - what a grant's connection is
 * @fd: a memfd of one page: struct cm_window_state, as page 0 of a real grant
 * @reserved: 0
 * @offset: of the grant's first byte in the window's mirror
 */
struct cm_node_grant {
	__s32 fd;
	__u32 reserved;
	__u64 offset;
};

#endif /* _UAPI_CM_NODE_H */
