// SPDX-License-Identifier: GPL-2.0-only
/*
 * KUnit suite of the AXI INTC: its registers are a model written from PG099,
 * whose output is a level at the parent line.
 */
#include <linux/interrupt.h>
#include <linux/io.h>
#include <linux/irqdomain.h>
#include <linux/irq_work.h>
#include <linux/platform_device.h>

#include "suites.h"

static u32 model_read(const void __iomem *address);
static void model_write(u32 value, void __iomem *address);

#undef readl
#undef writel
#define readl model_read
#define writel model_write
/* no node is to load this module */
#undef MODULE_DEVICE_TABLE
#define MODULE_DEVICE_TABLE(type, name)
#include "../intc/axi.c"
#include "../intc/domain.c"

#define INPUTS 4
#define EDGE 3
#define RISES_MAX 100

/**
 * struct model - registers (PG099, "Register Space")
 * @isr: interrupts that came
 * @ier: those that are let through
 * @mer: master enable
 * @levels: inputs that are high now
 */
static struct model {
	u32 isr;
	u32 ier;
	u32 mer;
	u32 levels;
} model;

static struct axi_intc intc;
static int calls[INPUTS];

/* a level that is still high is in ISR again at once */
static void latch(void)
{
	model.isr |= model.levels;
}

static u32 model_read(const void __iomem *address)
{
	latch();
	switch ((unsigned long)address) {
	case ISR:
		return model.isr;
	case IER:
		return model.ier;
	case MER:
		return model.mer;
	}
	return 0;
}

static void model_write(u32 value, void __iomem *address)
{
	switch ((unsigned long)address) {
	case IER:
		model.ier = value;
		break;
	case SIE:
		model.ier |= value;
		break;
	case CIE:
		model.ier &= ~value;
		break;
	case IAR:
		model.isr &= ~value;
		break;
	case MER:
		model.mer = value;
		break;
	}
	latch();
}

static irqreturn_t source(int irq, void *context)
{
	u32 input = (unsigned long)context - 1;

	calls[input]++;
	model.levels &= ~BIT(input);
	return IRQ_HANDLED;
}

static unsigned int line(u32 input)
{
	return irq_find_mapping(intc.base.domain, input);
}

/* the output rises, as the parent's handler sees it */
static void rise(struct irq_work *work)
{
	generic_handle_irq(intc.parent);
}

static struct irq_work output = IRQ_WORK_INIT_HARD(rise);

static void raise(u32 inputs, bool level)
{
	int rises = 0;

	/* an edge is latched once, however long the input stays high */
	if (level)
		model.levels |= inputs & ~BIT(EDGE);
	model.isr |= inputs;
	while (model.isr & model.ier && model.mer == MER_ENABLE) {
		irq_work_queue(&output);
		irq_work_sync(&output);
		if (++rises > RISES_MAX)
			return; /* a storm */
	}
}

static int map_dummy(struct irq_domain *domain, unsigned int irq, irq_hw_number_t hwirq)
{
	irq_set_chip_and_handler(irq, &dummy_irq_chip, handle_simple_irq);
	return 0;
}

static const struct irq_domain_ops parent_ops = { .map = map_dummy };

static int axi_intc_suite_init(struct kunit *test)
{
	struct irq_domain *parent = irq_domain_create_linear(NULL, 1, &parent_ops, NULL);
	unsigned long i;

	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, parent);
	test->priv = parent;
	model = (struct model){ .isr = 5, .ier = ~0 };
	memset(calls, 0, sizeof(calls));
	intc = (struct axi_intc){ .base = { .count = INPUTS, .edges = BIT(EDGE) } };
	intc.parent = irq_create_mapping(parent, 0);
	KUNIT_ASSERT_EQ(test, axi_start(&intc, NULL), 0);
	for (i = 0; i < INPUTS; i++) {
		unsigned int irq = irq_create_mapping(intc.base.domain, i);

		KUNIT_ASSERT_EQ(test, request_irq(irq, source, 0, "cm_axi_intc_test",
						  (void *)(i + 1)), 0);
	}
	return 0;
}

static void axi_intc_suite_exit(struct kunit *test)
{
	struct irq_domain *parent = test->priv;
	unsigned long i;

	for (i = 0; i < INPUTS; i++)
		free_irq(line(i), (void *)(i + 1));
	axi_stop(&intc);
	irq_dispose_mapping(intc.parent);
	irq_domain_remove(parent);
}

static void axi_intc_starts_without_what_came_before(struct kunit *test)
{
	KUNIT_EXPECT_EQ(test, model.isr, 0U);
	KUNIT_EXPECT_EQ(test, model.mer, (u32)MER_ENABLE);
	/* those that were requested since, and no other */
	KUNIT_EXPECT_EQ(test, model.ier, (u32)BIT(INPUTS) - 1);
}

static void axi_intc_runs_the_handler_of_each_input_once(struct kunit *test)
{
	raise(BIT(0) | BIT(2) | BIT(EDGE), true);
	KUNIT_EXPECT_EQ(test, calls[0], 1);
	KUNIT_EXPECT_EQ(test, calls[1], 0);
	KUNIT_EXPECT_EQ(test, calls[2], 1);
	KUNIT_EXPECT_EQ(test, calls[EDGE], 1);
	KUNIT_EXPECT_EQ(test, model.isr, 0U);
}

static void axi_intc_level_is_acknowledged_when_its_source_is_low(struct kunit *test)
{
	raise(BIT(1), true);
	raise(BIT(1), true);
	KUNIT_EXPECT_EQ(test, calls[1], 2);
	KUNIT_EXPECT_EQ(test, model.isr, 0U);
	KUNIT_EXPECT_EQ(test, model.ier, (u32)BIT(INPUTS) - 1);
}

static void axi_intc_input_that_is_off_waits(struct kunit *test)
{
	disable_irq(line(2));
	KUNIT_EXPECT_EQ(test, model.ier & BIT(2), 0U);
	raise(BIT(2), true);
	KUNIT_EXPECT_EQ(test, calls[2], 0);
	enable_irq(line(2));
	raise(0, false);
	KUNIT_EXPECT_EQ(test, calls[2], 1);
}

static struct kunit_case axi_intc_cases[] = {
	KUNIT_CASE(axi_intc_starts_without_what_came_before),
	KUNIT_CASE(axi_intc_runs_the_handler_of_each_input_once),
	KUNIT_CASE(axi_intc_level_is_acknowledged_when_its_source_is_low),
	KUNIT_CASE(axi_intc_input_that_is_off_waits),
	{}
};

struct kunit_suite cm_axi_intc_suite = {
	.name = "cm_axi_intc",
	.init = axi_intc_suite_init,
	.exit = axi_intc_suite_exit,
	.test_cases = axi_intc_cases,
};
