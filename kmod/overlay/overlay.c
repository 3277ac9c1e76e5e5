// SPDX-License-Identifier: GPL-2.0-only
/*
 * cm_overlay: device-tree overlays through configfs, for kernels that lack
 * the interface which the vendor's kernels have:
 *
 *	mkdir /sys/kernel/config/device-tree/overlays/<name>
 *	cat x.dtbo > .../<name>/dtbo       or   echo x.dtbo > .../<name>/path
 *	cat .../<name>/status              unapplied, applied or failed: <errno>
 *	rmdir .../<name>                   removes it from the tree
 *
 * Only one such interface can be there, and the kernel's own comes first.
 */
#include <linux/configfs.h>
#include <linux/firmware.h>
#include <linux/list.h>
#include <linux/module.h>
#include <linux/mutex.h>
#include <linux/notifier.h>
#include <linux/of.h>
#include <linux/sched.h>
#include <linux/slab.h>

#include "cm_compat.h"
#include "cm_overlay_compat.h"

/* larger than any overlay that describes a module */
#define CM_OVERLAY_MAX (1024 * 1024)
#define CM_OVERLAY_PATH_MAX 256

/**
 * struct cm_overlay - a folder
 * @item: folder
 * @lock: protects everything
 * @path: name of the firmware file it came from
 * @blob: the flat tree while it is applied; the kernel has a copy of its own
 * @length: bytes of @blob
 * @id: changeset, > 0 while it is applied
 * @error: why it could not be applied
 */
struct cm_overlay {
	struct config_item item;
	struct mutex lock; /* protects everything */
	char path[CM_OVERLAY_PATH_MAX];
	void *blob;
	size_t length;
	int id;
	int error;
};

/**
 * struct cm_orphan - an overlay whose folder is gone
 * @node: in the list, newest first
 * @id: changeset
 */
struct cm_orphan {
	struct list_head node;
	int id;
};

static LIST_HEAD(orphans);
static DEFINE_MUTEX(orphans_lock);

static struct cm_overlay *to_overlay(struct config_item *item)
{
	return container_of(item, struct cm_overlay, item);
}

/*
 * Removing what is left of a failed overlay tells every target that it is being
 * removed, also those that were never told of it.  A region that had refused it,
 * because another overlay had loaded its design, would close the bridges of that
 * design and forget its overlay (6.1 to 7.2).  So as many fragments are told of
 * the removal as all others had accepted.
 */
static DEFINE_MUTEX(apply_lock); /* protects the members below */
static struct task_struct *applying; /* who holds it; others apply overlays, too */
static int accepted, told;

/* the last one, which is not asked where one before it has refused */
static int count_accepted(struct notifier_block *block, unsigned long action, void *data)
{
	if (READ_ONCE(applying) == current && action == OF_OVERLAY_PRE_APPLY)
		accepted++;
	return NOTIFY_DONE;
}

static int stop_untold(struct notifier_block *block, unsigned long action, void *data)
{
	if (READ_ONCE(applying) != current || action != OF_OVERLAY_POST_REMOVE)
		return NOTIFY_DONE;
	return told++ < accepted ? NOTIFY_DONE : NOTIFY_STOP;
}

static struct notifier_block last_block = { .notifier_call = count_accepted, .priority = INT_MIN };
static struct notifier_block first_block = { .notifier_call = stop_untold, .priority = INT_MAX };

/* a failed apply may leave an id, and then a part of the overlay */
static int apply_whole(struct cm_overlay *overlay)
{
	int ret;

	mutex_lock(&apply_lock);
	accepted = 0;
	told = 0;
	WRITE_ONCE(applying, current);
	ret = cm_of_overlay_apply(overlay->blob, overlay->length, &overlay->id);
	if (ret && overlay->id > 0)
		of_overlay_remove(&overlay->id);
	WRITE_ONCE(applying, NULL);
	mutex_unlock(&apply_lock);
	return ret;
}

