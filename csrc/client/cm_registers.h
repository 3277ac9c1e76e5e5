/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Registers of a module in C, mapped: an access is a load or a store.
 *
 *	struct cm_registers *edge = cm_registers_open("/run/cm", "edge", CM_REGISTERS_WRITE, NULL);
 *	struct cm_register threshold;
 *
 *	if (cm_registers_wait(edge, 1000) == 1 && !cm_registers_find(edge, "threshold", &threshold))
 *		cm_register_write(edge, &threshold, 40);
 *	cm_registers_close(edge);
 *
 * A change of the module takes the pages back at once: every access ends with ESTALE then, and what was
 * read is not the register's (docs/registers.md).  Threads may share one, but not close it while another
 * uses it; writing a field is a read and a write.  Functions return -1 or NULL and set errno.
 */
#ifndef CM_REGISTERS_H
#define CM_REGISTERS_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct cm_registers;

#define CM_REGISTERS_WRITE 1u	  /* to write too */
#define CM_REGISTERS_EXCLUSIVE 2u /* with a lease on the region: nobody else writes meanwhile */
#define CM_REGISTERS_WAIT 4u /* not refused while the module is not there: it comes when it is */

#define CM_REGISTER_READS 1u  /* can be read */
#define CM_REGISTER_WRITES 2u /* can be written */

/**
 * struct cm_register - a register, or a field of one, as cm_registers_find() gives it
 * @offset: bytes from the first of the window's pages
 * @width: of the access, in bits: 8, 16, 32 or 64
 * @access: CM_REGISTER_*
 * @lsb: lowest bit of the field, 0 for a whole register
 * @mask: the field's bits, shifted down; all bits of a whole register
 * @kept: bits beside the field that are read, and written back with it; 0 for a whole register
 * @minimum: least value of the whole register that may be written
 * @maximum: greatest one
 *
 * A field of a register that cannot be read, or that reading changes, cannot be written by itself.
 */
struct cm_register {
	uint64_t offset;
	uint32_t width;
	uint32_t access;
	uint32_t lsb;
	uint32_t reserved;
	uint64_t mask;
	uint64_t kept;
	uint64_t minimum;
	uint64_t maximum;
};

/**
 * cm_registers_open() - ask for the registers of a module
 * @runtime_dir: the manager's runtime folder
 * @name: a module, a region, or "static"
 * @flags: CM_REGISTERS_*
 * @lease: id of one's own, where one holds the region; or NULL
 *
 * Returns at once: what is refused is told by cm_registers_wait().
 * Errors: those of socket() and connect(), ENAMETOOLONG, EINVAL for unknown flags.
 */
struct cm_registers *cm_registers_open(const char *runtime_dir, const char *name, uint32_t flags,
				       const char *lease);

/* Give the pages back.  NULL is fine. */
void cm_registers_close(struct cm_registers *registers);

/* Descriptor that polls readable when the pages come, and when they were taken back; owned by the window. */
int cm_registers_fd(const struct cm_registers *registers);

/**
 * cm_registers_wait() - wait for the pages
 * @timeout_ms: 0: only look, -1: for ever
 *
 * Returns 1 when they are there, or 0 if none came.  Errors: EACCES if the manager refused, see
 * cm_registers_error(); ESTALE if they were taken back; ECONNRESET if it has gone; EMFILE; EPROTO; EINTR.
 */
int cm_registers_wait(struct cm_registers *registers, int timeout_ms);

/**
 * cm_registers_find() - a register or field by its name ("control", "control.enable")
 *
 * Look names up once, before the loop that uses them.  Errors: ENOENT, EAGAIN before the pages are there.
 */
int cm_registers_find(const struct cm_registers *registers, const char *name,
		      struct cm_register *found);

/**
 * cm_register_read() / cm_register_write() - one access; writing a field reads the register before
 *
 * Errors: EAGAIN before the pages are there, ESTALE once they were taken back, EACCES for what cannot
 * be read, or written, here, ERANGE for a value below the minimum, above the maximum, or wider than the field.
 */
int cm_register_read(const struct cm_registers *registers, const struct cm_register *which,
		     uint64_t *value);
int cm_register_write(const struct cm_registers *registers, const struct cm_register *which,
		      uint64_t value);

/*
 * The mode that the board is in, or goes to: why the pages were taken back.  "" where it is not known.
 * Waits for the manager to say so where it has just taken them, a second at most.
 */
const char *cm_registers_mode(struct cm_registers *registers);

/* Module and region whose registers they are; "" before the pages are there. */
const char *cm_registers_module(const struct cm_registers *registers);
const char *cm_registers_region(const struct cm_registers *registers);

/* Why the manager refused: "code: sentence". */
const char *cm_registers_error(const struct cm_registers *registers);

#ifdef __cplusplus
}
#endif

#endif /* CM_REGISTERS_H */
