// SPDX-License-Identifier: Apache-2.0
/*
 * Writes frames where the hardware takes them from: writer RUNTIME STREAM COUNT [LEASE]
 *
 *	cc -o writer writer.c $(pkg-config --cflags --libs cm-plane)
 */
#include <cm_plane.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* All bytes of the frame are its number; what lies between lines that are apart is left alone. */
static void fill(const struct cm_slot *slot, const struct cm_plane_geometry *geometry, int number)
{
	size_t lines = geometry->stride ? geometry->shape[0] : 1;
	size_t bytes = geometry->frame_length ? geometry->frame_length : slot->length;

	for (size_t line = 0; line < lines; line++)
		memset((char *)slot->data + line * geometry->stride, number, bytes / lines);
}

static int write_frames(struct cm_writer *writer, int count)
{
	struct cm_slot slot;

	for (int number = 0; number < count; number++) {
		int got = cm_writer_slot(writer, 5000, &slot);

		if (got <= 0)
			return got;
		fill(&slot, cm_writer_geometry(writer), number);
		if (cm_writer_submit(writer, &slot, 0))
			return -1;
	}
	return cm_writer_flush(writer, 5000);
}

int main(int argc, char **argv)
{
	struct cm_writer *writer;
	int result;

	if (argc != 4 && argc != 5) {
		fprintf(stderr, "usage: writer RUNTIME STREAM COUNT [LEASE]\n");
		return 2;
	}
	writer = cm_writer_open(argv[1], argv[2], 0, argc == 5 ? argv[4] : NULL);
	if (!writer) {
		fprintf(stderr, "writer: %s: %s\n", argv[1], strerror(errno));
		return 1;
	}
	result = write_frames(writer, atoi(argv[3]));
	if (result <= 0)
		fprintf(stderr, "writer: %s\n",
			result == 0	   ? "the hardware took nothing within 5 s"
			: errno == EACCES ? cm_writer_error(writer)
					   : strerror(errno));
	else
		printf("%s frames taken\n", argv[3]);
	cm_writer_close(writer);
	return result <= 0;
}
