// SPDX-License-Identifier: GPL-2.0-only
/*
 * Memory that a DMA device can reach: allocated here, or imported.
 *
 * It outlives the binding of the engine's driver, and a mapping for a device
 * without a driver is nobody's: behind an IOMMU its addresses are gone then.  So
 * pages are allocated for a device of this module's own, which always stands,
 * and mapped for the engine's; that mapping ends with the engine's last channel,
 * and the pages stay for those who have them.  Memory that a device tree sets
 * aside for a client is that client's, and is kept as pool.c says.
 */
#include <linux/dma-buf.h>
#include <linux/platform_device.h>
#include <linux/slab.h>
#include <linux/wait.h>

#include "channel.h"
#include "cm_compat.h"

struct workqueue_struct *cm_dma_workqueue;
static struct platform_device *owner; /* of the pages */
static LIST_HEAD(mapped);
static DEFINE_MUTEX(mapped_lock); /* protects mapped, and unmapping of each buffer */
static DECLARE_WAIT_QUEUE_HEAD(unmapped);
static atomic64_t synced;

/* charged to the caller's control group, where it is not of the CMA area */
#define CM_BUFFER_GFP (GFP_KERNEL_ACCOUNT | __GFP_NOWARN)

static void buffer_release_work(struct work_struct *work);

static struct cm_buffer *buffer_new(struct device *dev, enum cm_buffer_kind kind, size_t length)
{
	struct cm_buffer *buffer = kzalloc(sizeof(*buffer), GFP_KERNEL);

	if (!buffer)
		return NULL;
	kref_init(&buffer->ref);
	mutex_init(&buffer->lock);
	spin_lock_init(&buffer->stale_lock);
	INIT_LIST_HEAD(&buffer->attachments);
	INIT_LIST_HEAD(&buffer->node);
	INIT_WORK(&buffer->release, buffer_release_work);
	buffer->dev = get_device(dev);
	buffer->pool = cm_pool_get(dev);
	buffer->kind = kind;
	buffer->length = length;
	return buffer;
}

static void buffer_delete(struct cm_buffer *buffer)
{
	mutex_destroy(&buffer->lock);
	cm_pool_put(buffer->pool);
	put_device(buffer->dev);
	kfree(buffer);
}

/* a reserved pool that is not made of pages has only the coherent interface */
static bool has_coherent_pool(struct device *dev)
{
#ifdef CONFIG_DMA_DECLARE_COHERENT
	return dev->dma_mem;
#else
	return false;
#endif
}

static void set_mapped(struct cm_buffer *buffer)
{
	mutex_lock(&mapped_lock);
	buffer->mapped = true;
	list_add(&buffer->node, &mapped);
	mutex_unlock(&mapped_lock);
}

/* the caches are cared for apart from the mapping, as for other devices (dmabuf.c) */
static int fill_with_pages(struct cm_buffer *buffer)
{
	buffer->pages = dma_alloc_pages(&owner->dev, buffer->length, &buffer->pages_dma,
					DMA_BIDIRECTIONAL, CM_BUFFER_GFP);
	if (!buffer->pages)
		return -ENOMEM;
	/* never one, but DMA_API_DEBUG counts this as a mapping that was not checked */
	if (dma_mapping_error(&owner->dev, buffer->pages_dma))
		return -ENOMEM;
	buffer->cpu = page_address(buffer->pages);
	buffer->dma = dma_map_page_attrs(buffer->dev, buffer->pages, 0, buffer->length,
					 DMA_BIDIRECTIONAL, DMA_ATTR_SKIP_CPU_SYNC);
	if (dma_mapping_error(buffer->dev, buffer->dma)) {
		dma_free_pages(&owner->dev, buffer->length, buffer->pages, buffer->pages_dma,
			       DMA_BIDIRECTIONAL);
		return -ENOMEM;
	}
	set_mapped(buffer);
	return 0;
}

static int fill_from_pool(struct cm_buffer *buffer)
{
	buffer->cpu = dma_alloc_noncoherent(buffer->dev, buffer->length, &buffer->dma,
					    DMA_BIDIRECTIONAL, CM_BUFFER_GFP);
	if (!buffer->cpu)
		return -ENOMEM;
	buffer->mapped = true;
	return dma_mapping_error(buffer->dev, buffer->dma) ? -ENOMEM : 0;
}

