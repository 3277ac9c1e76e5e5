/* SPDX-License-Identifier: GPL-2.0-only */
/* How cm_icap learns what its port did, beside the DMA engine's word. */
#ifndef _CM_ICAP_PORT_H
#define _CM_ICAP_PORT_H

#include <linux/bits.h>
#include <linux/types.h>

/*
 * The status register: the one definition, which cm_control.v, cm_plsim, the
 * binding and the tests are compared with (tests/unit/device/test_icap_status.py).
 *
 * Bits 0 and 2 as in HWICAP and HBICAP (SR, 0x110), which have no others.
 * FAILED: the port has an error output, and no cause of it (ICAPE2: CFGERR_B,
 * ICAPE3: PRERROR).  ERRORS: a wrapper that knows the cause.
 */
#define CM_ICAP_SR_DONE BIT(0)
#define CM_ICAP_SR_FAILED BIT(1)
#define CM_ICAP_SR_EOS BIT(2)
#define CM_ICAP_SR_ERRORS_SHIFT 8
#define CM_ICAP_SR_ERRORS GENMASK(12, 8) /* CM_ICAP_ERR_* */

/**
 * struct cm_icap_platform_data - a port without a device tree
 * @status: what reading the status register would give
 * @context: for @status
 * @full: the port takes full bitstreams too
 */
struct cm_icap_platform_data {
	u32 (*status)(void *context);
	void *context;
	bool full;
};

#endif /* _CM_ICAP_PORT_H */
