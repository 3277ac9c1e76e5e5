// SPDX-License-Identifier: Apache-2.0
/*
 * Reads frames of a stream where the hardware put them: reader RUNTIME STREAM COUNT [LEASE]
 *
 *	cc -o reader reader.c $(pkg-config --cflags --libs cm-plane)
 */
#include <cm_plane.h>
#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void describe(const struct cm_reader *reader)
{
	const struct cm_plane_geometry *geometry = cm_reader_geometry(reader);

	for (uint32_t i = 0; i < geometry->dimensions; i++)
		printf("%s%" PRIu32, i ? "x" : "", geometry->shape[i]);
	printf(" %s", geometry->dtype);
}

static double mean(const struct cm_frame *frame)
{
	const uint8_t *bytes = frame->data;
	double sum = 0;

	for (size_t i = 0; i < frame->length; i++)
		sum += bytes[i];
	return sum / (double)frame->length;
}

static int read_frames(struct cm_reader *reader, int count)
{
	struct cm_frame frame;

	while (count-- > 0) {
		int got = cm_reader_next(reader, 5000, &frame);

		if (got <= 0) {
			fprintf(stderr, "reader: %s\n",
				got == 0	   ? "nothing came within 5 s"
				: errno == EACCES ? cm_reader_error(reader)
						   : strerror(errno));
			return 1;
		}
		printf("frame %" PRIu64 ", generation %" PRIu64 ", of %s: ", frame.sequence,
		       cm_reader_generation(reader), cm_reader_mode(reader));
		describe(reader);
		printf(", %zu bytes, mean %.1f\n", frame.length, mean(&frame));
		cm_reader_release(reader, &frame);
	}
	printf("%" PRIu64 " lost\n", cm_reader_lost(reader));
	return 0;
}

int main(int argc, char **argv)
{
	struct cm_reader *reader;
	int status;

	if (argc != 4 && argc != 5) {
		fprintf(stderr, "usage: reader RUNTIME STREAM COUNT [LEASE]\n");
		return 2;
	}
	reader = cm_reader_open_leased(argv[1], argv[2], 0, argc == 5 ? argv[4] : NULL);
	if (!reader) {
		fprintf(stderr, "reader: %s: %s\n", argv[1], strerror(errno));
		return 1;
	}
	status = read_frames(reader, atoi(argv[3]));
	cm_reader_close(reader);
	return status;
}
