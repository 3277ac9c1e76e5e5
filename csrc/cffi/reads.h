/* SPDX-License-Identifier: Apache-2.0 */
struct cm_reads;
struct cm_read {
	struct cm_uio *uio;
	unsigned int map;
	unsigned int width;
	uint64_t offset;
	uint64_t mask;
	unsigned int lsb;
	...;
};

struct cm_reads *cm_reads_new(void);
void cm_reads_close(struct cm_reads *reads);
int cm_reads_wanted_fd(struct cm_reads *reads);
int cm_reads_adopt(struct cm_reads *reads, int fd, int owner);
int cm_reads_offer(struct cm_reads *reads, const char *name, const struct cm_read *read);
void cm_reads_withdraw(struct cm_reads *reads);
