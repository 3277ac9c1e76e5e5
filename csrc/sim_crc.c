// SPDX-License-Identifier: Apache-2.0
#include "sim_crc.h"

/*
 * CRC-32C takes in 37 bits for each word, the word and then the five bits of the register's address, all least
 * significant first (UG470).  Bits are coefficients, that of x^0 on top: crc' = (crc + word) x^37 + reg x^5.
 */
#define POLYNOMIAL 0x82F63B78u
#define ONE 0x80000000u
#define LANES 4 /* parts of the data side by side: one alone waits for its tables */

static uint32_t table[4][256]; /* each byte of a value times x^37 */

static uint32_t shifted(uint32_t value, int bits)
{
	while (bits-- > 0)
		value = value >> 1 ^ (POLYNOMIAL & -(value & 1));
	return value;
}

__attribute__((constructor)) static void make_table(void)
{
	for (uint32_t value = 0; value < 256; value++)
		for (int byte = 0; byte < 4; byte++)
			table[byte][value] = shifted(value << 8 * byte, 37);
}

static uint32_t times(uint32_t one, uint32_t other)
{
	uint32_t product = 0;

	for (; one; one <<= 1, other = shifted(other, 1))
		product ^= other & -(one >> 31);
	return product;
}

/* x^37 as often as there are words. */
static uint32_t past(size_t words)
{
	uint32_t power = ONE;

	for (uint32_t square = shifted(ONE, 37); words; words >>= 1, square = times(square, square))
		power = words & 1 ? times(power, square) : power;
	return power;
}

static inline uint32_t take(uint32_t value)
{
	return table[0][value & 255] ^ table[1][value >> 8 & 255] ^ table[2][value >> 16 & 255] ^
	       table[3][value >> 24];
}

uint32_t cm_sim_crc_word(uint32_t crc, uint32_t reg, uint32_t word)
{
	return take(crc ^ word) ^ shifted(reg, 5);
}

uint32_t cm_sim_crc(uint32_t crc, uint32_t reg, const uint32_t *words, size_t count)
{
	size_t part = count / LANES;
	uint32_t lane[LANES] = { crc }, join = past(part);

	reg = shifted(reg, 5);
	for (size_t at = 0; at < part; at++)
#pragma GCC unroll 4
		for (size_t i = 0; i < LANES; i++)
			lane[i] = take(lane[i] ^ words[i * part + at]) ^ reg;
	crc = lane[0];
	for (int i = 1; i < LANES; i++)
		crc = times(crc, join) ^ lane[i];
	for (size_t at = LANES * part; at < count; at++)
		crc = take(crc ^ words[at]) ^ reg;
	return crc;
}
