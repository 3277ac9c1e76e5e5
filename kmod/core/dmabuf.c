// SPDX-License-Identifier: GPL-2.0-only
/* Allocated buffers as dma-buf. */
#include <linux/dma-buf.h>
#include <linux/fcntl.h>
#include <linux/scatterlist.h>
#include <linux/slab.h>

#include "cm_compat.h"
#include "cm_core.h"

/**
 * struct cm_attachment - another device that uses an exported buffer
 * @dev: that device
 * @table: the buffer, in pieces that @dev takes
 * @mapped: @table is mapped for @dev
 * @direction: what it is mapped for
 * @node: in the buffer's list
 */
struct cm_attachment {
	struct device *dev;
	struct sg_table table;
	bool mapped;
	enum dma_data_direction direction;
	struct list_head node;
};

/* cut by the longest segment that the device says it takes: 64 KB where its driver says nothing */
static int attachment_fill(struct cm_buffer *buffer, struct cm_attachment *attachment)
{
	size_t most = round_down(dma_get_max_seg_size(attachment->dev), PAGE_SIZE) ?: PAGE_SIZE;
	size_t offset = 0;
	struct scatterlist *sg;
	int i, ret;

	/* a reserved pool without pages has nothing that another device could map */
	if (buffer->kind != CM_BUFFER_PAGES)
		return -EOPNOTSUPP;
	ret = sg_alloc_table(&attachment->table, DIV_ROUND_UP(buffer->length, most), GFP_KERNEL);
	if (ret)
		return ret;
	for_each_sgtable_sg(&attachment->table, sg, i) {
		size_t length = min(most, buffer->length - offset);

		sg_set_page(sg, virt_to_page(buffer->cpu + offset), length, 0);
		offset += length;
	}
	return 0;
}

static int cm_dmabuf_attach(struct dma_buf *dmabuf, struct dma_buf_attachment *attach)
{
	struct cm_buffer *buffer = dmabuf->priv;
	struct cm_attachment *attachment = kzalloc(sizeof(*attachment), GFP_KERNEL);
	int ret;

	if (!attachment)
		return -ENOMEM;
	attachment->dev = attach->dev;
	ret = attachment_fill(buffer, attachment);
	if (ret) {
		kfree(attachment);
		return ret;
	}
	attach->priv = attachment;
	mutex_lock(&buffer->lock);
	list_add(&attachment->node, &buffer->attachments);
	mutex_unlock(&buffer->lock);
	return 0;
}

static void cm_dmabuf_detach(struct dma_buf *dmabuf, struct dma_buf_attachment *attach)
{
	struct cm_buffer *buffer = dmabuf->priv;
	struct cm_attachment *attachment = attach->priv;

	mutex_lock(&buffer->lock);
	list_del(&attachment->node);
	mutex_unlock(&buffer->lock);
	sg_free_table(&attachment->table);
	kfree(attachment);
}

/*
 * The buffer is mapped for its own device already, and may be for others.  So
 * the caches are cared for apart from the mapping: DMA_API_DEBUG takes a second
 * mapping of the same memory that cares for them itself for a mistake.
 */
static struct sg_table *cm_dmabuf_map(struct dma_buf_attachment *attach,
				      enum dma_data_direction direction)
{
	struct cm_buffer *buffer = attach->dmabuf->priv;
	struct cm_attachment *attachment = attach->priv;
	int ret;

	mutex_lock(&buffer->lock);
	ret = dma_map_sgtable(attachment->dev, &attachment->table, direction,
			      DMA_ATTR_SKIP_CPU_SYNC);
	if (!ret) {
		dma_sync_sgtable_for_device(attachment->dev, &attachment->table, direction);
		attachment->direction = direction;
		attachment->mapped = true;
	}
	mutex_unlock(&buffer->lock);
	return ret ? ERR_PTR(ret) : &attachment->table;
}

static void cm_dmabuf_unmap(struct dma_buf_attachment *attach, struct sg_table *table,
			    enum dma_data_direction direction)
{
	struct cm_buffer *buffer = attach->dmabuf->priv;
	struct cm_attachment *attachment = attach->priv;

	mutex_lock(&buffer->lock);
	attachment->mapped = false;
	dma_sync_sgtable_for_cpu(attachment->dev, table, direction);
	dma_unmap_sgtable(attachment->dev, table, direction, DMA_ATTR_SKIP_CPU_SYNC);
	mutex_unlock(&buffer->lock);
}

static int cm_dmabuf_begin_cpu_access(struct dma_buf *dmabuf, enum dma_data_direction direction)
{
	struct cm_buffer *buffer = dmabuf->priv;
	struct cm_attachment *attachment;

	mutex_lock(&buffer->lock);
	cm_buffer_begin_read(buffer, direction);
	list_for_each_entry(attachment, &buffer->attachments, node) {
		if (attachment->mapped)
			dma_sync_sgtable_for_cpu(attachment->dev, &attachment->table,
						 attachment->direction);
	}
	mutex_unlock(&buffer->lock);
	return 0;
}

static int cm_dmabuf_end_cpu_access(struct dma_buf *dmabuf, enum dma_data_direction direction)
{
	struct cm_buffer *buffer = dmabuf->priv;
	struct cm_attachment *attachment;

	mutex_lock(&buffer->lock);
	list_for_each_entry(attachment, &buffer->attachments, node) {
		if (attachment->mapped)
			dma_sync_sgtable_for_device(attachment->dev, &attachment->table,
						    attachment->direction);
	}
	/* who only read has left nothing in the cache that is not in memory */
	if (direction != DMA_FROM_DEVICE)
		cm_buffer_sync_for_device(buffer, direction);
	mutex_unlock(&buffer->lock);
	return 0;
}

static int cm_dmabuf_mmap(struct dma_buf *dmabuf, struct vm_area_struct *vma)
{
	return cm_buffer_mmap(dmabuf->priv, vma);
}

static void cm_dmabuf_release(struct dma_buf *dmabuf)
{
	cm_buffer_put(dmabuf->priv);
}

static const struct dma_buf_ops cm_dmabuf_ops = {
	.attach = cm_dmabuf_attach,
	.detach = cm_dmabuf_detach,
	.map_dma_buf = cm_dmabuf_map,
	.unmap_dma_buf = cm_dmabuf_unmap,
	.begin_cpu_access = cm_dmabuf_begin_cpu_access,
	.end_cpu_access = cm_dmabuf_end_cpu_access,
	.mmap = cm_dmabuf_mmap,
	.release = cm_dmabuf_release,
};

/**
 * cm_buffer_export() - make a dma-buf of an allocated buffer
 * @buffer: buffer; the dma-buf takes its own reference
 *
 * Return: a dma-buf with one reference, or an ERR_PTR.
 */
struct dma_buf *cm_buffer_export(struct cm_buffer *buffer)
{
	DEFINE_DMA_BUF_EXPORT_INFO(info);
	struct dma_buf *dmabuf;

	if (buffer->kind == CM_BUFFER_IMPORTED)
		return ERR_PTR(-EINVAL);
	info.ops = &cm_dmabuf_ops;
	info.size = buffer->length;
	info.flags = O_RDWR | O_CLOEXEC;
	info.priv = cm_buffer_get(buffer);
	dmabuf = dma_buf_export(&info);
	if (IS_ERR(dmabuf))
		cm_buffer_put(buffer);
	return dmabuf;
}
EXPORT_SYMBOL_CM(cm_buffer_export);
