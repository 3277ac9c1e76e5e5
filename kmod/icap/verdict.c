// SPDX-License-Identifier: GPL-2.0-only
/* What the port's error bits mean for the caller. */
#include <linux/errno.h>

#include "icap.h"

/**
 * cm_icap_verdict() - the errno of a load
 * @errors: CM_ICAP_ERR_* bits
 *
 * Return: 0 or a negative errno; where several bits are set, that of the
 * cause rather than of what follows from it.
 */
int cm_icap_verdict(u32 errors)
{
	if (errors & CM_ICAP_ERR_DMA)
		return -EIO;
	if (errors & CM_ICAP_ERR_ID)
		return -ENODEV;
	if (errors & CM_ICAP_ERR_CRC)
		return -EILSEQ;
	if (errors & (CM_ICAP_ERR_NOSYNC | CM_ICAP_ERR_PORT))
		return -EIO;
	if (errors & CM_ICAP_ERR_TIMEOUT)
		return -ETIMEDOUT;
	return 0;
}
