// SPDX-License-Identifier: GPL-2.0-only
/* The driver of another kernel, built for this one. */
#include "seen.h"
#include "xilinx_dma_other.c"
