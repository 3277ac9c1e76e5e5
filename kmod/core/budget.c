// SPDX-License-Identifier: GPL-2.0-only
/*
 * How much memory may be allocated: contiguous pages are not swapped out, and
 * the kernel's killer does not see whose they are.
 *
 * A file's memory counts until it goes, which may be long after its handle was
 * freed, or the file closed: a dma-buf or a mapping keeps it.
 */
#include <linux/mm.h>
#include <linux/moduleparam.h>
#include <linux/slab.h>

#include "cm_core.h"

static unsigned long limit_mb;
module_param(limit_mb, ulong, 0644);
MODULE_PARM_DESC(limit_mb, "most MiB of all buffers together; 0: half of the memory");

static unsigned long file_limit_mb;
module_param(file_limit_mb, ulong, 0644);
MODULE_PARM_DESC(file_limit_mb, "most MiB of the buffers of one open file; 0: a quarter of the memory");

/**
 * struct cm_budget - what one open file has allocated
 * @ref: one of the file, one of each buffer
 * @bytes: allocated
 */
struct cm_budget {
	struct kref ref;
	atomic_long_t bytes;
};

static atomic_long_t total;

/**
 * cm_budget_new() - an open file's budget
 *
 * Return: a budget with one reference, for cm_budget_put(), or NULL.
 */
struct cm_budget *cm_budget_new(void)
{
	struct cm_budget *budget = kzalloc(sizeof(*budget), GFP_KERNEL);

	if (budget)
		kref_init(&budget->ref);
	return budget;
}

static void budget_free(struct kref *ref)
{
	kfree(container_of(ref, struct cm_budget, ref));
}

/**
 * cm_budget_put() - the file is closed
 * @budget: budget, or NULL
 */
void cm_budget_put(struct cm_budget *budget)
{
	if (budget)
		kref_put(&budget->ref, budget_free);
}

static unsigned long most_bytes(unsigned long mb, unsigned long share)
{
	u64 bytes = mb ? (u64)mb << 20 : (u64)totalram_pages() / share << PAGE_SHIFT;

	return min_t(u64, bytes, LONG_MAX);
}

static bool add(atomic_long_t *sum, size_t length, unsigned long most)
{
	if (atomic_long_add_return(length, sum) <= most)
		return true;
	atomic_long_sub(length, sum);
	return false;
}

/**
 * cm_budget_charge() - before memory is allocated
 * @budget: of the file that asks, or NULL for the module's limit alone
 * @length: bytes, at most 1 GiB
 *
 * Return: 0 or -ENOMEM above one of the limits.
 */
int cm_budget_charge(struct cm_budget *budget, size_t length)
{
	if (!add(&total, length, most_bytes(READ_ONCE(limit_mb), 2)))
		return -ENOMEM;
	if (!budget)
		return 0;
	if (!add(&budget->bytes, length, most_bytes(READ_ONCE(file_limit_mb), 4))) {
		atomic_long_sub(length, &total);
		return -ENOMEM;
	}
	kref_get(&budget->ref);
	return 0;
}

/**
 * cm_budget_uncharge() - the memory is free again
 * @budget: as it was charged
 * @length: likewise
 */
void cm_budget_uncharge(struct cm_budget *budget, size_t length)
{
	atomic_long_sub(length, &total);
	if (!budget)
		return;
	atomic_long_sub(length, &budget->bytes);
	cm_budget_put(budget);
}

/**
 * cm_budget_total() - how much is allocated now
 *
 * Return: bytes of all files.
 */
u64 cm_budget_total(void)
{
	return atomic_long_read(&total);
}
