// SPDX-License-Identifier: GPL-2.0-only
/* KUnit suite of the controller that polls: real lines and a real timer, words in memory. */
#include <linux/completion.h>
#include <linux/delay.h>
#include <linux/module.h>

#include "suites.h"

/* no node is to load this module */
#undef MODULE_DEVICE_TABLE
#define MODULE_DEVICE_TABLE(type, name)
#include "../intc/polled.c"

#define PENDING 0x7000
#define IDLE 0x3
#define BUSY 0

/**
 * struct core - what has the interrupt
 * @intc: controller
 * @word: its status word
 * @irq: its line
 * @calls: of its handler
 * @done: its handler ran
 * @deaf: the handler clears nothing
 */
struct core {
	struct polled_intc intc;
	u32 word;
	unsigned int irq;
	int calls;
	struct completion done;
	bool deaf;
};

static irqreturn_t handle(int irq, void *context)
{
	struct core *core = context;

	core->calls++;
	if (core->deaf)
		return IRQ_NONE;
	WRITE_ONCE(core->word, IDLE);
	complete(&core->done);
	return IRQ_HANDLED;
}

static int polled_suite_init(struct kunit *test)
{
	struct core *core = kunit_kzalloc(test, sizeof(*core), GFP_KERNEL);
	struct polled_intc *intc;

	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, core);
	test->priv = core;
	init_completion(&core->done);
	intc = &core->intc;
	polled_init(intc);
	intc->period_us = 500;
	intc->pending = PENDING;
	intc->idle = IDLE;
	intc->base.count = 1;
	intc->lines[0].status = (void __iomem *)&core->word;
	core->word = IDLE;
	KUNIT_ASSERT_EQ(test, cm_intc_add(&intc->base, NULL), 0);
	core->irq = irq_create_mapping(intc->base.domain, 0);
	KUNIT_ASSERT_EQ(test, request_irq(core->irq, handle, 0, "cm_polled_test", core), 0);
	return 0;
}

static void polled_suite_exit(struct kunit *test)
{
	struct core *core = test->priv;

	if (!core->irq)
		return;
	free_irq(core->irq, core);
	hrtimer_cancel(&core->intc.timer);
	KUNIT_EXPECT_TRUE(test, cm_intc_remove(&core->intc.base));
}

static void begin(struct core *core, u32 word)
{
	WRITE_ONCE(core->word, word);
	irq_set_irqchip_state(core->irq, IRQCHIP_STATE_PENDING, true);
}

static u64 looks(struct core *core)
{
	u64 looks;

	raw_spin_lock_irq(&core->intc.lock);
	looks = core->intc.looks;
	raw_spin_unlock_irq(&core->intc.lock);
	return looks;
}

/* @more: looks from now on */
static bool until_looked(struct core *core, u64 more)
{
	u64 enough = looks(core) + more;
	ktime_t late = ktime_add_ms(ktime_get(), 5000);

	while (looks(core) < enough && ktime_before(ktime_get(), late))
		usleep_range(100, 200);
	return looks(core) >= enough;
}

/* one that was not told: until it is at rest, or for ever */
static bool until_at_rest(struct core *core)
{
	ktime_t late = ktime_add_ms(ktime_get(), 5000);

	while (hrtimer_active(&core->intc.timer) && ktime_before(ktime_get(), late))
		usleep_range(100, 200);
	return !hrtimer_active(&core->intc.timer);
}

static void polled_looks_at_nothing_that_was_not_begun(struct kunit *test)
{
	struct core *core = test->priv;

	core->word = PENDING;
	KUNIT_EXPECT_FALSE(test, hrtimer_active(&core->intc.timer));
	disable_irq(core->irq);
	enable_irq(core->irq);
	KUNIT_EXPECT_FALSE(test, hrtimer_active(&core->intc.timer));
	KUNIT_EXPECT_EQ(test, core->intc.looks, 0ULL);
	KUNIT_EXPECT_EQ(test, core->calls, 0);
}

