// SPDX-License-Identifier: GPL-2.0-only
/* The lines of a controller, from its begin to its end. */
#include <linux/irqdomain.h>
#include <linux/module.h>

#include "intc.h"

int cm_intc_request_resources(struct irq_data *data)
{
	struct cm_intc *intc = irq_data_get_irq_chip_data(data);

	if (!try_module_get(THIS_MODULE))
		return -ENODEV;
	atomic_inc(&intc->taken);
	return 0;
}

void cm_intc_release_resources(struct irq_data *data)
{
	struct cm_intc *intc = irq_data_get_irq_chip_data(data);

	atomic_dec(&intc->taken);
	module_put(THIS_MODULE);
}

/*
 * A level is masked until its handlers, threads too, have ended; what none of
 * them clears is "nobody cared".  A line that is disabled is masked at once.
 */
static int map_line(struct irq_domain *domain, unsigned int irq, irq_hw_number_t line)
{
	struct cm_intc *intc = domain->host_data;
	bool edge = intc->edges & BIT(line);

	irq_set_chip_and_handler(irq, intc->chip, edge ? handle_edge_irq : handle_level_irq);
	irq_set_chip_data(irq, intc);
	irq_set_status_flags(irq, IRQ_NOPROBE | IRQ_DISABLE_UNLAZY | (edge ? 0 : IRQ_LEVEL));
	return 0;
}

static const struct irq_domain_ops domain_ops = {
	.map = map_line,
	/* a second cell says no more than the controller knows */
	.xlate = irq_domain_xlate_onetwocell,
};

int cm_intc_add(struct cm_intc *intc, struct fwnode_handle *node)
{
	intc->domain = irq_domain_create_linear(node, intc->count, &domain_ops, intc);
	return intc->domain ? 0 : -ENOMEM;
}

/**
 * cm_intc_remove() - the lines of a controller that goes
 * @intc: controller
 *
 * Return: false where an overlay has the engine before its controller, and so
 * removes it after that; the lines have to stay then, and say nothing.
 */
bool cm_intc_remove(struct cm_intc *intc)
{
	int taken = atomic_read(&intc->taken);
	u32 line;

	if (taken) {
		pr_err("cm_intc: a controller goes before %d of its users: put its node before theirs\n",
		       taken);
		return false;
	}
	for (line = 0; intc->domain && line < intc->count; line++)
		irq_dispose_mapping(irq_find_mapping(intc->domain, line));
	if (intc->domain)
		irq_domain_remove(intc->domain);
	return true;
}
