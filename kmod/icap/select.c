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
 * SECURE_ACCESS, and says XST_PM_NO_ACCESS (2002) otherwise.  So it is asked
 * for the register (PM_MMIO_READ, 20) when the driver starts.  Whether by SMC or
 * HVC says the firmware's node, as to the kernel's own driver.
 *
 * None of it was run on silicon.
 */
#include <linux/arm-smccc.h>
#include <linux/io.h>
#include <linux/of.h>
#include <linux/of_address.h>
#include <linux/property.h>

#include "icap.h"

#define ZYNQ_PCAP_PR BIT(27)

#define ZYNQMP_CSU_PCAP_CTRL 0xFFCA3008
#define ZYNQMP_PCAP_PR BIT(0)
#define ZYNQMP_PM_MMIO_WRITE 0xC2000013 /* PM_SIP_SVC | PM_MMIO_WRITE */
#define ZYNQMP_PM_MMIO_READ 0xC2000014
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
static int zynqmp_call(const struct cm_icap *icap, u32 function, u64 first, u64 second)
{
	struct arm_smccc_res result;

	if (icap->hvc)
		arm_smccc_hvc(function, first, second, 0, 0, 0, 0, 0, &result);
	else
		arm_smccc_smc(function, first, second, 0, 0, 0, 0, 0, &result);
	switch (lower_32_bits(result.a0)) {
	case 0:
		return 0;
	case ZYNQMP_XST_PM_NO_ACCESS:
		return -EACCES;
	default:
		return -EIO;
	}
}

static int zynqmp_set(const struct cm_icap *icap, u32 bit)
{
	return zynqmp_call(icap, ZYNQMP_PM_MMIO_WRITE,
			   ZYNQMP_CSU_PCAP_CTRL | (u64)ZYNQMP_PCAP_PR << 32, bit);
}

static int zynqmp_ask(const struct cm_icap *icap)
{
	return zynqmp_call(icap, ZYNQMP_PM_MMIO_READ, ZYNQMP_CSU_PCAP_CTRL, 0);
}
#else
static int zynqmp_set(const struct cm_icap *icap, u32 bit)
{
	return -EOPNOTSUPP;
}

static int zynqmp_ask(const struct cm_icap *icap)
{
	return -EOPNOTSUPP;
}
#endif

static int zynqmp_init(struct cm_icap *icap)
{
	struct device_node *node = of_find_compatible_node(NULL, NULL, "xlnx,zynqmp-firmware");
	const char *method;
	int ret = -EINVAL;

	if (node && !of_property_read_string(node, "method", &method)) {
		icap->hvc = !strcmp(method, "hvc");
		ret = icap->hvc || !strcmp(method, "smc") ? 0 : -EINVAL;
	}
	of_node_put(node);
	if (ret)
		return dev_err_probe(icap->dev, ret, "no firmware node with a method\n");
	icap->select = CM_SELECT_ZYNQMP;
	ret = zynqmp_ask(icap);
	if (ret) {
		icap->info.caps |= CM_ICAP_CAP_DENIED;
		dev_warn(icap->dev, "the platform's firmware does not give the port (%d): load through the FPGA manager, or build the firmware with SECURE_ACCESS\n",
			 ret);
	}
	return 0;
}

static int zynq_init(struct cm_icap *icap)
{
	struct device_node *node = of_find_compatible_node(NULL, NULL, "xlnx,zynq-devcfg-1.0");
	struct resource range;
	int ret = node ? of_address_to_resource(node, 0, &range) : -EINVAL;

	of_node_put(node);
	if (ret)
		return dev_err_probe(icap->dev, ret, "no devcfg node\n");
	icap->select = CM_SELECT_ZYNQ;
	/* CTRL is its first register */
	icap->devcfg = devm_ioremap(icap->dev, range.start, sizeof(u32));
	return icap->devcfg ? 0 : -ENOMEM;
}

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
	if (!strcmp(way, "zynq"))
		return zynq_init(icap);
	if (!strcmp(way, "zynqmp"))
		return zynqmp_init(icap);
	return dev_err_probe(icap->dev, -EINVAL, "fpga-cm,select \"%s\" is unknown\n", way);
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
	return icap->select == CM_SELECT_ZYNQMP ? zynqmp_set(icap, 0) : 0;
}

/**
 * cm_icap_deselect_port() - after a load: as it was before
 * @icap: port
 */
void cm_icap_deselect_port(struct cm_icap *icap)
{
	if (icap->select == CM_SELECT_ZYNQ)
		zynq_restore(icap);
	if (icap->select == CM_SELECT_ZYNQMP && zynqmp_set(icap, ZYNQMP_PCAP_PR))
		dev_warn(icap->dev, "PCAP could not be selected again\n");
}
