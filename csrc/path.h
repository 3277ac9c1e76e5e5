/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Paths under the root folder, and what can be done to them.  All descriptors
 * are O_CLOEXEC and the caller's to close.
 */
#ifndef CM_SHIM_PATH_H
#define CM_SHIM_PATH_H

#include <stddef.h>

/* "@root/@path" in allocated memory, to be freed by the caller; NULL with errno. */
char *cm_path_join(const char *root, const char *path);

/* open() of @path under @root (NULL is "/"). */
int cm_path_open(const char *root, const char *path, int flags);

/* open() what an O_PATH descriptor stands for. */
int cm_path_reopen(int path_fd, int flags);

/**
 * cm_path_connect() - connect a SOCK_SEQPACKET to the socket behind an O_PATH fd
 *
 * Works through /proc/self/fd, because sun_path holds 107 bytes only and a
 * root may be longer.  With @timeout_ms no call on it waits longer, 0: for ever.
 * ENODEV where the socket is there but has no listener, ETIMEDOUT if nothing
 * takes the connection.
 */
int cm_path_connect(int path_fd, int timeout_ms);

/* No call on @sock waits longer than this. */
int cm_path_limit(int sock, int timeout_ms);

/* Text of a short plain file into @text, without the end of line; -1 with errno. */
int cm_path_read_text(const char *root, const char *path, char *text, size_t size);

#endif /* CM_SHIM_PATH_H */