static void polled_finds_the_end_of_what_was_begun_and_rests(struct kunit *test)
{
	struct core *core = test->priv;

	begin(core, BUSY);
	KUNIT_ASSERT_TRUE(test, until_looked(core, 3));
	KUNIT_EXPECT_EQ(test, core->calls, 0);
	WRITE_ONCE(core->word, PENDING);
	KUNIT_ASSERT_NE(test, wait_for_completion_timeout(&core->done, 5 * HZ), 0UL);
	KUNIT_EXPECT_TRUE(test, until_at_rest(core));
	KUNIT_EXPECT_EQ(test, core->calls, 1);
}

/* the engine says that it is at rest before it says why */
static void polled_looks_once_more_at_a_core_at_rest(struct kunit *test)
{
	struct core *core = test->priv;

	begin(core, IDLE);
	KUNIT_ASSERT_TRUE(test, until_at_rest(core));
	KUNIT_EXPECT_EQ(test, core->intc.looks, 2ULL);
	KUNIT_EXPECT_EQ(test, core->calls, 0);
}

static void polled_leaves_off_when_told_so(struct kunit *test)
{
	struct core *core = test->priv;
	u64 before;

	begin(core, BUSY);
	KUNIT_ASSERT_TRUE(test, until_looked(core, 1));
	irq_set_irqchip_state(core->irq, IRQCHIP_STATE_PENDING, false);
	before = looks(core);
	KUNIT_EXPECT_TRUE(test, until_at_rest(core));
	KUNIT_EXPECT_EQ(test, looks(core), before);
}

static void polled_does_not_look_while_masked_and_does_afterwards(struct kunit *test)
{
	struct core *core = test->priv;

	begin(core, BUSY);
	disable_irq(core->irq);
	KUNIT_EXPECT_TRUE(test, until_at_rest(core));
	core->intc.looks = 0;
	begin(core, PENDING);
	KUNIT_EXPECT_FALSE(test, hrtimer_active(&core->intc.timer));
	KUNIT_EXPECT_EQ(test, core->intc.looks, 0ULL);
	enable_irq(core->irq);
	KUNIT_EXPECT_NE(test, wait_for_completion_timeout(&core->done, 5 * HZ), 0UL);
}

/* beginning something again and again must not put off the look */
static void polled_is_not_put_off(struct kunit *test)
{
	struct core *core = test->priv;
	ktime_t first;

	core->intc.period_us = PERIOD_MOST_US;
	begin(core, BUSY);
	first = READ_ONCE(core->intc.next);
	raw_spin_lock_irq(&core->intc.lock);
	look_by(&core->intc, ktime_add_ms(first, 1000));
	KUNIT_EXPECT_LE(test, ktime_to_ns(core->intc.next), ktime_to_ns(ktime_add_ms(first, 500)));
	raw_spin_unlock_irq(&core->intc.lock);
}

static void polled_line_that_nobody_clears_runs_its_handlers_again(struct kunit *test)
{
	struct core *core = test->priv;

	core->deaf = true;
	begin(core, PENDING);
	KUNIT_ASSERT_TRUE(test, until_looked(core, 10));
	core->deaf = false;
	KUNIT_EXPECT_NE(test, wait_for_completion_timeout(&core->done, 5 * HZ), 0UL);
	KUNIT_EXPECT_GE(test, core->calls, 10);
}

static void polled_has_no_other_state(struct kunit *test)
{
	struct core *core = test->priv;

	KUNIT_EXPECT_EQ(test, irq_set_irqchip_state(core->irq, IRQCHIP_STATE_MASKED, true),
			-EINVAL);
}

static struct kunit_case polled_cases[] = {
	KUNIT_CASE(polled_looks_at_nothing_that_was_not_begun),
	KUNIT_CASE(polled_finds_the_end_of_what_was_begun_and_rests),
	KUNIT_CASE(polled_looks_once_more_at_a_core_at_rest),
	KUNIT_CASE(polled_leaves_off_when_told_so),
	KUNIT_CASE(polled_does_not_look_while_masked_and_does_afterwards),
	KUNIT_CASE(polled_is_not_put_off),
	KUNIT_CASE(polled_line_that_nobody_clears_runs_its_handlers_again),
	KUNIT_CASE(polled_has_no_other_state),
	{}
};

struct kunit_suite cm_polled_suite = {
	.name = "cm_polled",
	.init = polled_suite_init,
	.exit = polled_suite_exit,
	.test_cases = polled_cases,
};
