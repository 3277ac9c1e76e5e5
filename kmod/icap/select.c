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
 * in pmAccessTable of its pm_mmio_access.c where it was put there, or
 * with SECURE_ACCESS, and says XST_PM_NO_ACCESS (2002) otherwise.  So it is asked
 * for the register (PM_MMIO_READ, 20) when the driver starts.  Whether by SMC or
 * HVC says the firmware's node, as to the kernel's own driver.
 *
 * Who selects the port has the platform's own FPGA manager locked meanwhile, as
 * each of its loads has: -EBUSY otherwise.
 *
 * None of it was run on silicon.
 */
#include <linux/arm-smccc.h>
#include <linux/clk.h>
#include <linux/io.h>
#include <linux/of.h>
#include <linux/of_address.h>
#include <linux/property.h>

#include "icap.h"

#if IS_REACHABLE(CONFIG_FPGA)
#include <linux/fpga/fpga-mgr.h>
#endif

#define ZYNQ_PCAP_PR BIT(27)

#define ZYNQMP_CSU_PCAP_CTRL 0xFFCA3008
#define ZYNQMP_PCAP_PR BIT(0)
#define ZYNQMP_PM_MMIO_WRITE 0xC2000013 /* PM_SIP_SVC | PM_MMIO_WRITE */
#define ZYNQMP_PM_MMIO_READ 0xC2000014
#define ZYNQMP_XST_PM_NO_ACCESS 2002

#if IS_REACHABLE(CONFIG_FPGA)
/* a platform whose manager has no driver loads nothing by itself */
static int hold_platform(struct cm_icap *icap)
{
	struct fpga_manager *manager;
	int ret;

	if (!icap->platform)
		return 0;
	manager = of_fpga_mgr_get(icap->platform);
	if (IS_ERR(manager))
		return PTR_ERR(manager) == -ENODEV ? 0 : PTR_ERR(manager);
	ret = fpga_mgr_lock(manager);
	if (ret)
		fpga_mgr_put(manager);
	else
		icap->held = manager;
	return ret;
}

static void let_go_of_platform(struct cm_icap *icap)
{
	if (!icap->held)
		return;
	fpga_mgr_unlock(icap->held);
	fpga_mgr_put(icap->held);
	icap->held = NULL;
}
#else
static int hold_platform(struct cm_icap *icap)
{
	return 0;
}

static void let_go_of_platform(struct cm_icap *icap)
{
}
#endif

/* mainline's driver stops the clock of these registers after each access of its own */
static int zynq_select(struct cm_icap *icap)
{
	int ret = clk_prepare_enable(icap->devcfg_clock);
	u32 value;

	if (ret)
		return ret;
	value = readl(icap->devcfg);
	icap->pcap_pr = value & ZYNQ_PCAP_PR;
	writel(value & ~ZYNQ_PCAP_PR, icap->devcfg);
	clk_disable_unprepare(icap->devcfg_clock);
	return 0;
}

static int zynq_restore(struct cm_icap *icap)
{
	int ret = clk_prepare_enable(icap->devcfg_clock);
	u32 value;

	if (ret)
		return ret;
	value = readl(icap->devcfg);
	writel((value & ~ZYNQ_PCAP_PR) | icap->pcap_pr, icap->devcfg);
	clk_disable_unprepare(icap->devcfg_clock);
	return 0;
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

static void put_node(void *node)
{
	of_node_put(node);
}

static void put_clock(void *clock)
{
	clk_put(clock);
}

static int keep_platform(struct cm_icap *icap, struct device_node *node)
{
	icap->platform = of_node_get(node);
	return devm_add_action_or_reset(icap->dev, put_node, icap->platform);
}

static int zynqmp_init(struct cm_icap *icap)
{
	struct device_node *node = of_find_compatible_node(NULL, NULL, "xlnx,zynqmp-firmware");
	struct device_node *pcap = of_find_compatible_node(NULL, NULL, "xlnx,zynqmp-pcap-fpga");
	const char *method;
	int ret = -EINVAL;

	if (node && !of_property_read_string(node, "method", &method)) {
		icap->hvc = !strcmp(method, "hvc");
		ret = icap->hvc || !strcmp(method, "smc") ? 0 : -EINVAL;
	}
	of_node_put(node);
	if (ret)
		dev_err_probe(icap->dev, ret, "no firmware node with a method\n");
	else if (pcap)
		ret = keep_platform(icap, pcap);
	of_node_put(pcap);
	if (ret)
		return ret;
	icap->select = CM_SELECT_ZYNQMP;
	ret = zynqmp_ask(icap);
	if (ret) {
		icap->info.caps |= CM_ICAP_CAP_DENIED;
		dev_warn(icap->dev, "the platform's firmware does not give the port (%d): load through the FPGA manager, or allow 0xFFCA3008 in its pm_mmio_access.c\n",
			 ret);
	}
	return 0;
}

static int zynq_init(struct cm_icap *icap)
{
	struct device_node *node = of_find_compatible_node(NULL, NULL, "xlnx,zynq-devcfg-1.0");
	struct resource range;
	int ret = node ? of_address_to_resource(node, 0, &range) : -EINVAL;

	if (!ret)
		ret = keep_platform(icap, node);
	of_node_put(node);
	if (ret)
		return dev_err_probe(icap->dev, ret, "no devcfg node\n");
	icap->devcfg_clock = of_clk_get_by_name(icap->platform, "ref_clk");
	ret = PTR_ERR_OR_ZERO(icap->devcfg_clock);
	if (ret == -ENOENT || ret == -EINVAL) {
		icap->devcfg_clock = NULL;
		ret = 0;
	}
	if (!ret)
		ret = devm_add_action_or_reset(icap->dev, put_clock, icap->devcfg_clock);
	if (ret)
		return dev_err_probe(icap->dev, ret, "no clock of devcfg\n");
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
 * Return: 0, and the port is this load's until cm_icap_deselect_port() by the
 * same task; -EBUSY while the platform's own manager is in use, -EACCES where
 * the firmware does not allow it, -EIO for another answer of it, -EOPNOTSUPP.
 */
int cm_icap_select_port(struct cm_icap *icap)
{
	int ret = hold_platform(icap);

	if (ret)
		return ret;
	if (icap->select == CM_SELECT_ZYNQ)
		ret = zynq_select(icap);
	else if (icap->select == CM_SELECT_ZYNQMP)
		ret = zynqmp_set(icap, 0);
	if (ret)
		let_go_of_platform(icap);
	return ret;
}

/**
 * cm_icap_deselect_port() - after a load: as it was before
 * @icap: port
 */
void cm_icap_deselect_port(struct cm_icap *icap)
{
	int ret = 0;

	if (icap->select == CM_SELECT_ZYNQ)
		ret = zynq_restore(icap);
	else if (icap->select == CM_SELECT_ZYNQMP)
		ret = zynqmp_set(icap, ZYNQMP_PCAP_PR);
	if (ret)
		dev_warn(icap->dev, "PCAP could not be selected again (%d)\n", ret);
	let_go_of_platform(icap);
}
