/* SPDX-License-Identifier: GPL-2.0-only */
/* What cm_window offers to who has registers: windows whose pages can be lent. */
#ifndef _CM_WINDOW_CORE_H
#define _CM_WINDOW_CORE_H

#include <linux/types.h>

#include "cm_window.h"

struct cm_window;

/**
 * struct cm_window_config - one window
 * @address: physical address, as user space names it
 * @length: bytes
 * @refusal: 0, or the errno of each grant, where pages cannot be lent
 * @pfn: of a page of the window, counted from its first
 * @context: for @pfn
 * @memory: the pages are memory, and mapped as such
 */
struct cm_window_config {
	u64 address;
	u64 length;
	int refusal;
	unsigned long (*pfn)(void *context, unsigned long page);
	void *context;
	bool memory;
};

struct cm_window *cm_window_register(const struct cm_window_config *config);
void cm_window_unregister(struct cm_window *window);
void cm_window_shut(struct cm_window *window, u32 reason);
void cm_window_admit(struct cm_window *window);

#endif /* _CM_WINDOW_CORE_H */