static int fill_coherent(struct cm_buffer *buffer)
{
	buffer->kind = CM_BUFFER_COHERENT;
	buffer->coherent = true;
	buffer->cpu = dma_alloc_coherent(buffer->dev, buffer->length, &buffer->dma, CM_BUFFER_GFP);
	return buffer->cpu ? 0 : -ENOMEM;
}

static int buffer_fill(struct cm_buffer *buffer)
{
	int ret;

	if (buffer->kind == CM_BUFFER_COHERENT)
		return fill_coherent(buffer);
	ret = buffer->pool ? fill_from_pool(buffer) : fill_with_pages(buffer);
	/*
	 * A 32-bit board with more than 760 MB has its CMA area in high memory,
	 * of which dma_alloc_pages() takes nothing: the coherent interface maps it.
	 */
	if (ret && IS_ENABLED(CONFIG_HIGHMEM) && !buffer->pool)
		return fill_coherent(buffer);
	if (ret)
		return ret;
	buffer->coherent = !dma_need_sync(buffer->dev, buffer->dma);
	/* the zeroes must not come out of the cache on top of received data */
	dma_sync_single_for_device(buffer->dev, buffer->dma, buffer->length, DMA_BIDIRECTIONAL);
	return 0;
}

static struct cm_buffer *buffer_alloc(struct device *dev, struct cm_budget *budget, u64 length,
				      enum cm_buffer_kind kind)
{
	struct cm_buffer *buffer;
	int ret;

	if (!length)
		return ERR_PTR(-EINVAL);
	if (length > SZ_1G)
		return ERR_PTR(-ENOMEM);
	buffer = buffer_new(dev, kind, PAGE_ALIGN(length));
	if (!buffer)
		return ERR_PTR(-ENOMEM);
	ret = cm_budget_charge(budget, buffer->length);
	if (ret)
		goto no_budget;
	buffer->budget = budget;
	ret = buffer_fill(buffer);
	if (ret)
		goto no_memory;
	return buffer;

no_memory:
	cm_budget_uncharge(budget, buffer->length);
no_budget:
	buffer_delete(buffer);
	return ERR_PTR(ret);
}

/**
 * cm_buffer_alloc() - allocate contiguous, zeroed memory for a device
 * @dev: the DMA engine's device, or one with a memory-region of its own
 * @budget: of the file that asks, or NULL
 * @length: bytes wanted, rounded up to whole pages
 *
 * Return: a buffer with one reference, or an ERR_PTR: -EINVAL for no bytes,
 * -ENOMEM, also above a limit of budget.c.
 */
struct cm_buffer *cm_buffer_alloc(struct device *dev, struct cm_budget *budget, u64 length)
{
	return buffer_alloc(dev, budget, length,
			    has_coherent_pool(dev) ? CM_BUFFER_COHERENT : CM_BUFFER_PAGES);
}
EXPORT_SYMBOL_CM(cm_buffer_alloc);

/**
 * cm_buffer_alloc_coherent() - memory for programs that do not synchronise
 * @dev: the DMA engine's device, or one with a memory-region of its own
 * @length: bytes wanted, rounded up to whole pages
 *
 * Return: as cm_buffer_alloc().
 */
struct cm_buffer *cm_buffer_alloc_coherent(struct device *dev, u64 length)
{
	return buffer_alloc(dev, NULL, length, CM_BUFFER_COHERENT);
}
EXPORT_SYMBOL_CM(cm_buffer_alloc_coherent);

static int buffer_attach(struct cm_buffer *buffer)
{
	buffer->attachment = dma_buf_attach(buffer->dmabuf, buffer->dev);
	if (IS_ERR(buffer->attachment))
		return PTR_ERR(buffer->attachment);
	buffer->table = cm_map_attachment(buffer->attachment, buffer->direction);
	if (IS_ERR(buffer->table)) {
		dma_buf_detach(buffer->dmabuf, buffer->attachment);
		return PTR_ERR(buffer->table);
	}
	set_mapped(buffer);
	return 0;
}

/**
 * cm_buffer_import() - attach somebody else's dma-buf
 * @dev: the DMA engine's device
 * @fd: dma-buf file descriptor of the calling process
 * @direction: what the device will do with it
 *
 * Return: a buffer with one reference, or an ERR_PTR: what dma_buf_get() or
 * the exporter said.
 */
struct cm_buffer *cm_buffer_import(struct device *dev, int fd, enum dma_data_direction direction)
{
	struct dma_buf *dmabuf = dma_buf_get(fd);
	struct cm_buffer *buffer;
	int ret;

