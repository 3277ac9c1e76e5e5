/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * /dev/cm_icap<N>: the internal configuration access port, fed by DMA.
 *
 * A load is started from a buffer and does not block; its end is read as one
 * struct cm_icap_completion (blocking unless O_NONBLOCK; poll() says POLLIN).
 * One load runs at a time (-EBUSY).  Any number of files may be open; a file
 * sees the completions of its own loads only, and closing it while one runs
 * waits for the end of that load: a port is never stopped half way.
 *
 * Where the port has a way back (CM_ICAP_CAP_READ), a read is started in the same
 * way and ends in the same way; it counts as a load for all of the above.
 */
#ifndef _UAPI_CM_ICAP_H
#define _UAPI_CM_ICAP_H

#include "cm_buffer.h"

#define CM_ICAP_INFO_SIZE_VER0 32
#define CM_ICAP_LOAD_SIZE_VER0 40
#define CM_ICAP_STATUS_SIZE_VER0 40
#define CM_ICAP_READ_SIZE_VER0 72

/**
 * struct cm_icap_info - what this port is
 * @size: in: size of this structure in bytes
 * @flags: in: must be 0
 * @word_bits: data width of the port, 32
 * @clock_hz: clock of the port, or 0 if unknown
 * @max_length: most bytes of one load
 * @idcode: IDCODE of the device if the driver knows it, else 0
 * @caps: CM_ICAP_CAP_* bits
 */
struct cm_icap_info {
	__u32 size;
	__u32 flags;
	__u32 word_bits;
	__u32 clock_hz;
	__u64 max_length;
	__u32 idcode;
	__u32 caps;
};

#define CM_ICAP_CAP_STATUS (1u << 0) /* the port's own status register can be read */
/* the platform's firmware said no when the driver asked for the port; loads end with -EACCES */
#define CM_ICAP_CAP_DENIED (1u << 1)
#define CM_ICAP_CAP_READ (1u << 2) /* words can be read from the port: CM_ICAP_IOC_READ */

#define CM_ICAP_LOAD_FULL (1u << 0)	 /* not partial */
#define CM_ICAP_LOAD_ENCRYPTED (1u << 1) /* payload is encrypted with the device's key */

/**
 * struct cm_icap_load - start a load
 * @size: in: size of this structure in bytes
 * @flags: in: CM_ICAP_LOAD_* bits; 0 is a plain partial bitstream
 * @handle: in: buffer
 * @reserved: must be 0
 * @offset: in: first byte, multiple of 4
 * @length: in: bytes, multiple of 4, > 0
 * @cookie: in: returned in the completion
 *
 * The words lie in memory as the port takes them from a little-endian bus:
 * the sync word reads 66 55 99 AA in memory order (a word-swapped .bin).
 *
 * -EBUSY while a load runs, or when 64 completions of this file wait to be read.
 * -EACCES where the platform's firmware does not give the port: nothing was
 * touched then, and bridges are as they were.
 */
struct cm_icap_load {
	__u32 size;
	__u32 flags;
	__u32 handle;
	__u32 reserved;
	__u64 offset;
	__u64 length;
	__u64 cookie;
};

/**
 * struct cm_icap_read - write to the port, read from it, and write once more
 * @size: in: size of this structure in bytes
 * @flags: in: must be 0
 * @handle: in: buffer that holds all three parts
 * @reserved: must be 0
 * @request_offset: in: first byte of the words that ask, multiple of 4
 * @request_length: in: bytes, multiple of 4, > 0
 * @reply_offset: in: where the words go that are read then, multiple of 4
 * @reply_length: in: bytes, multiple of 4, > 0
 * @closing_offset: in: first byte of the words written at the end, multiple of 4
 * @closing_length: in: bytes, multiple of 4, > 0
 * @cookie: in: returned in the completion
 *
 * What the words are is the caller's business: from the sync word to the header
 * of a read of FDRO with what has to follow it, the reply with its pad frame, and
 * the words that end with a DESYNC (UG470 chapter 6, UG570 chapter 10).  The
 * closing words are written also where the read failed, so that the port is left
 * as a load expects it.  All three have the byte order of loads in memory.
 * Bridges are left alone: reading does not disturb what runs.
 *
 * The completion's length is the bytes of the reply that came, its status
 * -ETIMEDOUT where fewer came than were asked for.
 *
 * -EBUSY as for a load.  -EINVAL for parts that are not in the buffer, or overlap.
 * -EMSGSIZE above max_length, for each part.  -EOPNOTSUPP without CM_ICAP_CAP_READ.
 * -EACCES as for a load.
 */
