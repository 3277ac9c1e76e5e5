/* SPDX-License-Identifier: Apache-2.0 */
uint32_t cm_sim_crc(uint32_t crc, uint32_t reg, const uint32_t *words, size_t count);
uint32_t cm_sim_crc_word(uint32_t crc, uint32_t reg, uint32_t word);
