// SPDX-License-Identifier: GPL-2.0-only
/* Buffers of one open file, by handle, and the ioctls that make them. */
#include <linux/dma-buf.h>
#include <linux/fcntl.h>
#include <linux/file.h>

#include "cm_compat.h"
#include "cm_core.h"

/**
 * cm_buffer_table_init() - an empty table
 * @table: to be given to cm_buffer_table_destroy()
 *
 * Return: 0 or -ENOMEM.
 */
int cm_buffer_table_init(struct cm_buffer_table *table)
{
	table->budget = cm_budget_new();
	if (!table->budget)
		return -ENOMEM;
	mutex_init(&table->lock);
	xa_init_flags(&table->buffers, XA_FLAGS_ALLOC1);
	return 0;
}
EXPORT_SYMBOL_CM(cm_buffer_table_init);

/**
 * cm_buffer_table_destroy() - give back all handles
 * @table: table
 */
void cm_buffer_table_destroy(struct cm_buffer_table *table)
{
	struct cm_buffer *buffer;
	unsigned long handle;

	xa_for_each(&table->buffers, handle, buffer)
		cm_buffer_put(buffer);
	xa_destroy(&table->buffers);
	cm_budget_put(table->budget);
	mutex_destroy(&table->lock);
}
EXPORT_SYMBOL_CM(cm_buffer_table_destroy);

/**
 * cm_buffer_table_get() - the buffer of a handle
 * @table: table
 * @handle: handle
 *
 * Return: the buffer with a reference for the caller, or NULL.
 */
struct cm_buffer *cm_buffer_table_get(struct cm_buffer_table *table, u32 handle)
{
	struct cm_buffer *buffer;

	mutex_lock(&table->lock);
	buffer = xa_load(&table->buffers, handle);
	if (buffer)
		cm_buffer_get(buffer);
	mutex_unlock(&table->lock);
	return buffer;
}
EXPORT_SYMBOL_CM(cm_buffer_table_get);

/* the table's reference is its own: another thread may free the handle at once */
static int table_add(struct cm_buffer_table *table, struct cm_buffer *buffer, u32 *handle)
{
	int ret = xa_alloc(&table->buffers, handle, cm_buffer_get(buffer), xa_limit_31b,
			   GFP_KERNEL);

	if (ret)
		cm_buffer_put(buffer);
	return ret;
}

/* the handle may have been guessed: freed, and given to another buffer since */
static void table_drop(struct cm_buffer_table *table, struct cm_buffer *buffer, u32 handle)
{
	bool ours;

	mutex_lock(&table->lock);
	ours = xa_cmpxchg(&table->buffers, handle, buffer, NULL, GFP_KERNEL) == buffer;
	mutex_unlock(&table->lock);
	if (ours)
		cm_buffer_put(buffer);
}

/* user space must have the answer before the descriptor becomes visible */
static int publish(struct cm_buffer *buffer, struct cm_buffer_alloc *args, void __user *arg)
{
	struct dma_buf *dmabuf = cm_buffer_export(buffer);
	int fd, ret;

	if (IS_ERR(dmabuf))
		return PTR_ERR(dmabuf);
	fd = get_unused_fd_flags(O_CLOEXEC);
	if (fd < 0) {
		dma_buf_put(dmabuf);
		return fd;
	}
	args->fd = fd;
	args->length = buffer->length;
	args->coherent = cm_buffer_coherent(buffer);
	args->address = buffer->dma;
	ret = cm_args_put(arg, args, sizeof(*args));
	if (ret) {
		put_unused_fd(fd);
		dma_buf_put(dmabuf);
		return ret;
	}
	fd_install(fd, dmabuf->file);
	return 0;
}

/**
 * cm_buffer_ioctl_alloc() - the ioctls with a struct cm_buffer_alloc
 * @table: of the file
 * @dev: device to allocate for
 * @arg: the caller's structure
 *
 * Return: 0 or a negative errno.
 */
long cm_buffer_ioctl_alloc(struct cm_buffer_table *table, struct device *dev, void __user *arg)
{
	struct cm_buffer_alloc args;
	struct cm_buffer *buffer;
	int ret = cm_args_get(&args, sizeof(args), CM_BUFFER_ALLOC_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (args.flags || args.reserved)
		return -EINVAL;
	buffer = cm_buffer_alloc(dev, table->budget, args.length);
	if (IS_ERR(buffer))
		return PTR_ERR(buffer);
	ret = table_add(table, buffer, &args.handle);
	if (!ret) {
		ret = publish(buffer, &args, arg);
		if (ret)
			table_drop(table, buffer, args.handle);
	}
	cm_buffer_put(buffer);
	return ret;
}
EXPORT_SYMBOL_CM(cm_buffer_ioctl_alloc);

/**
 * cm_buffer_ioctl_import() - the ioctls with a struct cm_buffer_import
 * @table: of the file
 * @dev: the DMA engine's device
 * @direction: what the device will do with the buffer
 * @arg: the caller's structure
 *
 * Return: 0 or a negative errno.
 */
long cm_buffer_ioctl_import(struct cm_buffer_table *table, struct device *dev,
			    enum dma_data_direction direction, void __user *arg)
{
	struct cm_buffer_import args;
	struct cm_buffer *buffer;
	int ret = cm_args_get(&args, sizeof(args), CM_BUFFER_IMPORT_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (args.flags)
		return -EINVAL;
	buffer = cm_buffer_import(dev, args.fd, direction);
	if (IS_ERR(buffer))
		return PTR_ERR(buffer);
	args.length = buffer->length;
	ret = table_add(table, buffer, &args.handle);
	if (!ret) {
		ret = cm_args_put(arg, &args, sizeof(args));
		if (ret)
			table_drop(table, buffer, args.handle);
	}
	cm_buffer_put(buffer);
	return ret;
}
EXPORT_SYMBOL_CM(cm_buffer_ioctl_import);

/**
 * cm_buffer_ioctl_free() - the ioctls with a struct cm_buffer_free
 * @table: of the file
 * @arg: the caller's structure
 *
 * Return: 0, -ENOENT for an unknown handle, -EBUSY while requests use the
 * buffer, or another negative errno.
 */
long cm_buffer_ioctl_free(struct cm_buffer_table *table, void __user *arg)
{
	struct cm_buffer_free args;
	struct cm_buffer *buffer;
	int ret = cm_args_get(&args, sizeof(args), CM_BUFFER_FREE_SIZE_VER0, arg);

	if (ret)
		return ret;
	if (args.flags || args.reserved)
		return -EINVAL;
	mutex_lock(&table->lock);
	buffer = xa_load(&table->buffers, args.handle);
	if (!buffer)
		ret = -ENOENT;
	else if (atomic_read(&buffer->in_flight))
		ret = -EBUSY;
	else
		xa_erase(&table->buffers, args.handle);
	mutex_unlock(&table->lock);
	if (!ret)
		cm_buffer_put(buffer);
	return ret;
}
EXPORT_SYMBOL_CM(cm_buffer_ioctl_free);
