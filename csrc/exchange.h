/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Two files or folders that change their names in one step, which Python's os module does not offer.
 */
#ifndef CM_SHIM_EXCHANGE_H
#define CM_SHIM_EXCHANGE_H

/*
 * Exchange what stands at two paths of one file system: a reader sees both before or both after.
 * ENOENT where one is missing, EINVAL where the file system cannot.
 */
int cm_exchange(const char *one, const char *other);

#endif