	if (IS_ERR(dmabuf))
		return ERR_CAST(dmabuf);
	buffer = buffer_new(dev, CM_BUFFER_IMPORTED, dmabuf->size);
	if (!buffer) {
		dma_buf_put(dmabuf);
		return ERR_PTR(-ENOMEM);
	}
	buffer->dmabuf = dmabuf;
	buffer->direction = direction;
	ret = buffer_attach(buffer);
	if (ret) {
		buffer_delete(buffer);
		dma_buf_put(dmabuf);
		return ERR_PTR(ret);
	}
	return buffer;
}
EXPORT_SYMBOL_CM(cm_buffer_import);

static void unmap_pages(struct cm_buffer *buffer)
{
	mutex_lock(&buffer->lock);
	buffer->mapped = false;
	dma_sync_single_for_cpu(buffer->dev, buffer->dma, buffer->length, DMA_BIDIRECTIONAL);
	dma_unmap_page_attrs(buffer->dev, buffer->dma, buffer->length, DMA_BIDIRECTIONAL,
			     DMA_ATTR_SKIP_CPU_SYNC);
	mutex_unlock(&buffer->lock);
}

/* nobody reads an imported buffer through us, and no request has it any more */
static void detach(struct cm_buffer *buffer)
{
	buffer->mapped = false;
	cm_unmap_attachment(buffer->attachment, buffer->table, buffer->direction);
	dma_buf_detach(buffer->dmabuf, buffer->attachment);
}

static bool is_unmapped(struct cm_buffer *buffer)
{
	bool gone;

	mutex_lock(&mapped_lock);
	gone = list_empty(&buffer->node);
	mutex_unlock(&mapped_lock);
	return gone;
}

/* without our lock: the exporter of an imported buffer takes its own.  Who comes second waits. */
static void buffer_unmap(struct cm_buffer *buffer)
{
	bool first;

	mutex_lock(&mapped_lock);
	first = !list_empty(&buffer->node) && !buffer->unmapping;
	if (first)
		buffer->unmapping = true;
	mutex_unlock(&mapped_lock);
	if (!first) {
		wait_event(unmapped, is_unmapped(buffer));
		return;
	}
	if (buffer->kind == CM_BUFFER_IMPORTED)
		detach(buffer);
	else
		unmap_pages(buffer);
	mutex_lock(&mapped_lock);
	list_del_init(&buffer->node);
	mutex_unlock(&mapped_lock);
	wake_up_all(&unmapped);
}

/* one that is mapped for @dev, with a reference; those that are going already are not counted */
static struct cm_buffer *mapped_for(const struct device *dev)
{
	struct cm_buffer *buffer, *found = NULL;

	mutex_lock(&mapped_lock);
	list_for_each_entry(buffer, &mapped, node) {
		if (buffer->dev == dev && kref_get_unless_zero(&buffer->ref)) {
			found = buffer;
			break;
		}
	}
	mutex_unlock(&mapped_lock);
	return found;
}

static bool none_mapped_for(const struct device *dev)
{
	struct cm_buffer *buffer;
	bool none = true;

	mutex_lock(&mapped_lock);
	list_for_each_entry(buffer, &mapped, node)
		none &= buffer->dev != dev;
	mutex_unlock(&mapped_lock);
	return none;
}

/**
 * cm_buffers_unmap() - a device loses its driver: what is mapped for it is not any more
 * @dev: device; no request of any channel of it is under way
 */
void cm_buffers_unmap(const struct device *dev)
{
	struct cm_buffer *buffer;

	while ((buffer = mapped_for(dev))) {
		buffer_unmap(buffer);
		cm_buffer_put(buffer);
	}
	/* the last owner of the others is at it */
	wait_event(unmapped, none_mapped_for(dev));
}

/**
 * cm_buffer_table_unmap() - the same for the buffers of one file
 * @table: of a file whose channel is gone
 */
void cm_buffer_table_unmap(struct cm_buffer_table *table)
{
	struct cm_buffer *buffer;
	unsigned long handle;

	mutex_lock(&table->lock);
	xa_for_each(&table->buffers, handle, buffer)
		buffer_unmap(buffer);
	mutex_unlock(&table->lock);
}
EXPORT_SYMBOL_CM(cm_buffer_table_unmap);

