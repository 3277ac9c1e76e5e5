/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Registers that local clients read by name over the data socket, without a
 * request to the manager (client/cm_plane_wire.h: READ, VALUE, ELSEWHERE).
 *
 * One thread answers, a separate one from the plane's: where a bus hangs, that
 * thread does, and frames go on.  What is in the table is the caller's affair,
 * who withdraws it before a name may lead elsewhere.  Functions may be called
 * from any thread; they return -1 and set errno.
 */
#ifndef CM_SHIM_READS_H
#define CM_SHIM_READS_H

#include <stdint.h>

#include "uio.h"

#define CM_READS_EACH 96  /* connections of one user */
#define CM_READS_MOST 128 /* of all */

struct cm_reads;

/* Make an empty table and start its thread. */
struct cm_reads *cm_reads_new(void);

/* End the thread, hang up on all, and free; NULL is fine. */
void cm_reads_close(struct cm_reads *reads);

/*
 * Descriptor that polls readable once a client asked for what is not in the table, the first time since
 * it was withdrawn; an eventfd, which the caller reads.  Owned by @reads.
 */
int cm_reads_wanted_fd(struct cm_reads *reads);

/**
 * cm_reads_adopt() - take over a connected socket
 * @owner: the user at its other end
 *
 * Errors: EUSERS where it has as many as it may, or all together have; the descriptor stays the caller's then.
 */
int cm_reads_adopt(struct cm_reads *reads, int fd, int owner);

/**
 * struct cm_read - what a name stands for: bits of a register
 * @uio: stays the caller's, open until cm_reads_withdraw()
 * @map, @offset, @width: as for cm_uio_read()
 * @lsb, @mask: the value is (register & @mask) >> @lsb
 */
struct cm_read {
	struct cm_uio *uio;
	unsigned int map;
	unsigned int width;
	uint64_t offset;
	uint64_t mask;
	unsigned int lsb;
};

/**
 * cm_reads_offer() - clients may read @name from now on
 *
 * Errors: ETIMEDOUT where a read hangs, ENAMETOOLONG, EINVAL.
 */
int cm_reads_offer(struct cm_reads *reads, const char *name, const struct cm_read *read);

/* No name is in the table any more, and no read is under way, when it returns. */
void cm_reads_withdraw(struct cm_reads *reads);

#endif /* CM_SHIM_READS_H */
