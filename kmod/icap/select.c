// SPDX-License-Identifier: GPL-2.0
/*
 * ICAP instead of PCAP: one of them has the configuration logic at a time.
 *
 * Zynq-7000 (UG585, devcfg.CTRL): PCAP_PR, bit 27, is 0 for ICAP.  The
 * mainline PCAP driver has the register range, so it is mapped and not
 * requested; that driver sets the bit itself for each load of its own.
 *
 * ZynqMP (UG1087, CSU pcap_ctrl): bit 0 is 0 for ICAP.  Only the platform
 * firmware may write it, and each PCAP load sets it to 1 again.
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
#define ZYNQMP_PM_MMIO_WRITE 0xC2000013 /* SiP service, PM API 19 */

static void zynq_set(struct cm_icap *icap, u32 bit)
{
	u32 value = readl(icap->devcfg);

	writel((value & ~ZYNQ_PCAP_PR) | bit, icap->devcfg);
}

#ifdef CONFIG_ARM64
static int zynqmp_set(u32 bit)
{
	struct arm_smccc_res result;
	u64 address_and_mask = ZYNQMP_CSU_PCAP_CTRL | (u64)ZYNQMP_PCAP_PR << 32;

	arm_smccc_smc(ZYNQMP_PM_MMIO_WRITE, address_and_mask, bit, 0, 0, 0, 0, 0, &result);
	/* the firmware's own status is in the low word, 0 is success */
	return lower_32_bits(result.a0) ? -EACCES : 0;
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
 * Return: 0, -EACCES where the firmware refuses, -EOPNOTSUPP.
 */
int cm_icap_select_port(struct cm_icap *icap)
{
	if (icap->select == CM_SELECT_ZYNQ)
		zynq_set(icap, 0);
	return icap->select == CM_SELECT_ZYNQMP ? zynqmp_set(0) : 0;
}

/**
 * cm_icap_deselect_port() - after a load: PCAP has the logic again
 * @icap: port
 */
void cm_icap_deselect_port(struct cm_icap *icap)
{
	if (icap->select == CM_SELECT_ZYNQ)
		zynq_set(icap, ZYNQ_PCAP_PR);
	if (icap->select == CM_SELECT_ZYNQMP && zynqmp_set(ZYNQMP_PCAP_PR))
		dev_warn(icap->dev, "PCAP could not be selected again\n");
}