static void buffer_destroy(struct cm_buffer *buffer)
{
	buffer_unmap(buffer);
	switch (buffer->kind) {
	case CM_BUFFER_PAGES:
		if (buffer->pages)
			dma_free_pages(&owner->dev, buffer->length, buffer->pages,
				       buffer->pages_dma, DMA_BIDIRECTIONAL);
		else
			dma_free_noncoherent(buffer->dev, buffer->length, buffer->cpu, buffer->dma,
					     DMA_BIDIRECTIONAL);
		break;
	case CM_BUFFER_COHERENT:
		dma_free_coherent(buffer->dev, buffer->length, buffer->cpu, buffer->dma);
		break;
	case CM_BUFFER_IMPORTED:
		dma_buf_put(buffer->dmabuf);
		break;
	}
	/* not before the memory is free: another one may take it at once */
	if (buffer->kind != CM_BUFFER_IMPORTED)
		cm_budget_uncharge(buffer->budget, buffer->length);
	buffer_delete(buffer);
}

static void buffer_release_work(struct work_struct *work)
{
	buffer_destroy(container_of(work, struct cm_buffer, release));
}

static void buffer_release(struct kref *ref)
{
	buffer_destroy(container_of(ref, struct cm_buffer, ref));
}

static void buffer_release_later(struct kref *ref)
{
	queue_work(cm_dma_workqueue, &container_of(ref, struct cm_buffer, ref)->release);
}

/**
 * cm_buffers_init() - before there is a buffer
 *
 * Return: 0 or -ENOMEM.
 */
int cm_buffers_init(void)
{
	int ret;

	owner = platform_device_register_simple("cm_dma_memory", PLATFORM_DEVID_NONE, NULL, 0);
	if (IS_ERR(owner))
		return PTR_ERR(owner);
	/* what every engine reaches */
	ret = dma_coerce_mask_and_coherent(&owner->dev, DMA_BIT_MASK(32));
	if (!ret) {
		cm_dma_workqueue = alloc_workqueue("cm_dma", WQ_UNBOUND, 0);
		ret = cm_dma_workqueue ? 0 : -ENOMEM;
	}
	if (ret)
		platform_device_unregister(owner);
	return ret;
}

/**
 * cm_buffers_exit() - when there is none any more; waits for those on their way
 */
void cm_buffers_exit(void)
{
	destroy_workqueue(cm_dma_workqueue);
	platform_device_unregister(owner);
}

/**
 * cm_buffer_get() - take a reference
 * @buffer: buffer
 *
 * Return: @buffer.
 */
struct cm_buffer *cm_buffer_get(struct cm_buffer *buffer)
{
	kref_get(&buffer->ref);
	return buffer;
}
EXPORT_SYMBOL_CM(cm_buffer_get);

/**
 * cm_buffer_put() - give a reference back; may sleep
 * @buffer: buffer
 */
void cm_buffer_put(struct cm_buffer *buffer)
{
	kref_put(&buffer->ref, buffer_release);
}
EXPORT_SYMBOL_CM(cm_buffer_put);

/**
 * cm_buffer_put_atomic() - give a reference back where one cannot sleep
 * @buffer: buffer; where this was the last reference, it goes away a little later
 */
void cm_buffer_put_atomic(struct cm_buffer *buffer)
{
	kref_put(&buffer->ref, buffer_release_later);
}

/**
 * cm_buffer_coherent() - whether the CPU sees it without synchronising
 * @buffer: buffer
 *
 * Return: true if neither cache maintenance nor bouncing is needed.
 */
bool cm_buffer_coherent(struct cm_buffer *buffer)
{
	return buffer->coherent;
}
EXPORT_SYMBOL_CM(cm_buffer_coherent);

/**
 * cm_buffer_written() - a device has written a part of a buffer
 * @buffer: buffer
 * @offset: first byte
 * @length: bytes
 *
 * The next reader sees to the cache, over this part alone, and only the first
 * of several readers.
 */
void cm_buffer_written(struct cm_buffer *buffer, u64 offset, u64 length)
{
	u64 end = offset + length;

	spin_lock_bh(&buffer->stale_lock);
	if (buffer->stale_begin == buffer->stale_end) {
		buffer->stale_begin = offset;
		buffer->stale_end = end;
	} else if (length) {
		buffer->stale_begin = min(buffer->stale_begin, offset);
		buffer->stale_end = max(buffer->stale_end, end);
	}
	spin_unlock_bh(&buffer->stale_lock);
}

