/* SPDX-License-Identifier: GPL-2.0-only */
/* Interrupt controllers of the PL that an overlay brings. */
#ifndef _CM_INTC_H
#define _CM_INTC_H

#include <linux/atomic.h>
#include <linux/irq.h>
#include <linux/platform_device.h>

extern struct platform_driver cm_polled_intc_driver;
extern struct platform_driver cm_axi_intc_driver;

/**
 * struct cm_intc - lines of a controller, which is the chip data of each
 * @chip: what they do
 * @count: how many, at most 32
 * @edges: a bit for each that is an edge; the others are levels
 * @taken: how many are requested
 * @domain: of the lines
 */
struct cm_intc {
	struct irq_chip *chip;
	u32 count;
	u32 edges;
	atomic_t taken;
	struct irq_domain *domain;
};

int cm_intc_add(struct cm_intc *intc, struct fwnode_handle *node);
bool cm_intc_remove(struct cm_intc *intc);

/* of each chip: who has a line keeps the module */
int cm_intc_request_resources(struct irq_data *data);
void cm_intc_release_resources(struct irq_data *data);

#endif /* _CM_INTC_H */
