/* SPDX-License-Identifier: GPL-2.0-only */
/* Interrupt controllers of the PL that an overlay brings. */
#ifndef _CM_INTC_H
#define _CM_INTC_H

#include <linux/atomic.h>
#include <linux/platform_device.h>

struct irq_domain;

extern struct platform_driver cm_polled_intc_driver;
extern struct platform_driver cm_axi_intc_driver;

bool cm_intc_unused(const atomic_t *taken);
void cm_intc_remove_domain(struct irq_domain *domain, unsigned int count);

#endif /* _CM_INTC_H */
