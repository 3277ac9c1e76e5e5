/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The CRC of configuration words as the simulated board's port computes it: by
 * arithmetic of polynomials, independent of bitstream_crc.c, so that each checks
 * the other.
 */
#ifndef CM_SIM_CRC_H
#define CM_SIM_CRC_H

#include <stddef.h>
#include <stdint.h>

/* The CRC after `count` native words written to register `reg` (0 to 31), when it was `crc` before. */
uint32_t cm_sim_crc(uint32_t crc, uint32_t reg, const uint32_t *words, size_t count);

/* After one word. */
uint32_t cm_sim_crc_word(uint32_t crc, uint32_t reg, uint32_t word);

#endif /* CM_SIM_CRC_H */
