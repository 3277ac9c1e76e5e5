/* SPDX-License-Identifier: GPL-2.0-only WITH Linux-syscall-note */
/*
 * /dev/cm_window: register pages of the programmable logic, on loan.
 *
 * Who has the node open lends pages to others: GRANT makes a descriptor that
 * can be mapped and nothing else, and that is given away with SCM_RIGHTS.  The
 * pages are taken back at once by REVOKE, by the end of the file that granted
 * them, when their device goes or is suspended, and when the bridge of their
 * window is disabled (fpga-region, cm_icap), before that decouples.
 *
 * A grant's descriptor is mapped shared.  Page 0 of it is struct
 * cm_window_state, read only; the registers begin at page 1.  Once a grant is
 * revoked the pages behind page 0 are memory of the grant's own, that reads as
 * ones.  So an access, and after it a look at @revoked, tell whether it was
 * one of the registers:
 *
 *	value = registers[k];	(and a barrier that keeps the order of loads)
 *	if (state->revoked)
 *		the value is not the module's
 *
 * What the hardware reads as, and what a write did, are the caller's until
 * then: no later access of a process reaches the bus, when REVOKE has returned.
 * A mapping is not inherited by fork(), cannot be made larger, and a grant that
 * is for reading cannot be mapped for writing.
 *
 * read() of the node returns as many whole struct cm_window_event as fit and
 * are there, of grants of this file; it blocks unless O_NONBLOCK is set
 * (-EAGAIN then), and poll() reports POLLIN when one waits.
 *
 * Structures begin with their size, as in cm_buffer.h.
 */
#ifndef _UAPI_CM_WINDOW_H
#define _UAPI_CM_WINDOW_H

#include "cm_buffer.h"

#define CM_WINDOW_GRANT_SIZE_VER0 32
#define CM_WINDOW_REVOKE_SIZE_VER0 32

#define CM_WINDOW_WRITE (1u << 0) /* the registers may be written */

/* why a grant ended; in struct cm_window_state and struct cm_window_event */
#define CM_WINDOW_REVOKED_CALL 1   /* REVOKE */
#define CM_WINDOW_REVOKED_BRIDGE 2 /* its region is decoupled */
#define CM_WINDOW_REVOKED_OWNER 3  /* the file that granted it was closed */
#define CM_WINDOW_REVOKED_GONE 4   /* its device was unbound */
#define CM_WINDOW_REVOKED_SLEEP 5  /* the system was suspended */
/* in an event only: the grant's last descriptor and mapping are gone */
#define CM_WINDOW_RELEASED 0

/**
 * struct cm_window_grant - lend pages of a window
 * @size: in: size of this structure in bytes
 * @flags: in: CM_WINDOW_WRITE, or 0 for reading only
 * @address: in: physical address, a multiple of the page size
 * @length: in: bytes, whole pages
 * @id: out: number of the grant, > 0, not given to another of this file
 * @fd: out: its descriptor (O_CLOEXEC); the caller gives it away, or closes it
 *
 * -ENXIO where no window has the whole range, -EINVAL where the range or the
 * window is not made of whole pages, -EPERM where the window's pages hold
 * registers of others too, -EAGAIN while its bridge is disabled or the system
 * goes to sleep, -ENOSPC for
 * more than 4096 grants of one file that were not released, or whose events
 * were not read.
 */
struct cm_window_grant {
	__u32 size;
	__u32 flags;
	__u64 address;
	__u64 length;
	__u32 id;
	__s32 fd;
};

/**
 * struct cm_window_revoke - take pages back
 * @size: in: size of this structure in bytes
 * @flags: in: must be 0
 * @address: in: physical address; 0 with an @id
 * @length: in: bytes: every grant of any file that touches the range; 0 with an @id
 * @id: in: this grant of this file alone (-ENOENT where there is none), or 0
 * @count: out: grants that were revoked, and had not been before
 *
 * When the call returns, no process has one of the pages mapped any more.
 */
struct cm_window_revoke {
	__u32 size;
	__u32 flags;
	__u64 address;
	__u64 length;
	__u32 id;
	__u32 count;
};

/**
 * struct cm_window_state - page 0 of a grant
 * @revoked: 0, or CM_WINDOW_REVOKED_* for good
 * @flags: CM_WINDOW_WRITE
 * @length: bytes of the registers, from page 1 on
 */
struct cm_window_state {
	__u32 revoked;
	__u32 flags;
	__u64 length;
};

/**
 * struct cm_window_event - what became of a grant, as read() returns it
 * @id: grant
 * @reason: CM_WINDOW_RELEASED, or CM_WINDOW_REVOKED_* but CALL and OWNER
 */
struct cm_window_event {
	__u32 id;
	__u32 reason;
};

#define CM_WINDOW_IOC_GRANT _IOWR(CM_IOC_MAGIC, 0x40, struct cm_window_grant)
#define CM_WINDOW_IOC_REVOKE _IOWR(CM_IOC_MAGIC, 0x41, struct cm_window_revoke)

#endif /* _UAPI_CM_WINDOW_H */
