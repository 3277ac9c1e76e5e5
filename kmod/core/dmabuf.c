// SPDX-License-Identifier: GPL-2.0
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
 * @table: the buffer as one entry
 * @mapped: @table is mapped for @dev
 * @node: in the buffer's list
 */
struct cm_attachment {
	struct device *dev;
	struct sg_table table;
	bool mapped;
	struct list_head node;
};

static int attachment_fill(struct cm_buffer *buffer, struct cm_attachment *attachment)
{
	int ret;

	if (buffer->kind == CM_BUFFER_COHERENT)
		return dma_get_sgtable(buffer->dev, &attachment->table, buffer->cpu, buffer->dma,
				       buffer->length);
	ret = sg_alloc_table(&attachment->table, 1, GFP_KERNEL);
	if (!ret)
		sg_set_page(attachment->table.sgl, virt_to_page(buffer->cpu), buffer->length, 0);
	return ret;
}

static int cm_dmabuf_attach(struct dma_buf *dmabuf, struct dma_buf_attachment *attach)
{
	struct cm_buffer *buffer = dmabuf->priv;
	struct cm_attachment *attachment = kzalloc(sizeof(*attachment), GFP_KERNEL);
	int ret;

	if (!attachment)
		return -ENOMEM;
	ret = attachment_fill(buffer, attachment);
	if (ret) {
		kfree(attachment);
		return ret;
	}
	attachment->dev = attach->dev;
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

static struct sg_table *cm_dmabuf_map(struct dma_buf_attachment *attach,
				      enum dma_data_direction direction)
{
	struct cm_attachment *attachment = attach->priv;
	int ret = dma_map_sgtable(attachment->dev, &attachment->table, direction, 0);

	if (ret)
		return ERR_PTR(ret);
	attachment->mapped = true;
	return &attachment->table;
}

static void cm_dmabuf_unmap(struct dma_buf_attachment *attach, struct sg_table *table,
			    enum dma_data_direction direction)
{
	struct cm_attachment *attachment = attach->priv;

	attachment->mapped = false;
	dma_unmap_sgtable(attachment->dev, table, direction, 0);
}

static int cm_dmabuf_begin_cpu_access(struct dma_buf *dmabuf, enum dma_data_direction direction)
{
	struct cm_buffer *buffer = dmabuf->priv;
	struct cm_attachment *attachment;

	mutex_lock(&buffer->lock);
	cm_buffer_sync_for_cpu(buffer, direction);
	list_for_each_entry(attachment, &buffer->attachments, node) {
		if (attachment->mapped)
			dma_sync_sgtable_for_cpu(attachment->dev, &attachment->table, direction);
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
			dma_sync_sgtable_for_device(attachment->dev, &attachment->table, direction);
	}
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
