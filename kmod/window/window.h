/* SPDX-License-Identifier: GPL-2.0-only */
/* What the parts of cm_window share. */
#ifndef _CM_WINDOW_PRIVATE_H
#define _CM_WINDOW_PRIVATE_H

#include "cm_window_core.h"

struct dentry;
struct platform_driver;

int cm_windows_init(void);
void cm_windows_exit(void);
void cm_window_bridges_show(struct dentry *parent);
void cm_window_bridges_exit(void);

extern struct platform_driver cm_window_driver;

#endif /* _CM_WINDOW_PRIVATE_H */
