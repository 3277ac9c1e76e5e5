// SPDX-License-Identifier: GPL-2.0-only
/* KUnit suite of the engines that channels share. */
#include <linux/device.h>
#include <linux/err.h>

#include "suites.h"

#include "../core/engine.c"

static const char axi_dma[] = "xlnx,axi-dma-1.00.a";

/* as the kernel's allocator gives it: the memory of one that is gone is the next one's */
static void engine_is_not_taken_for_one_that_was_at_its_address(struct kunit *test)
{
	struct property compatible = { .name = "compatible", .value = (void *)axi_dma,
				       .length = sizeof(axi_dma) };
	struct device_node node = { .properties = &compatible };
	/* without an owner: a module that is being loaded has no folder to link to */
	struct device *gone = __root_device_register("cm-kunit-gone", NULL);
	struct device *there = __root_device_register("cm-kunit-there", NULL);
	struct dma_device *memory = kunit_kzalloc(test, sizeof(*memory), GFP_KERNEL);
	struct dma_chan chan = { .device = memory };
	struct cm_engine *before, *now, *again;

	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, gone);
	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, there);
	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, memory);
	memory->dev = gone;
	before = cm_engine_get(&chan);
	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, before);
	root_device_unregister(gone);
	memory->dev = there;
	there->of_node = &node;
	now = cm_engine_get(&chan);
	again = cm_engine_get(&chan);
	there->of_node = NULL;
	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, now);
	KUNIT_EXPECT_PTR_NE(test, before, now);
	KUNIT_EXPECT_PTR_EQ(test, again, now);
	KUNIT_EXPECT_FALSE(test, before->shared_reset);
	KUNIT_EXPECT_TRUE(test, now->shared_reset);
	cm_engine_put(before);
	cm_engine_put(again);
	cm_engine_put(now);
	KUNIT_EXPECT_TRUE(test, list_empty(&engines));
	root_device_unregister(there);
}

static struct kunit_case engine_cases[] = {
	KUNIT_CASE(engine_is_not_taken_for_one_that_was_at_its_address),
	{}
};

struct kunit_suite cm_engine_suite = {
	.name = "cm_engine",
	.test_cases = engine_cases,
};
