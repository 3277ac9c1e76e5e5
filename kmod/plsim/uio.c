// SPDX-License-Identifier: GPL-2.0-only
/*
 * A register window with an interrupt, as a UIO device.
 *
 * The registers are memory: what is written stays, and nothing sees it
 * happen.  A word may be named as a doorbell: it is looked at every
 * millisecond, and a value other than 0 is taken and raises the interrupt.
 * Where it has an address its pages can be lent, as those of real logic.
 */
#include <linux/debugfs.h>
#include <linux/mod_devicetable.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/property.h>
#include <linux/sizes.h>
#include <linux/uio_driver.h>
#include <linux/vmalloc.h>
#include <linux/workqueue.h>

#include "cm_compat.h"
#include "cm_window_core.h"
#include "plsim.h"

#define NO_DOORBELL U32_MAX
#define DOORBELL_MS 1

/**
 * struct plsim_uio - one device
 * @info: the framework's part
 * @memory: the registers, @size bytes
 * @pages: its pages
 * @size: whole pages
 * @doorbell: offset of the doorbell, or NO_DOORBELL
 * @poll: looks at the doorbell
 * @lock: protects @enabled and @pending
 * @enabled: an interrupt is told at once, and disables
 * @pending: one came while disabled
 * @events: interrupts raised
 * @debugfs: folder
 */
struct plsim_uio {
	struct uio_info info;
	u32 *memory;
	struct page **pages;
	u32 size;
	u32 doorbell;
	struct delayed_work poll;
	spinlock_t lock; /* protects enabled and pending */
	bool enabled;
	bool pending;
	u64 events;
	struct dentry *debugfs;
};

/* masked until user space writes 1, as uio_pdrv_genirq does it */
static void raise_interrupt(struct plsim_uio *uio)
{
	unsigned long flags;
	bool tell;

	spin_lock_irqsave(&uio->lock, flags);
	uio->events++;
	tell = uio->enabled;
	uio->enabled = false;
	uio->pending = !tell;
	spin_unlock_irqrestore(&uio->lock, flags);
	if (tell)
		uio_event_notify(&uio->info);
}

static int plsim_uio_irqcontrol(struct uio_info *info, s32 on)
{
	struct plsim_uio *uio = info->priv;
	unsigned long flags;
	bool tell;

	spin_lock_irqsave(&uio->lock, flags);
	tell = on && uio->pending;
	uio->pending = uio->pending && !on;
	uio->enabled = on && !tell;
	spin_unlock_irqrestore(&uio->lock, flags);
	if (tell)
		uio_event_notify(info);
	return 0;
}

/* the pages stay for as long as they are mapped */
#if CM_UIO_MMAP_PREPARE
static int plsim_uio_mmap(struct uio_info *info, struct vm_area_desc *desc)
{
	struct plsim_uio *uio = info->priv;

	if (vma_desc_pages(desc) > uio->size >> PAGE_SHIFT)
		return -EINVAL;
	mmap_action_map_kernel_pages_full(desc, uio->pages);
	return 0;
}

static void set_mmap(struct plsim_uio *uio)
{
	uio->info.mmap_prepare = plsim_uio_mmap;
}
#else
static int plsim_uio_mmap(struct uio_info *info, struct vm_area_struct *vma)
{
	struct plsim_uio *uio = info->priv;

	return remap_vmalloc_range(vma, uio->memory, 0);
}

static void set_mmap(struct plsim_uio *uio)
{
	uio->info.mmap = plsim_uio_mmap;
}
#endif

static void plsim_uio_poll(struct work_struct *work)
{
	struct plsim_uio *uio = container_of(to_delayed_work(work), struct plsim_uio, poll);
	u32 *doorbell = uio->memory + uio->doorbell / sizeof(u32);

	if (xchg(doorbell, 0))
		raise_interrupt(uio);
	schedule_delayed_work(&uio->poll, msecs_to_jiffies(DOORBELL_MS));
}

#define FIRE_MAX 1000000

static int fire_set(void *data, u64 count)
{
	if (count > FIRE_MAX)
		return -EINVAL;
	for (; count; count--)
		raise_interrupt(data);
	return 0;
}
DEFINE_DEBUGFS_ATTRIBUTE(fire_fops, NULL, fire_set, "%llu\n");

static void free_memory(void *memory)
{
	vfree(memory);
}

static void stop_poll(void *uio)
{
	cancel_delayed_work_sync(&((struct plsim_uio *)uio)->poll);
}

static void remove_debugfs(void *dentry)
{
	debugfs_remove_recursive(dentry);
}