static void sync_part_for_cpu(struct cm_buffer *buffer, u64 offset, u64 length,
			      enum dma_data_direction direction)
{
	if (!length)
		return;
	atomic64_add(length, &synced);
	dma_sync_single_for_cpu(buffer->dev, buffer->dma + offset, length, direction);
}

/**
 * cm_buffer_begin_read() - the CPU is about to look at an allocated buffer
 * @buffer: buffer
 * @direction: what the device did
 */
void cm_buffer_begin_read(struct cm_buffer *buffer, enum dma_data_direction direction)
{
	u64 begin, end;

	if (buffer->kind != CM_BUFFER_PAGES || !buffer->mapped || direction == DMA_TO_DEVICE)
		return;
	/* a device that writes now may have written anything */
	if (atomic_read(&buffer->in_flight)) {
		sync_part_for_cpu(buffer, 0, buffer->length, direction);
		return;
	}
	spin_lock_bh(&buffer->stale_lock);
	begin = buffer->stale_begin;
	end = buffer->stale_end;
	buffer->stale_begin = 0;
	buffer->stale_end = 0;
	spin_unlock_bh(&buffer->stale_lock);
	sync_part_for_cpu(buffer, begin, end - begin, direction);
}

/**
 * cm_buffers_synced() - how much was synchronised for readers
 *
 * Return: bytes since the module was loaded.
 */
u64 cm_buffers_synced(void)
{
	return atomic64_read(&synced);
}

/**
 * cm_buffers_mapped() - how many buffers are mapped for a device now
 *
 * Return: their number, without those in memory of a client's own.
 */
u64 cm_buffers_mapped(void)
{
	struct cm_buffer *buffer;
	u64 count = 0;

	mutex_lock(&mapped_lock);
	list_for_each_entry(buffer, &mapped, node)
		count++;
	mutex_unlock(&mapped_lock);
	return count;
}

/**
 * cm_buffer_sync_for_cpu() - before the CPU touches an allocated buffer
 * @buffer: buffer
 * @direction: what the device did
 */
void cm_buffer_sync_for_cpu(struct cm_buffer *buffer, enum dma_data_direction direction)
{
	if (buffer->kind == CM_BUFFER_PAGES && buffer->mapped)
		dma_sync_single_for_cpu(buffer->dev, buffer->dma, buffer->length, direction);
}
EXPORT_SYMBOL_CM(cm_buffer_sync_for_cpu);

/**
 * cm_buffer_sync_for_device() - after the CPU touched an allocated buffer
 * @buffer: buffer
 * @direction: what the device will do
 */
void cm_buffer_sync_for_device(struct cm_buffer *buffer, enum dma_data_direction direction)
{
	if (buffer->kind == CM_BUFFER_PAGES && buffer->mapped)
		dma_sync_single_for_device(buffer->dev, buffer->dma, buffer->length, direction);
}
EXPORT_SYMBOL_CM(cm_buffer_sync_for_device);

/**
 * cm_buffer_mmap() - map an allocated buffer into a process
 * @buffer: buffer; the caller sees to it that it outlives the mapping
 * @vma: range; its offset counts from the start of the buffer
 *
 * Return: 0, -EINVAL for a range outside the buffer, a private mapping or an
 * imported buffer.
 */
int cm_buffer_mmap(struct cm_buffer *buffer, struct vm_area_struct *vma)
{
	unsigned long pages = buffer->length >> PAGE_SHIFT;

	if (buffer->kind == CM_BUFFER_IMPORTED || vma->vm_pgoff > pages ||
	    vma_pages(vma) > pages - vma->vm_pgoff)
		return -EINVAL;
	/* what is written to a private mapping is a copy that the device never sees */
	if (!(vma->vm_flags & VM_SHARED))
		return -EINVAL;
	cm_vm_flags_set(vma, VM_DONTEXPAND | VM_DONTDUMP);
	if (buffer->kind == CM_BUFFER_COHERENT)
		return dma_mmap_coherent(buffer->dev, vma, buffer->cpu, buffer->dma,
					 buffer->length);
	return remap_pfn_range(vma, vma->vm_start,
			       page_to_pfn(virt_to_page(buffer->cpu)) + vma->vm_pgoff,
			       vma->vm_end - vma->vm_start, vma->vm_page_prot);
}
EXPORT_SYMBOL_CM(cm_buffer_mmap);
