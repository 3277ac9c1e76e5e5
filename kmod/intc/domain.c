// SPDX-License-Identifier: GPL-2.0-only
/* The end of a controller and its lines. */
#include <linux/irqdomain.h>
#include <linux/printk.h>

#include "intc.h"

/**
 * cm_intc_unused() - whether a controller that goes may be taken apart
 * @taken: its lines that are requested
 *
 * Return: false where an overlay has the engine before its controller, and so
 * removes it after that; the lines have to stay then, and say nothing.
 */
bool cm_intc_unused(const atomic_t *taken)
{
	int count = atomic_read(taken);

	if (count)
		pr_err("cm_intc: a controller goes before %d of its users: put its node before theirs\n",
		       count);
	return !count;
}

/**
 * cm_intc_remove_domain() - a controller of whose lines none is requested goes
 * @domain: domain
 * @count: lines
 */
void cm_intc_remove_domain(struct irq_domain *domain, unsigned int count)
{
	unsigned int i;

	for (i = 0; i < count; i++)
		irq_dispose_mapping(irq_find_mapping(domain, i));
	irq_domain_remove(domain);
}
