// SPDX-License-Identifier: GPL-2.0-only
/* The driver of the kernel that this is built for. */
#include "seen.h"
#include "xilinx_dma.c"
