/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What travels on the socket "data" in the runtime folder (docs/protocol.md, The data socket).
 *
 * A Unix SOCK_SEQPACKET socket; one connection is one reader or writer of one
 * stream.  Every packet begins with a struct cm_plane_descriptor, in the byte
 * order of the machine.  Most are nothing but that; the others say so.
 */
#ifndef CM_PLANE_WIRE_H
#define CM_PLANE_WIRE_H

#include <stdint.h>

#define CM_PLANE_SLOTS_MAX 256	 /* slots of one stream */
#define CM_PLANE_DIMENSIONS 8	 /* of a frame */
#define CM_PLANE_FDS_MAX 64	 /* descriptors in one packet */
#define CM_PLANE_PACKET_MAX 4096 /* bytes of any packet */
#define CM_PLANE_NAME_MAX 256	 /* bytes of a register's name, with its field */

/* from the client */
#define CM_PLANE_OPEN 1	   /* first packet; the stream's name follows */
#define CM_PLANE_RELEASE 2 /* a FRAME's descriptor, with this kind: the slot is given back */
#define CM_PLANE_SUBMIT 3  /* writer: send @length bytes at @offset of one of my slots */
#define CM_PLANE_PING 4	   /* comes back as PONG */
#define CM_PLANE_LEAVE 5   /* reader: no more frames; RELEASEs of those that are held follow */
#define CM_PLANE_READ 6	   /* a register, whose name follows (as in cm_read_reg) */

/* from the manager */
#define CM_PLANE_GEOMETRY 16 /* struct cm_plane_geometry and names follow: what comes now */
#define CM_PLANE_SLOTS 17 /* slots @slot to @slot + @offset - 1: one descriptor each (SCM_RIGHTS) */
#define CM_PLANE_FRAME 18 /* reader: a frame, leased until RELEASE */
#define CM_PLANE_GRANT 19 /* writer: the slot is the client's, for as long as the stream runs */
#define CM_PLANE_DONE 20  /* writer: the hardware has taken a SUBMIT; its @sequence comes back */
#define CM_PLANE_PONG 21
#define CM_PLANE_STOPPED 22 /* the stream stops (@offset: errno or 0); a GEOMETRY may follow */
#define CM_PLANE_LATE 23    /* a RELEASE of a slot that this client does not hold */
#define CM_PLANE_LABEL 24   /* names follow: frames from here on are of this mode */
#define CM_PLANE_REFUSED 25 /* code, NUL, sentence follow; the connection ends */
#define CM_PLANE_GENERATION \
	26 /* frames from here on began under generation @sequence of the registers */

#define CM_PLANE_ADDRESS 27 /* of memory that was asked for: @sequence is where devices see it */

/*
 * Registers that were asked for: @length bytes from physical address @sequence; @flags: CM_PLANE_WRITABLE.
 * Names follow: region, module, configuration, mode, lease.  Two descriptors come along: the pages, for
 * cm_grant_map() or mmap() (cm_window.h), and a file with a Config message (cm.proto) of the registers in them.
 */
#define CM_PLANE_WINDOW 28
/* They were taken back; @flags: why (CM_WINDOW_REVOKED_*).  Configuration and mode follow; the connection ends. */
#define CM_PLANE_REVOKED 29

#define CM_PLANE_REGISTERS 30 /* registers can be READ from now on */
/* of the READ with the same @sequence: @length is what the register or field holds */
#define CM_PLANE_VALUE 31
/* that READ has to be made by a request (cm_read_reg); the next one perhaps not */
#define CM_PLANE_ELSEWHERE 32

/* reader: @sequence transfers of the stream have failed since it began; each of them had a frame's number */
#define CM_PLANE_FAILED 33

/* flags of OPEN; those of other packets are the low bits of the epoch, which change with GEOMETRY */
#define CM_PLANE_OPEN_WRITE 1
#define CM_PLANE_OPEN_ECHO \
	2 /* no stream: @length bytes of memory; SUBMIT comes back as DONE at once */

#define CM_PLANE_OPEN_ALLOCATE \
	4 /* no stream: @length bytes in one piece for masters in the PL, until we hang up */

/* no stream: the registers of the module or region that is named, until we hang up; with WRITE to write too */
#define CM_PLANE_OPEN_WINDOW 8
#define CM_PLANE_OPEN_EXCLUSIVE 16 /* a window: with a lease on its region */
#define CM_PLANE_OPEN_WAIT 32	   /* a window: not refused while the module is not there */
#define CM_PLANE_OPEN_REGISTERS 64 /* no stream: READs of registers by name */
/*
 * Transfers from or into memory of our own: a SUBMIT has the address of the first byte, as ADDRESS says it, in
 * @timestamp_ns; DONE has the @length that was moved.  The stream is nobody else's meanwhile.
 */
#define CM_PLANE_OPEN_TRANSFER 128

/**
 * struct cm_plane_descriptor - 32 bytes
 * @slot: number of the slot; with OPEN: how many frames the client may hold (0: as many as is usual)
 * @kind: CM_PLANE_*
 * @flags: with OPEN: CM_PLANE_OPEN_*; else the epoch, modulo 256
 * @offset: first byte of the frame in its slot; with DONE: 0, or the errno of a failed transfer
 * @length: bytes of the frame
 * @sequence: number of the frame in its stream: a gap is a loss
 * @timestamp_ns: CLOCK_MONOTONIC when the transfer had ended
 */
struct cm_plane_descriptor {
	uint16_t slot;
	uint8_t kind;
	uint8_t flags;
	uint32_t offset;
	uint64_t length;
	uint64_t sequence;
	uint64_t timestamp_ns;
};

#define CM_PLANE_COHERENT 1u /* the CPU needs no DMA_BUF_IOCTL_SYNC */
#define CM_PLANE_WRITABLE 2u
#define CM_PLANE_CYCLIC 4u /* a written frame repeats: DONE says so, GRANT gives the slot back */

/**
 * struct cm_plane_geometry - behind the descriptor of GEOMETRY
 * @slot_length: bytes to map of every slot
 * @frame_length: bytes of a whole frame, 0 where packets have any length
 * @flags: CM_PLANE_COHERENT, CM_PLANE_WRITABLE, CM_PLANE_CYCLIC
 * @depth: slots that this client may hold
 * @stride: bytes from line to line in memory, 0 where lines follow each other
 * @dimensions: of @shape; 0: flat bytes
 * @shape: extents of a whole frame
 * @dtype: numpy's name of an element's type, NUL-terminated
 *
 * Behind it the names of stream, configuration and mode, and the pixels' format
 * if the stream has one, each with a NUL.
 */
struct cm_plane_geometry {
	uint64_t slot_length;
	uint64_t frame_length;
	uint32_t flags;
	uint32_t depth;
	uint32_t stride;
	uint32_t dimensions;
	uint32_t shape[CM_PLANE_DIMENSIONS];
	char dtype[16];
};

#endif /* CM_PLANE_WIRE_H */