static int read_properties(struct device *dev, struct plsim_uio *uio)
{
	u64 address = 0;
	int ret = device_property_read_string(dev, "label", &uio->info.name);

	if (ret)
		return dev_err_probe(dev, ret, "no label\n");
	uio->size = PAGE_SIZE;
	uio->doorbell = NO_DOORBELL;
	device_property_read_u64(dev, "fpga-cm,address", &address);
	device_property_read_u32(dev, "fpga-cm,size", &uio->size);
	device_property_read_u32(dev, "fpga-cm,doorbell", &uio->doorbell);
	if (!uio->size || uio->size > SZ_16M)
		return dev_err_probe(dev, -EINVAL, "size %u cannot be\n", uio->size);
	uio->size = PAGE_ALIGN(uio->size);
	if (uio->doorbell != NO_DOORBELL &&
	    (uio->doorbell % sizeof(u32) || uio->doorbell >= uio->size))
		return dev_err_probe(dev, -EINVAL, "doorbell %u cannot be\n", uio->doorbell);
	uio->info.mem[0].addr = address;
	return 0;
}

static int init_memory(struct device *dev, struct plsim_uio *uio)
{
	u32 values[64];
	int count, i;

	uio->pages = devm_kcalloc(dev, uio->size >> PAGE_SHIFT, sizeof(*uio->pages), GFP_KERNEL);
	uio->memory = uio->pages ? vmalloc_user(uio->size) : NULL;
	if (!uio->memory)
		return -ENOMEM;
	for (i = 0; i < uio->size >> PAGE_SHIFT; i++)
		uio->pages[i] = vmalloc_to_page((void *)uio->memory + i * PAGE_SIZE);
	count = device_property_count_u32(dev, "fpga-cm,values");
	if (count > 0 && count <= ARRAY_SIZE(values) &&
	    !device_property_read_u32_array(dev, "fpga-cm,values", values, count))
		memcpy(uio->memory, values, min_t(size_t, count * sizeof(u32), uio->size));
	return devm_add_action_or_reset(dev, free_memory, uio->memory);
}

static unsigned long page_of_memory(void *context, unsigned long page)
{
	struct plsim_uio *uio = context;

	return page_to_pfn(uio->pages[page]);
}

static void unregister_window(void *window)
{
	cm_window_unregister(window);
}

static int offer_pages(struct device *dev, struct plsim_uio *uio)
{
	struct cm_window_config config = {
		.address = uio->info.mem[0].addr,
		.length = uio->size,
		.pfn = page_of_memory,
		.context = uio,
		.memory = true,
	};
	struct cm_window *window;

	if (!config.address)
		return 0;
	window = cm_window_register(&config);
	if (IS_ERR(window))
		return dev_err_probe(dev, PTR_ERR(window), "its address is another window's\n");
	return devm_add_action_or_reset(dev, unregister_window, window);
}

static int start_poll(struct device *dev, struct plsim_uio *uio)
{
	if (uio->doorbell == NO_DOORBELL)
		return 0;
	INIT_DELAYED_WORK(&uio->poll, plsim_uio_poll);
	schedule_delayed_work(&uio->poll, 0);
	return devm_add_action_or_reset(dev, stop_poll, uio);
}

static int init_debugfs(struct device *dev, struct plsim_uio *uio)
{
	uio->debugfs = debugfs_create_dir(dev_name(dev), plsim_debugfs_root);
	debugfs_create_file_unsafe("fire", 0200, uio->debugfs, uio, &fire_fops);
	debugfs_create_u64("events", 0444, uio->debugfs, &uio->events);
	return devm_add_action_or_reset(dev, remove_debugfs, uio->debugfs);
}

static int plsim_uio_probe(struct platform_device *pdev)
{
	struct device *dev = &pdev->dev;
	struct plsim_uio *uio = devm_kzalloc(dev, sizeof(*uio), GFP_KERNEL);
	int ret;

	if (!uio)
		return -ENOMEM;
	spin_lock_init(&uio->lock);
	uio->enabled = true;
	ret = read_properties(dev, uio);
	if (!ret)
		ret = init_memory(dev, uio);
	if (!ret)
		ret = offer_pages(dev, uio);
	if (ret)
		return ret;
	uio->info.version = "plsim";
	uio->info.priv = uio;
	uio->info.irq = UIO_IRQ_CUSTOM;
	uio->info.irqcontrol = plsim_uio_irqcontrol;
	set_mmap(uio);
	uio->info.mem[0].name = "registers";
	uio->info.mem[0].size = uio->size;
	uio->info.mem[0].memtype = UIO_MEM_PHYS;
	ret = devm_uio_register_device(dev, &uio->info);
	if (!ret)
		ret = start_poll(dev, uio);
	return ret ?: init_debugfs(dev, uio);
}

static const struct of_device_id plsim_uio_of_match[] = {
	{ .compatible = "fpga-cm,plsim-uio" },
	{}
};
MODULE_DEVICE_TABLE(of, plsim_uio_of_match);

struct platform_driver plsim_uio_driver = {
	.probe = plsim_uio_probe,
	.driver = {
		.name = "cm_plsim_uio",
		.of_match_table = plsim_uio_of_match,
	},
};
