// SPDX-License-Identifier: Apache-2.0
/*
 * Writes and reads a register of a module, mapped: registers RUNTIME MODULE REGISTER VALUE COUNT
 *
 *	cc -o registers registers.c $(pkg-config --cflags --libs cm-plane)
 */
#include <cm_registers.h>
#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double now(void)
{
	struct timespec time;

	clock_gettime(CLOCK_MONOTONIC, &time);
	return (double)time.tv_sec * 1e9 + (double)time.tv_nsec;
}

static int fail(struct cm_registers *registers, const char *what)
{
	if (errno == EACCES && *cm_registers_error(registers))
		fprintf(stderr, "registers: %s: %s\n", what, cm_registers_error(registers));
	else if (errno == ESTALE)
		fprintf(stderr, "registers: %s: taken back, the board goes to %s\n", what,
			cm_registers_mode(registers));
	else
		fprintf(stderr, "registers: %s: %s\n", what, strerror(errno));
	return 1;
}

static int use(struct cm_registers *registers, char **argv)
{
	long count = atol(argv[5]);
	struct cm_register which;
	uint64_t value = 0;
	double began;
	int result = cm_registers_wait(registers, 5000);

	if (result == 0)
		errno = ETIMEDOUT;
	if (result <= 0)
		return fail(registers, argv[2]);
	if (cm_registers_find(registers, argv[3], &which))
		return fail(registers, argv[3]);
	if (cm_register_write(registers, &which, strtoull(argv[4], NULL, 0)))
		return fail(registers, argv[3]);
	began = now();
	for (long i = 0; i < count; i++)
		if (cm_register_read(registers, &which, &value))
			return fail(registers, argv[3]);
	printf("%s of %s is %" PRIu64 ", %.1f ns a read\n", argv[3], cm_registers_module(registers),
	       value, (now() - began) / (double)(count ? count : 1));
	return 0;
}

int main(int argc, char **argv)
{
	struct cm_registers *registers;
	int status;

	if (argc != 6) {
		fprintf(stderr, "usage: registers RUNTIME MODULE REGISTER VALUE COUNT\n");
		return 2;
	}
	registers = cm_registers_open(argv[1], argv[2], CM_REGISTERS_WRITE, NULL);
	if (!registers) {
		fprintf(stderr, "registers: %s: %s\n", argv[1], strerror(errno));
		return 1;
	}
	status = use(registers, argv);
	cm_registers_close(registers);
	return status;
}
