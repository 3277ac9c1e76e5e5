// SPDX-License-Identifier: Apache-2.0
/* Windows: what the manager lends, and the accesses. */
#include "cm_registers.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "cm_private.h"
#include "window.h"

#define TOLD_MS 1000	     /* at most until a manager that took pages back says why */
#define TABLE_MAX (64 << 20) /* bytes */

struct cm_registers {
	struct connection connection;
	struct cm_grant *grant;
	uint64_t address; /* of the first page */
	char *table;	  /* a Config message */
	size_t table_size;
	char names[CM_PLANE_PACKET_MAX +
		   1]; /* region, module, configuration, mode, each with a NUL */
	char mode[256];
	bool told; /* that they were taken back */
};

static uint8_t open_flags(uint32_t flags)
{
	uint8_t wanted = CM_PLANE_OPEN_WINDOW;

	if (flags & CM_REGISTERS_WRITE)
		wanted |= CM_PLANE_OPEN_WRITE;
	if (flags & CM_REGISTERS_EXCLUSIVE)
		wanted |= CM_PLANE_OPEN_EXCLUSIVE;
	if (flags & CM_REGISTERS_WAIT)
		wanted |= CM_PLANE_OPEN_WAIT;
	return wanted;
}

struct cm_registers *cm_registers_open(const char *runtime_dir, const char *name, uint32_t flags,
				       const char *lease)
{
	struct cm_plane_descriptor wanted = { .kind = CM_PLANE_OPEN, .flags = open_flags(flags) };
	struct cm_registers *registers;

	if (flags & ~(CM_REGISTERS_WRITE | CM_REGISTERS_EXCLUSIVE | CM_REGISTERS_WAIT)) {
		errno = EINVAL;
		return NULL;
	}
	registers = calloc(1, sizeof(*registers));
	if (registers &&
	    connection_open(&registers->connection, runtime_dir, name, &wanted, lease)) {
		int error = errno;

		free(registers);
		registers = NULL;
		errno = error;
	}
	return registers;
}

static void forget_table(struct cm_registers *registers)
{
	free(registers->table);
	registers->table = NULL;
}

void cm_registers_close(struct cm_registers *registers)
{
	if (!registers)
		return;
	cm_grant_unmap(registers->grant);
	forget_table(registers);
	connection_close(&registers->connection);
	free(registers);
}

int cm_registers_fd(const struct cm_registers *registers)
{
	return registers->connection.fd;
}

/* It is read, not mapped: a file that is cut short under a mapping ends the process. */
static int read_table(struct cm_registers *registers, int fd)
{
	struct stat st;

	if (fstat(fd, &st))
		return -1;
	if (st.st_size > TABLE_MAX) {
		errno = EPROTO;
		return -1;
	}
	registers->table_size = (size_t)st.st_size;
	registers->table = malloc(registers->table_size + 1);
	if (!registers->table)
		return -1;
	if (pread(fd, registers->table, registers->table_size, 0) == st.st_size)
		return 0;
	errno = EPROTO;
	return -1;
}

static int map(struct cm_registers *registers, const struct packet *packet)
{
	size_t length = packet->size - sizeof(packet->head);
	int result = -1;

	if (packet->fd_count != 2) {
		errno = EPROTO;
	} else if (!read_table(registers, packet->fds[1])) {
		registers->grant = cm_grant_map(packet->fds[0]);
		result = registers->grant ? 1 : -1;
	}
	packet_close(packet);
	if (result < 0) {
		forget_table(registers);
		return -1;
	}
	registers->address = packet->head.sequence;
	memcpy(registers->names, packet->bytes + sizeof(packet->head), length);
	return 1;
}

/* The @number'th of several texts that each end with a NUL; "" behind the last. */
static const char *nth(const char *texts, const char *end, int number)
{
	while (number-- && texts < end)
		texts += strlen(texts) + 1;
	return texts < end ? texts : "";
}