static int overlay_apply(struct cm_overlay *overlay)
{
	int ret = apply_whole(overlay);

	if (ret) {
		overlay->id = 0;
		kvfree(overlay->blob);
		overlay->blob = NULL;
	}
	overlay->error = ret;
	return ret;
}

static int overlay_load(struct cm_overlay *overlay, const void *data, size_t length,
			const char *path)
{
	int ret;

	mutex_lock(&overlay->lock);
	if (overlay->id) {
		ret = -EBUSY;
	} else {
		overlay->blob = kvmalloc(length, GFP_KERNEL);
		if (overlay->blob) {
			memcpy(overlay->blob, data, length);
			overlay->length = length;
			ret = overlay_apply(overlay);
			if (!ret)
				strscpy(overlay->path, path, sizeof(overlay->path));
		} else {
			ret = -ENOMEM;
		}
	}
	mutex_unlock(&overlay->lock);
	return ret;
}

/*
 * rmdir cannot fail.  An overlay that one applied later stands on is removed
 * as soon as that one is.
 */
static void retry_orphans(void)
{
	struct cm_orphan *orphan, *next;
	bool again;

	do {
		again = false;
		list_for_each_entry_safe(orphan, next, &orphans, node) {
			if (of_overlay_remove(&orphan->id))
				continue;
			list_del(&orphan->node);
			kfree(orphan);
			again = true;
		}
	} while (again);
}

static void overlay_remove(struct cm_overlay *overlay)
{
	struct cm_orphan *orphan;
	int id = overlay->id;

	if (!id)
		return;
	mutex_lock(&orphans_lock);
	if (!of_overlay_remove(&id)) {
		retry_orphans();
	} else {
		orphan = kzalloc(sizeof(*orphan), GFP_KERNEL | __GFP_NOFAIL);
		orphan->id = id;
		list_add(&orphan->node, &orphans);
	}
	mutex_unlock(&orphans_lock);
	overlay->id = 0;
}

static ssize_t overlay_dtbo_write(struct config_item *item, const void *data, size_t length)
{
	return overlay_load(to_overlay(item), data, length, "") ?: length;
}

static ssize_t overlay_dtbo_read(struct config_item *item, void *data, size_t length)
{
	struct cm_overlay *overlay = to_overlay(item);
	ssize_t ret = 0;

	mutex_lock(&overlay->lock);
	if (overlay->id) {
		ret = overlay->length;
		if (data)
			memcpy(data, overlay->blob, min(length, overlay->length));
	}
	mutex_unlock(&overlay->lock);
	return ret;
}
CONFIGFS_BIN_ATTR(overlay_, dtbo, NULL, CM_OVERLAY_MAX);

static struct configfs_bin_attribute *overlay_binary_attributes[] = {
	&overlay_attr_dtbo,
	NULL
};

static ssize_t overlay_path_show(struct config_item *item, char *page)
{
	struct cm_overlay *overlay = to_overlay(item);
	ssize_t length;

	mutex_lock(&overlay->lock);
	length = sprintf(page, "%s\n", overlay->path);
	mutex_unlock(&overlay->lock);
	return length;
}

static ssize_t overlay_path_store(struct config_item *item, const char *page, size_t count)
{
	struct cm_overlay *overlay = to_overlay(item);
	const struct firmware *firmware;
	char path[CM_OVERLAY_PATH_MAX];
	int ret;

	if (strscpy(path, page, sizeof(path)) < 0)
		return -ENAMETOOLONG;
	strim(path);
	ret = request_firmware_direct(&firmware, path, NULL);
	if (ret)
		return ret;
	ret = overlay_load(overlay, firmware->data, firmware->size, path);
	release_firmware(firmware);
	return ret ?: count;
}
CONFIGFS_ATTR(overlay_, path);

