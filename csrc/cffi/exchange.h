/* SPDX-License-Identifier: Apache-2.0 */
int cm_exchange(const char *one, const char *other);