static int taken_back(struct cm_registers *registers, const struct packet *packet)
{
	const char *mode =
		nth(packet->bytes + sizeof(packet->head), packet->bytes + packet->size, 1);

	registers->told = true;
	strncpy(registers->mode, mode, sizeof(registers->mode) - 1);
	errno = ESTALE;
	return -1;
}

/* 1 for pages, 0 for what has no meaning here. */
static int take(struct cm_registers *registers, const struct packet *packet)
{
	if (packet->head.kind == CM_PLANE_WINDOW && !registers->grant)
		return map(registers, packet);
	if (packet->head.kind == CM_PLANE_REVOKED)
		return taken_back(registers, packet);
	return connection_take(&registers->connection, packet);
}

int cm_registers_wait(struct cm_registers *registers, int timeout_ms)
{
	int64_t begun = connection_now_ms();

	for (;;) {
		struct packet packet;
		int result;

		if (registers->told || (registers->grant && cm_grant_revoked(registers->grant))) {
			errno = ESTALE;
			return -1;
		}
		if (registers->grant)
			return 1;
		result = connection_wait(&registers->connection, timeout_ms, begun);
		if (result <= 0)
			return result;
		result = connection_receive(&registers->connection, &packet);
		if (!result)
			result = take(registers, &packet);
		else if (errno == EAGAIN)
			result = 0;
		if (result)
			return result;
	}
}

static bool has_pages(const struct cm_registers *registers)
{
	if (registers->grant)
		return true;
	errno = EAGAIN;
	return false;
}

int cm_registers_find(const struct cm_registers *registers, const char *name,
		      struct cm_register *found)
{
	if (!has_pages(registers))
		return -1;
	if (table_find(registers->table, registers->table_size, name, found))
		return -1;
	found->offset -= registers->address;
	return 0;
}

int cm_register_read(const struct cm_registers *registers, const struct cm_register *which,
		     uint64_t *value)
{
	if (!has_pages(registers))
		return -1;
	if (!(which->access & CM_REGISTER_READS)) {
		errno = EACCES;
		return -1;
	}
	if (cm_grant_read(registers->grant, which->offset, which->width, value))
		return -1;
	*value = *value >> which->lsb & which->mask;
	return 0;
}

int cm_register_write(const struct cm_registers *registers, const struct cm_register *which,
		      uint64_t value)
{
	uint64_t beside = 0;

	if (!has_pages(registers))
		return -1;
	if (!(which->access & CM_REGISTER_WRITES)) {
		errno = EACCES;
		return -1;
	}
	if (which->kept && cm_grant_read(registers->grant, which->offset, which->width, &beside))
		return -1;
	beside = (beside & which->kept) | value << which->lsb;
	if (value & ~which->mask || beside < which->minimum || beside > which->maximum) {
		errno = ERANGE;
		return -1;
	}
	return cm_grant_write(registers->grant, which->offset, which->width, beside);
}

/* The pages are taken back before the packet that says why is sent. */
static bool is_told(struct cm_registers *registers)
{
	int64_t begun = connection_now_ms();
	struct packet packet;

	while (!registers->told && registers->grant &&
	       connection_wait(&registers->connection,
			       cm_grant_revoked(registers->grant) ? TOLD_MS : 0, begun) > 0 &&
	       !connection_receive(&registers->connection, &packet))
		take(registers, &packet);
	return registers->told;
}

const char *cm_registers_mode(struct cm_registers *registers)
{
	int error = errno;
	bool told = is_told(registers);

	errno = error;
	return told ? registers->mode
		    : nth(registers->names, registers->names + sizeof(registers->names), 3);
}

const char *cm_registers_region(const struct cm_registers *registers)
{
	return nth(registers->names, registers->names + sizeof(registers->names), 0);
}

const char *cm_registers_module(const struct cm_registers *registers)
{
	return nth(registers->names, registers->names + sizeof(registers->names), 1);
}

const char *cm_registers_error(const struct cm_registers *registers)
{
	return registers->connection.error;
}
