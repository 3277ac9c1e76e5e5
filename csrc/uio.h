/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Registers and the interrupt of a UIO device.
 *
 * Errors, threads and simulated nodes: see node.h.  Register access of several
 * threads is not serialised on a real device: each is one bus access.
 */
#ifndef CM_SHIM_UIO_H
#define CM_SHIM_UIO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "uio_sysfs.h"

struct cm_uio;

/**
 * cm_uio_open() - open /dev/uio@number and map its windows
 *
 * The caller owns the result and closes it.  Errors: as cm_uio_describe(),
 * cm_node_open() and mmap().
 */
struct cm_uio *cm_uio_open(const char *root, unsigned int number);

/* By name ("uioN" or the device's name); see cm_uio_find_name(). */
struct cm_uio *cm_uio_open_by_name(const char *root, const char *name);

/* By physical address; see cm_uio_find_address(). */
struct cm_uio *cm_uio_open_by_address(const char *root, uint64_t address);

/* Unmap, close and free; @uio may be NULL. */
void cm_uio_close(struct cm_uio *uio);

/* What the device is; lives as long as @uio. */
const struct cm_uio_info *cm_uio_get_info(const struct cm_uio *uio);

/* See cm_node_event_fd(): polls readable when an interrupt waits. */
int cm_uio_event_fd(struct cm_uio *uio);

/* Close the device, free nothing; see cm_node_release().  Windows stay mapped till close. */
void cm_uio_release(struct cm_uio *uio);

/**
 * cm_uio_read() / cm_uio_write() - one access to a register
 * @map: number of the window
 * @offset: bytes from its start, multiple of the width
 * @width: 8, 16, 32 or 64 bits
 *
 * EINVAL for a range or width that is not there, ERANGE for a value wider than
 * @width; the bus is not touched then.  EIO where nobody answered on the bus, as
 * far as the processor learns of it at once; see bus.h.
 */
int cm_uio_read(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width,
		uint64_t *value);
int cm_uio_write(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width,
		 uint64_t value);

/* cm_uio_read() where it is a load, which never waits for another process: 1, or 0 if the node has to be asked. */
int cm_uio_load(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width,
		uint64_t *value);

/* Whether registers of a window are read by loads at all. */
bool cm_uio_loads(const struct cm_uio *uio, unsigned int map);

/* cm_uio_read() of at most 32 bits, which returns the value, or -1. */
int64_t cm_uio_read32(struct cm_uio *uio, unsigned int map, uint64_t offset, unsigned int width);

/**
 * cm_uio_read_block() / cm_uio_write_block() - several words of a window
 * @offset, @length: bytes, multiples of 4
 * @data: room for, or, @length bytes; little-endian as the window is
 *
 * One access of 32 bits for each word, in ascending order, never a burst, a
 * wider or a narrower one: an AXI-Lite slave need not take those.  Threads may
 * do other things with @uio meanwhile.  A call that fails may have done part.
 *
 * EINVAL for a range that is not there or not whole words, with nothing done.
 */
int cm_uio_read_block(struct cm_uio *uio, unsigned int map, uint64_t offset, void *data,
		      size_t length);
int cm_uio_write_block(struct cm_uio *uio, unsigned int map, uint64_t offset, const void *data,
		       size_t length);

/**
 * cm_uio_enable_interrupt() - let the next interrupt through
 *
 * uio_pdrv_genirq masks the interrupt when it comes; this unmasks it.
 * Errors: EIO where the device has no interrupt, ENOSYS where its driver has no
 * control over it (it is always on then).
 */
int cm_uio_enable_interrupt(struct cm_uio *uio);

/**
 * cm_uio_take() - take the interrupt that came, never blocks
 * @count: all interrupts of the device since its driver started, modulo 2^32
 *
 * Returns 1, or 0 if none came since the last take.  Errors: EIO where the
 * device has no interrupt, ENODEV if it is gone.
 */
int cm_uio_take(struct cm_uio *uio, uint32_t *count);

/**
 * cm_uio_wait() - as cm_uio_take(), but wait for one
 * @timeout_ns: see cm_node_wait()
 *
 * Errors: ETIMEDOUT, and those of cm_node_wait() and cm_uio_take().
 */
int cm_uio_wait(struct cm_uio *uio, int64_t timeout_ns, uint32_t *count);

#endif /* CM_SHIM_UIO_H */
