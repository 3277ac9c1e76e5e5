/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Accesses to mapped device memory behind which perhaps nobody answers.
 *
 * The kernel tells such an access by SIGBUS, which would end the process, and in
 * the manager's case all its clients.  Here it ends the access, with EIO.  That
 * needs a handler for the whole process; what it meets outside of these
 * functions goes to the handler that was there before, or ends the process.
 *
 * It cannot help where the processor learns of the error later (a write that was
 * posted: SError on arm64, an imprecise abort on ARM), or never (the bus hangs).
 */
#ifndef CM_SHIM_BUS_H
#define CM_SHIM_BUS_H

#include <stddef.h>
#include <stdint.h>

/* Have the handler, from now on; once is enough.  Errors: those of sigaction(). */
int cm_bus_watch(void);

/* As cm_mmio_read() and its kin; -1 with EIO where nobody answered. */
int cm_bus_read(const volatile void *at, unsigned int width, uint64_t *value);
int cm_bus_write(volatile void *at, unsigned int width, uint64_t value);
int cm_bus_read_block(const volatile void *from, void *data, size_t length);
int cm_bus_write_block(volatile void *to, const void *data, size_t length);

#endif /* CM_SHIM_BUS_H */
