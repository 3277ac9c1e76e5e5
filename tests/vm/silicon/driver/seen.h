/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * For drivers/dma/xilinx/xilinx_dma.c of some kernel, not a byte changed, which
 * is included behind this: only what it calls to reach its registers goes to
 * the model.
 */
#include <linux/io.h>
#include <linux/io-64-nonatomic-lo-hi.h>
#include <linux/iopoll.h>
#include <linux/platform_device.h>

void __iomem *axi_model_map(struct platform_device *pdev);
u32 axi_model_read(const void __iomem *address);
void axi_model_write(u32 value, void __iomem *address);

static inline void axi_model_write64(u64 value, void __iomem *address)
{
	axi_model_write(lower_32_bits(value), address);
	axi_model_write(upper_32_bits(value), address + 4);
}

#undef ioread32
#undef iowrite32
#undef readl
#undef writel
#undef lo_hi_writeq
#define ioread32 axi_model_read
#define iowrite32 axi_model_write
#define readl axi_model_read
#define writel axi_model_write
#define lo_hi_writeq axi_model_write64
#define devm_platform_ioremap_resource(pdev, index) axi_model_map(pdev)
