/* SPDX-License-Identifier: GPL-2.0-only */
/* Overlays took a base node from 6.6 on; NULL is the whole tree. */
#ifndef _CM_OVERLAY_COMPAT_H
#define _CM_OVERLAY_COMPAT_H

#include <linux/of.h>
#include <linux/version.h>

static inline int cm_of_overlay_apply(void *blob, u32 length, int *id)
{
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 6, 0)
	return of_overlay_fdt_apply(blob, length, id, NULL);
#else
	return of_overlay_fdt_apply(blob, length, id);
#endif
}

#endif /* _CM_OVERLAY_COMPAT_H */
