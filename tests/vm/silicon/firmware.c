// SPDX-License-Identifier: GPL-2.0-only
/*
 * The platform firmware of a ZynqMP, as far as a configuration port needs it:
 * real HVC calls, answered above the kernel (vectors.S).  QEMU starts the
 * kernel at EL2 (-M virt,virtualization=on), whose vectors it may then set.
 * Whether the firmware was built with SECURE_ACCESS is a file in debugfs.
 */
#include <linux/arm-smccc.h>
#include <linux/debugfs.h>
#include <linux/gfp.h>
#include <linux/io.h>
#include <linux/mm.h>
#include <linux/smp.h>
#include <asm/virt.h>

#include "model.h"

#define PAGES 1 /* order: the table is 2 KB, its code and its data follow */

/**
 * struct axi_firmware - behind the vectors, known to vectors.S
 * @granted: it was built with SECURE_ACCESS
 * @pcap_ctrl: CSU's PCAP_CTRL: bit 0 selects PCAP
 * @writes: of it
 * @refusals: calls that ended with XST_PM_NO_ACCESS
 */
struct axi_firmware {
	u32 granted;
	u32 pcap_ctrl;
	u32 writes;
	u32 refusals;
};

extern const char axi_vectors[], axi_vectors_end[];

/* the processors look there for their vectors as long as they run, so it is never given back */
static unsigned long page;

static bool set_vectors(phys_addr_t vectors)
{
	struct arm_smccc_res result;

	arm_smccc_hvc(HVC_SET_VECTORS, vectors, 0, 0, 0, 0, 0, 0, &result);
	return !result.a0;
}

static void set_own_vectors(void *data)
{
	set_vectors(virt_to_phys((void *)page));
}

static void show(struct dentry *root, struct axi_firmware *firmware)
{
	struct dentry *folder = debugfs_create_dir("firmware", root);

	debugfs_create_u32("secure_access", 0600, folder, &firmware->granted);
	debugfs_create_x32("pcap_ctrl", 0600, folder, &firmware->pcap_ctrl);
	debugfs_create_u32("writes", 0400, folder, &firmware->writes);
	debugfs_create_u32("refusals", 0400, folder, &firmware->refusals);
}

/**
 * axi_firmware_start() - answer the calls
 * @root: folder of the model
 *
 * Caches are not looked after: emulated processors have none.
 *
 * Return: 0, also on a board that was not started at EL2 and has no firmware
 * then; -ENOMEM.
 */
int axi_firmware_start(struct dentry *root)
{
	size_t size = axi_vectors_end - axi_vectors;
	struct axi_firmware *firmware;

	if (!page)
		page = __get_free_pages(GFP_KERNEL | __GFP_ZERO, PAGES);
	if (!page)
		return -ENOMEM;
	memcpy((void *)page, axi_vectors, size);
	firmware = (struct axi_firmware *)(page + size);
	firmware->pcap_ctrl = 1;
	/* PSCI behind HVC knows no such call; the kernel's stub at EL2 does */
	if (!set_vectors(virt_to_phys((void *)page)))
		return 0;
	on_each_cpu(set_own_vectors, NULL, 1);
	show(root, firmware);
	return 0;
}
