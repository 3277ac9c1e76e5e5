// SPDX-License-Identifier: Apache-2.0
#include "bitstream_private.h"

#define POLYNOMIAL 0x82F63B78u /* CRC-32C, reflected */
#define ADDRESS_BITS 5
#define SLICES 4 /* words taken at once */

/* tables[j][k][b]: what byte k with value b, fed j + 1 words before the end, adds to the CRC. */
static uint32_t tables[SLICES][4][256];
/* What a register's address adds to the CRC of one word, and of SLICES words. */
static uint32_t address_of_one[1 << ADDRESS_BITS];
static uint32_t address_of_all[1 << ADDRESS_BITS];

static uint32_t shift(uint32_t crc, int bits)
{
	while (bits-- > 0)
		crc = crc >> 1 ^ (POLYNOMIAL & -(crc & 1));
	return crc;
}

static inline uint32_t look_up(int words, uint32_t value)
{
	return tables[words][0][value & 255] ^ tables[words][1][value >> 8 & 255] ^
	       tables[words][2][value >> 16 & 255] ^ tables[words][3][value >> 24];
}

/* `address`: an entry of address_of_one. */
static inline uint32_t crc_word(uint32_t crc, uint32_t address, uint32_t word)
{
	return look_up(0, crc ^ word) ^ address;
}

/* Runs once when the module is loaded, before any thread can call; the tables are constant from then on. */
__attribute__((constructor)) static void make_tables(void)
{
	for (int byte = 0; byte < 4; byte++) {
		for (uint32_t value = 0; value < 256; value++) {
			uint32_t crc = value << (8 * byte);

			for (int words = 0; words < SLICES; words++) {
				crc = shift(crc, 32 + ADDRESS_BITS);
				tables[words][byte][value] = crc;
			}
		}
	}
	for (uint32_t reg = 0; reg < 1 << ADDRESS_BITS; reg++) {
		address_of_one[reg] = shift(reg, ADDRESS_BITS);
		for (int words = 0; words < SLICES; words++)
			address_of_all[reg] = crc_word(address_of_all[reg], address_of_one[reg], 0);
	}
}

static inline uint32_t crc_run(uint32_t crc, uint32_t reg, const uint8_t *words, size_t count,
			       int swapped)
{
	const uint32_t one = address_of_one[reg];
	const uint32_t all = address_of_all[reg];

	for (; count >= SLICES; count -= SLICES, words += 4 * SLICES)
		crc = look_up(3, crc ^ load(words, swapped)) ^
		      look_up(2, load(words + 4, swapped)) ^ look_up(1, load(words + 8, swapped)) ^
		      look_up(0, load(words + 12, swapped)) ^ all;
	for (; count > 0; count--, words += 4)
		crc = crc_word(crc, one, load(words, swapped));
	return crc;
}

uint32_t cm_config_crc(uint32_t crc, uint32_t reg, const uint8_t *words, size_t count, int swapped)
{
	/* Two copies, so that the loop need not check the byte order. */
	reg &= (1u << ADDRESS_BITS) - 1;
	return swapped ? crc_run(crc, reg, words, count, 1) : crc_run(crc, reg, words, count, 0);
}

uint32_t cm_config_crc_word(uint32_t crc, uint32_t reg, uint32_t word)
{
	return crc_word(crc, address_of_one[reg], word);
}

void cm_config_swap(uint8_t *to, const uint8_t *from, size_t count)
{
	for (size_t i = 0; i < count; i++) {
		uint32_t word;

		memcpy(&word, from + 4 * i, sizeof(word));
		word = __builtin_bswap32(word);
		memcpy(to + 4 * i, &word, sizeof(word));
	}
}
