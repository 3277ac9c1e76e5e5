/* SPDX-License-Identifier: GPL-2.0-only */
/* Registers of AXI MCDMA (PG288); sources.md says where each bit is from. */
#ifndef _CM_AXI_MCDMA_H
#define _CM_AXI_MCDMA_H

#include "model.h"

#define MCDMA_THRESHOLD GENMASK(23, 16) /* of a channel's CR, and what is left of it in SR */
#define MCDMA_IOC BIT(5)
#define MCDMA_ERROR BIT(7)

/* ERR */
#define MCDMA_ERR_INT BIT(0)
#define MCDMA_ERR_DEC BIT(2)
#define MCDMA_ERR_SG_INT BIT(4)
#define MCDMA_ERR_SG_DEC BIT(6)

#endif /* _CM_AXI_MCDMA_H */