struct cm_icap_read {
	__u32 size;
	__u32 flags;
	__u32 handle;
	__u32 reserved;
	__u64 request_offset;
	__u64 request_length;
	__u64 reply_offset;
	__u64 reply_length;
	__u64 closing_offset;
	__u64 closing_length;
	__u64 cookie;
};

#define CM_ICAP_STATE_IDLE 0
#define CM_ICAP_STATE_LOADING 1 /* or reading */
#define CM_ICAP_STATE_ERROR 2	/* the last load failed */

/* error bits, those of the configuration status register (UG470 table 5-28) */
#define CM_ICAP_ERR_CRC (1u << 0)     /* CRC_ERROR */
#define CM_ICAP_ERR_ID (1u << 1)      /* ID_ERROR: IDCODE does not match */
#define CM_ICAP_ERR_DMA (1u << 2)     /* the DMA engine reported an error */
#define CM_ICAP_ERR_TIMEOUT (1u << 3) /* the port did not finish */
#define CM_ICAP_ERR_NOSYNC (1u << 4)  /* no sync word was seen */
#define CM_ICAP_ERR_PORT (1u << 5)    /* the port tells an error, and not its cause */

/**
 * struct cm_icap_status - what the port does now
 * @size: in: size of this structure in bytes
 * @flags: in: must be 0
 * @state: CM_ICAP_STATE_*
 * @errors: CM_ICAP_ERR_* bits of the last load
 * @bytes_done: of the running or last load, as far as the driver can tell
 * @bytes_total: of the running or last load
 * @loads: loads finished since the driver started
 */
struct cm_icap_status {
	__u32 size;
	__u32 flags;
	__u32 state;
	__u32 errors;
	__u64 bytes_done;
	__u64 bytes_total;
	__u64 loads;
};

/**
 * struct cm_icap_completion - one finished load or read, as read() returns it
 * @cookie: as given
 * @length: bytes taken by the port; of a read, bytes of the reply
 * @started_ns: CLOCK_MONOTONIC when the transfer was triggered
 * @finished_ns: CLOCK_MONOTONIC when the port was done
 * @status: 0, or a negative errno (-EIO, -EILSEQ CRC, -ENODEV wrong IDCODE,
 *          -ETIMEDOUT)
 * @errors: CM_ICAP_ERR_* bits
 */
struct cm_icap_completion {
	__u64 cookie;
	__u64 length;
	__u64 started_ns;
	__u64 finished_ns;
	__s32 status;
	__u32 errors;
};

#define CM_ICAP_IOC_INFO _IOWR(CM_IOC_MAGIC, 0x20, struct cm_icap_info)
#define CM_ICAP_IOC_ALLOC _IOWR(CM_IOC_MAGIC, 0x21, struct cm_buffer_alloc)
#define CM_ICAP_IOC_IMPORT _IOWR(CM_IOC_MAGIC, 0x22, struct cm_buffer_import)
#define CM_ICAP_IOC_FREE _IOW(CM_IOC_MAGIC, 0x23, struct cm_buffer_free)
#define CM_ICAP_IOC_LOAD _IOW(CM_IOC_MAGIC, 0x24, struct cm_icap_load)
#define CM_ICAP_IOC_STATUS _IOWR(CM_IOC_MAGIC, 0x25, struct cm_icap_status)
#define CM_ICAP_IOC_READ _IOW(CM_IOC_MAGIC, 0x26, struct cm_icap_read)

#endif /* _UAPI_CM_ICAP_H */
