// SPDX-License-Identifier: GPL-2.0-only
/*
 * ICAP instead of PCAP: one of them has the configuration logic at a time.
 *
 * Zynq-7000 (UG585, devcfg.CTRL, 0xF8007000): PCAP_PR, bit 27, is 0 for ICAP.
 * Mainline's PCAP driver (drivers/fpga/zynq-fpga.c, CTRL_PCAP_PR_MASK) has the
 * register range, so it is mapped and not requested; it sets the bit for each
 * load of its own and clears it after, so what was found is put back here.
 *
 * ZynqMP (UG1087, CSU pcap_ctrl, 0xFFCA3008; CSU_PCAP_CTRL_PCAP_PR_MASK of the
 * vendor's xilfpga library): pcap_pr, bit 0, is 0 for ICAP, and each PCAP load
 * sets it to 1 again.  Only the platform firmware may write it.  The call is
 * PM_MMIO_WRITE (19) as drivers/firmware/xilinx/zynqmp.c makes it: function
 * PM_SIP_SVC | 19, first register address and, above it, mask, second register
 * value; the status is in the low word.  The PMU firmware allows the address
 * in pmAccessTable of its pm_mmio_access.c only if it was built with
 * SECURE_ACCESS, and says XST_PM_NO_ACCESS (2002) otherwise.
 *
 * None of it was run on silicon.
 */
#include <linux/arm-smccc.h>
#include <linux/io.h>
#include <linux/of.h>
#include <linux/property.h>

#include "icap.h"

#define ZYNQ_DEVCFG_CTRL 0xF8007000
#define ZYNQ_PCAP_PR BIT(27)

#define ZYNQMP_CSU_PCAP_CTRL 0xFFCA3008
#define ZYNQMP_PCAP_PR BIT(0)
#define ZYNQMP_PM_MMIO_WRITE 0xC2000013 /* PM_SIP_SVC | PM_MMIO_WRITE */
#define ZYNQMP_XST_PM_NO_ACCESS 2002

static void zynq_select(struct cm_icap *icap)
{
	u32 value = readl(icap->devcfg);

	icap->pcap_pr = value & ZYNQ_PCAP_PR;
	writel(value & ~ZYNQ_PCAP_PR, icap->devcfg);
}

static void zynq_restore(struct cm_icap *icap)
{
	u32 value = readl(icap->devcfg);

	writel((value & ~ZYNQ_PCAP_PR) | icap->pcap_pr, icap->devcfg);
}

#ifdef CONFIG_ARM64
static int zynqmp_set(u32 bit)
{
	struct arm_smccc_res result;
	u64 address_and_mask = ZYNQMP_CSU_PCAP_CTRL | (u64)ZYNQMP_PCAP_PR << 32;

	arm_smccc_smc(ZYNQMP_PM_MMIO_WRITE, address_and_mask, bit, 0, 0, 0, 0, 0, &result);
	switch (lower_32_bits(result.a0)) {
	case 0:
		return 0;
	case ZYNQMP_XST_PM_NO_ACCESS:
		return -EACCES;
	default:
		return -EIO;
	}
}
#else
static int zynqmp_set(u32 bit)
{
	return -EOPNOTSUPP;
}
#endif

/**
 * cm_icap_select_init() - read how this port is selected
 * @icap: port
 *
 * Return: 0, -EINVAL for an unknown way or one of another chip.
 */
int cm_icap_select_init(struct cm_icap *icap)
{
	const char *way;

	if (device_property_read_string(icap->dev, "fpga-cm,select", &way) || !strcmp(way, "none"))
		return 0;
	if (!strcmp(way, "zynq") && of_machine_is_compatible("xlnx,zynq-7000")) {
		icap->select = CM_SELECT_ZYNQ;
		icap->devcfg = devm_ioremap(icap->dev, ZYNQ_DEVCFG_CTRL, 4);
		return icap->devcfg ? 0 : -ENOMEM;
	}
	if (!strcmp(way, "zynqmp") && of_machine_is_compatible("xlnx,zynqmp")) {
		icap->select = CM_SELECT_ZYNQMP;
		return 0;
	}
	return dev_err_probe(icap->dev, -EINVAL, "fpga-cm,select \"%s\" is not of this machine\n",
			     way);
}

/**
 * cm_icap_select_port() - before a load
 * @icap: port
 *
 * Return: 0, -EACCES where the firmware does not allow it, -EIO for another
 * answer of it, -EOPNOTSUPP.
 */
int cm_icap_select_port(struct cm_icap *icap)
{
	if (icap->select == CM_SELECT_ZYNQ)
		zynq_select(icap);
	return icap->select == CM_SELECT_ZYNQMP ? zynqmp_set(0) : 0;
}

/**
 * cm_icap_deselect_port() - after a load: as it was before
 * @icap: port
 */
void cm_icap_deselect_port(struct cm_icap *icap)
{
	if (icap->select == CM_SELECT_ZYNQ)
		zynq_restore(icap);
	if (icap->select == CM_SELECT_ZYNQMP && zynqmp_set(ZYNQMP_PCAP_PR))
		dev_warn(icap->dev, "PCAP could not be selected again\n");
}
