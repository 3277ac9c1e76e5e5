// SPDX-License-Identifier: Apache-2.0
#include "firmware.h"
/* Zynq UltraScale+: PL behind M_AXI_HPM0_FPD (0xa0000000); pl_ps_irq0[0..7] are SPI 89 to 96 (UG1085 table 13-1). */
#define TARGET fpga_full
#define CELLS 2
#define REG(address, size) 0x0 address 0x0 size
#define INTC gic
#define IRQ(number) 0 (89 + number) 4
#define CLOCK &zynqmp_clk 71
#define ICAP_CLOCK &zynqmp_clk 72
#define ADDRESS_BITS 40
#define SELECT "zynqmp"
#define IDCODE 0x04a49093 /* XCK26 */
#define FOLDER cm/camera
