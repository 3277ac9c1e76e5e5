// SPDX-License-Identifier: GPL-2.0-only
/* ioctl structures that begin with their size and flags. */
#include <linux/uaccess.h>

#include "cm_compat.h"
#include "cm_core.h"

/**
 * cm_args_get() - copy an ioctl's structure from user space
 * @args: filled in; what the caller's structure lacks is zero
 * @size: bytes of @args
 * @least: bytes that the structure had when it was new
 * @from: the caller's structure; its first word is its size
 *
 * Return: 0, -EINVAL for a size below @least, -E2BIG where bytes that this
 * kernel does not know are not zero, or -EFAULT.
 */
int cm_args_get(void *args, size_t size, size_t least, const void __user *from)
{
	u32 user_size;
	int ret;

	if (get_user(user_size, (const u32 __user *)from))
		return -EFAULT;
	if (user_size < least)
		return -EINVAL;
	if (user_size > PAGE_SIZE)
		return -E2BIG;
	ret = copy_struct_from_user(args, size, from, user_size);
	/* it may have been changed between the two reads */
	if (!ret)
		*(u32 *)args = user_size;
	return ret;
}
EXPORT_SYMBOL_CM(cm_args_get);

/**
 * cm_args_put() - copy an ioctl's structure back to user space
 * @to: where cm_args_get() took it from
 * @args: the structure; its first word is still the caller's size
 * @size: bytes of @args
 *
 * Return: 0 or -EFAULT.
 */
int cm_args_put(void __user *to, const void *args, size_t size)
{
	size_t user_size = *(const u32 *)args;

	return copy_to_user(to, args, min(size, user_size)) ? -EFAULT : 0;
}
EXPORT_SYMBOL_CM(cm_args_put);
