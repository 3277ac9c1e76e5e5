// SPDX-License-Identifier: Apache-2.0
/* Reads, writes and maps beside a manager that says what is wrong (fake_manager.py), and touches what it is given. */
#include <dirent.h>
#include <stdio.h>
#include <string.h>

#include "client/cm_plane.h"
#include "client/cm_registers.h"

#define WAIT_MS 300
#define TIMES 3

static unsigned int seen; /* so that reading is not left out */

static int descriptors(void)
{
	DIR *folder = opendir("/proc/self/fd");
	int count = 0;

	while (readdir(folder))
		count++;
	closedir(folder);
	return count;
}

static void read_some(const char *folder)
{
	struct cm_reader *reader = cm_reader_open(folder, "x", 2);
	struct cm_frame frame;

	for (int i = 0; reader && i < TIMES && cm_reader_next(reader, WAIT_MS, &frame) == 1; i++) {
		const unsigned char *bytes = frame.data;
		const struct cm_plane_geometry *form = cm_reader_geometry(reader);

		for (size_t at = 0; at < frame.length; at += 512)
			seen += bytes[at];
		for (uint32_t axis = 0; axis < form->dimensions; axis++)
			seen += form->shape[axis];
		seen += (unsigned int)strlen(form->dtype) +
			(unsigned int)strlen(cm_reader_mode(reader));
		cm_reader_release(reader, &frame);
	}
	if (reader)
		seen += (unsigned int)strlen(cm_reader_error(reader));
	cm_reader_close(reader);
}

static void write_some(const char *folder)
{
	struct cm_writer *writer = cm_writer_open(folder, "x", 2, NULL);
	struct cm_slot slot;

	for (int i = 0; writer && i < TIMES && cm_writer_slot(writer, WAIT_MS, &slot) == 1; i++) {
		memset(slot.data, i, slot.length);
		cm_writer_submit(writer, &slot, 0);
	}
	if (writer)
		cm_writer_flush(writer, WAIT_MS);
	cm_writer_close(writer);
}

static void map_some(const char *folder)
{
	struct cm_registers *registers =
		cm_registers_open(folder, "edge", CM_REGISTERS_WRITE, NULL);
	struct cm_register found;
	uint64_t value = 0;

	for (int i = 0; registers && i < TIMES && cm_registers_wait(registers, WAIT_MS) != 1; i++)
		;
	if (registers && !cm_registers_find(registers, "v", &found))
		cm_register_read(registers, &found, &value);
	if (registers)
		seen += (unsigned int)(strlen(cm_registers_mode(registers)) + value);
	cm_registers_close(registers);
}

int main(int count, char **words)
{
	int before = descriptors();

	if (count != 2)
		return 2;
	read_some(words[1]);
	write_some(words[1]);
	map_some(words[1]);
	if (descriptors() != before) {
		fprintf(stderr, "descriptors are left open\n");
		return 1;
	}
	return seen == 4711 ? 3 : 0;
}
