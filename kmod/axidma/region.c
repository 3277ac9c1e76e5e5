// SPDX-License-Identifier: GPL-2.0-only
/* Memory, by the address that the program has it at. */
#include <linux/mm.h>
#include <linux/slab.h>
#include <linux/uaccess.h>

#include "axidma.h"
#include "cm_compat.h"

/**
 * struct axidma_region - memory of one mapping
 * @node: in the file's list
 * @file: file
 * @ref: mappings; a mapping may be split
 * @buffer: memory; transfers under way have references of their own
 * @address: user address of its first byte
 * @length: bytes
 * @imported: registered, not mapped here
 */
struct axidma_region {
	struct list_head node;
	struct axidma_file *file;
	struct kref ref;
	struct cm_buffer *buffer;
	unsigned long address;
	unsigned long length;
	bool imported;
};

static void region_release(struct kref *ref)
{
	struct axidma_region *region = container_of(ref, struct axidma_region, ref);

	mutex_lock(&region->file->lock);
	list_del(&region->node);
	mutex_unlock(&region->file->lock);
	cm_buffer_put(region->buffer);
	kfree(region);
}

static void region_vma_open(struct vm_area_struct *vma)
{
	struct axidma_region *region = vma->vm_private_data;

	kref_get(&region->ref);
}

static void region_vma_close(struct vm_area_struct *vma)
{
	struct axidma_region *region = vma->vm_private_data;

	kref_put(&region->ref, region_release);
}

static const struct vm_operations_struct region_vm_ops = {
	.open = region_vma_open,
	.close = region_vma_close,
};

static struct axidma_region *region_new(struct axidma_file *file, struct cm_buffer *buffer,
					unsigned long address, unsigned long length, bool imported)
{
	struct axidma_region *region = kzalloc(sizeof(*region), GFP_KERNEL);

	if (!region)
		return NULL;
	kref_init(&region->ref);
	region->file = file;
	region->buffer = buffer;
	region->address = address;
	region->length = length;
	region->imported = imported;
	return region;
}

static void region_add(struct axidma_region *region)
{
	mutex_lock(&region->file->lock);
	list_add(&region->node, &region->file->regions);
	mutex_unlock(&region->file->lock);
}

/**
 * axidma_region_mmap() - mmap() allocates
 * @file: file
 * @vma: range; its offset must be 0
 *
 * Return: 0 or a negative errno.
 */
int axidma_region_mmap(struct axidma_file *file, struct vm_area_struct *vma)
{
	struct axidma_region *region;
	struct cm_buffer *buffer;
	int ret;

	if (vma->vm_pgoff)
		return -EINVAL;
	buffer = cm_buffer_alloc_coherent(file->channels[0].channel->alloc_dev,
					  vma->vm_end - vma->vm_start);
	if (IS_ERR(buffer))
		return PTR_ERR(buffer);
	region = region_new(file, buffer, vma->vm_start, buffer->length, false);
	ret = region ? cm_buffer_mmap(buffer, vma) : -ENOMEM;
	if (ret) {
		kfree(region);
		cm_buffer_put(buffer);
		return ret;
	}
	/* a child would have the memory at an address that means nothing here */
	cm_vm_flags_set(vma, VM_DONTCOPY);
	vma->vm_ops = &region_vm_ops;
	vma->vm_private_data = region;
	region_add(region);
	return 0;
}

/**
 * axidma_region_register() - somebody else's dma-buf
 * @file: file
 * @arg: struct axidma_abi_register
 *
 * Return: 0, -EINVAL for a size that the buffer does not have, or another
 * negative errno.
 */
long axidma_region_register(struct axidma_file *file, void __user *arg)
{
	struct axidma_abi_register args;
	struct axidma_region *region;
	struct cm_buffer *buffer;

	if (copy_from_user(&args, arg, sizeof(args)))
		return -EFAULT;
	buffer = cm_buffer_import(file->channels[0].channel->dma_dev, args.fd, DMA_BIDIRECTIONAL);
	if (IS_ERR(buffer))
		return PTR_ERR(buffer);
	if (!args.size || args.size > buffer->length) {
		cm_buffer_put(buffer);
		return -EINVAL;
	}
	region = region_new(file, buffer, args.address, args.size, true);
	if (!region) {
		cm_buffer_put(buffer);
		return -ENOMEM;
	}
	region_add(region);
	return 0;
}

/**
 * axidma_region_unregister() - forget a registered buffer
 * @file: file
 * @address: as registered
 *
 * Return: 0 or -ENOENT.
 */
long axidma_region_unregister(struct axidma_file *file, unsigned long address)
{
	struct axidma_region *region, *found = NULL;

	mutex_lock(&file->lock);
	list_for_each_entry(region, &file->regions, node) {
		if (region->imported && region->address == address) {
			found = region;
			break;
		}
	}
	if (found)
		list_del_init(&found->node);
	mutex_unlock(&file->lock);
	if (!found)
		return -ENOENT;
	kref_put(&found->ref, region_release);
	return 0;
}

/**
 * axidma_regions_destroy() - what was registered and not forgotten
 * @file: file; all its mappings are gone
 */
void axidma_regions_destroy(struct axidma_file *file)
{
	struct axidma_region *region, *next;

	list_for_each_entry_safe(region, next, &file->regions, node)
		kref_put(&region->ref, region_release);
}

/**
 * axidma_region_find() - the memory behind a user address
 * @file: file
 * @address: first byte
 * @length: bytes
 * @offset: of @address in the buffer, filled in
 *
 * Return: the buffer with a reference for the caller, or NULL where the range
 * does not lie in one piece of memory of this file.
 */
struct cm_buffer *axidma_region_find(struct axidma_file *file, unsigned long address,
				     unsigned long length, u64 *offset)
{
	struct cm_buffer *buffer = NULL;
	struct axidma_region *region;

	mutex_lock(&file->lock);
	list_for_each_entry(region, &file->regions, node) {
		if (address < region->address || address - region->address > region->length ||
		    length > region->length - (address - region->address))
			continue;
		*offset = address - region->address;
		buffer = cm_buffer_get(region->buffer);
		break;
	}
	mutex_unlock(&file->lock);
	return buffer;
}
