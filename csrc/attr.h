/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Attributes of sysfs and configfs: plain files on a board; on a simulated one
 * those that do something are sockets, and a folder in which folders may be
 * made has a ".node" socket.
 *
 * Stateless; every call opens, does its work and closes.  Blocks as long as the
 * attribute's driver takes.
 */
#ifndef CM_SHIM_ATTR_H
#define CM_SHIM_ATTR_H

#include <stddef.h>
#include <sys/types.h>

/* Read up to @size bytes of @path under @root; returns how many.  EMSGSIZE if there are more. */
ssize_t cm_attr_read(const char *root, const char *path, void *data, size_t size);

/**
 * cm_attr_write() - write the whole of @data to @path in one go, without O_TRUNC
 *
 * Errors: those of open(), write() and close(); a driver's refusal is one of
 * them, but configfs binary attributes (dtbo) act at close() and report nothing:
 * read the status.  Simulated: EMSGSIZE above CM_NODE_PAYLOAD_MAX.
 */
int cm_attr_write(const char *root, const char *path, const void *data, size_t size);

/* Make or remove the folder @name in @folder under @root. */
int cm_attr_mkdir(const char *root, const char *folder, const char *name);
int cm_attr_rmdir(const char *root, const char *folder, const char *name);

/**
 * cm_attr_watch() - a non-blocking inotify(7) descriptor of the folder @folder under @root
 *
 * It has an event, with the name, for each write to an attribute in it by anybody, and, as a simulated board writes
 * its plain attributes, for each that is replaced.
 */
int cm_attr_watch(const char *root, const char *folder);

#endif /* CM_SHIM_ATTR_H */
