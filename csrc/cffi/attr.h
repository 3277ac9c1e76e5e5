/* SPDX-License-Identifier: Apache-2.0 */
ssize_t cm_attr_read(const char *root, const char *path, void *data, size_t size);
int cm_attr_write(const char *root, const char *path, const void *data, size_t size);
int cm_attr_mkdir(const char *root, const char *folder, const char *name);
int cm_attr_rmdir(const char *root, const char *folder, const char *name);
int cm_attr_watch(const char *root, const char *folder);
