// SPDX-License-Identifier: Apache-2.0
#include "firmware.h"
/* Zynq-7000: PL behind M_AXI_GP1 (0x80000000 to 0xbfffffff); IRQ_F2P[0..7] are SPI 29 to 36 (UG585 table 7-4). */
#define TARGET fpga_full
#define CELLS 1
#define REG(address, size) address size
#define INTC intc
#define IRQ(number) 0 (29 + number) 4
#define CLOCK &clkc 15
#define ICAP_CLOCK &clkc 16
#define ADDRESS_BITS 32
#define SELECT "zynq"
#define IDCODE 0x03727093 /* XC7Z020 */
#define FOLDER cm/camera