static ssize_t overlay_status_show(struct config_item *item, char *page)
{
	struct cm_overlay *overlay = to_overlay(item);
	ssize_t length;

	mutex_lock(&overlay->lock);
	if (overlay->id)
		length = sprintf(page, "applied\n");
	else if (overlay->error)
		length = sprintf(page, "failed: %d\n", overlay->error);
	else
		length = sprintf(page, "unapplied\n");
	mutex_unlock(&overlay->lock);
	return length;
}
CONFIGFS_ATTR_RO(overlay_, status);

static struct configfs_attribute *overlay_attributes[] = {
	&overlay_attr_path,
	&overlay_attr_status,
	NULL
};

static void overlay_release(struct config_item *item)
{
	struct cm_overlay *overlay = to_overlay(item);

	kvfree(overlay->blob);
	mutex_destroy(&overlay->lock);
	kfree(overlay);
}

static struct configfs_item_operations overlay_operations = { .release = overlay_release };

static const struct config_item_type overlay_type = {
	.ct_item_ops = &overlay_operations,
	.ct_attrs = overlay_attributes,
	.ct_bin_attrs = overlay_binary_attributes,
	.ct_owner = THIS_MODULE,
};

static struct config_item *overlays_make(struct config_group *group, const char *name)
{
	struct cm_overlay *overlay = kzalloc(sizeof(*overlay), GFP_KERNEL);

	if (!overlay)
		return ERR_PTR(-ENOMEM);
	mutex_init(&overlay->lock);
	config_item_init_type_name(&overlay->item, name, &overlay_type);
	return &overlay->item;
}

static void overlays_drop(struct config_group *group, struct config_item *item)
{
	overlay_remove(to_overlay(item));
	config_item_put(item);
}

static struct configfs_group_operations overlays_operations = {
	.make_item = overlays_make,
	.drop_item = overlays_drop,
};

static const struct config_item_type overlays_type = {
	.ct_group_ops = &overlays_operations,
	.ct_owner = THIS_MODULE,
};

static const struct config_item_type root_type = {
	.ct_owner = THIS_MODULE,
};

static struct config_group overlays_group;

static struct configfs_subsystem overlay_subsystem = {
	.su_group = {
		.cg_item = {
			.ci_namebuf = "device-tree",
			.ci_type = &root_type,
		},
	},
};

static int __init cm_overlay_init(void)
{
	int ret;

	if (!IS_ENABLED(CONFIG_OF_OVERLAY)) {
		pr_err("cm_overlay: this kernel was built without CONFIG_OF_OVERLAY\n");
		return -EOPNOTSUPP;
	}
	config_group_init(&overlay_subsystem.su_group);
	mutex_init(&overlay_subsystem.su_mutex);
	config_group_init_type_name(&overlays_group, "overlays", &overlays_type);
	configfs_add_default_group(&overlays_group, &overlay_subsystem.su_group);
	ret = of_overlay_notifier_register(&first_block);
	if (ret)
		return ret;
	ret = of_overlay_notifier_register(&last_block);
	if (ret)
		goto no_last;
	ret = configfs_register_subsystem(&overlay_subsystem);
	if (ret)
		goto no_interface;
	return 0;

no_interface:
	if (ret == -EEXIST)
		pr_err("cm_overlay: the kernel has this interface already\n");
	of_overlay_notifier_unregister(&last_block);
no_last:
	of_overlay_notifier_unregister(&first_block);
	return ret;
}
module_init(cm_overlay_init);

static void __exit cm_overlay_exit(void)
{
	struct cm_orphan *orphan, *next;

	configfs_unregister_subsystem(&overlay_subsystem);
	of_overlay_notifier_unregister(&last_block);
	of_overlay_notifier_unregister(&first_block);
	list_for_each_entry_safe(orphan, next, &orphans, node)
		kfree(orphan);
}
module_exit(cm_overlay_exit);

MODULE_DESCRIPTION("Device-tree overlays through configfs");
MODULE_VERSION(CM_VERSION);
MODULE_LICENSE("GPL");
