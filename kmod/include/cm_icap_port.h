/* SPDX-License-Identifier: GPL-2.0-only */
/* How cm_icap learns what its port did, beside the DMA engine's word. */
#ifndef _CM_ICAP_PORT_H
#define _CM_ICAP_PORT_H

#include <linux/bits.h>
#include <linux/types.h>

/*
 * The status register: bits 0 and 2 as in HWICAP and HBICAP (SR, 0x110).  The
 * error bits are zero there; a wrapper that reads the port's own outputs may
 * have them.
 */
#define CM_ICAP_SR_DONE BIT(0)
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
