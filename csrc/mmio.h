/* SPDX-License-Identifier: Apache-2.0 */
/*
 * One volatile access of 8 to 64 bits to mapped device memory, ordered as the
 * kernel's readl() and writel() are: what the processor wrote to memory before
 * a register write is visible to the device that the write starts; what it
 * reads from memory after a register read is not older than that read.
 *
 * 64 bits are one bus access on 64-bit processors and two of 32 bits, the lower
 * half first, on 32-bit ones, whose AXI port has no 64-bit single access.
 */
#ifndef CM_SHIM_MMIO_H
#define CM_SHIM_MMIO_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

static inline void cm_mmio_before_write(void)
{
#if defined(__aarch64__)
	__asm__ volatile("dmb oshst" ::: "memory");
#elif defined(__arm__) && __ARM_ARCH >= 7
	__asm__ volatile("dsb st" ::: "memory");
#elif defined(__x86_64__) || defined(__i386__)
	__asm__ volatile("" ::: "memory"); /* uncached accesses keep their order */
#else
	__atomic_thread_fence(__ATOMIC_SEQ_CST);
#endif
}

static inline void cm_mmio_after_read(void)
{
#if defined(__aarch64__)
	__asm__ volatile("dmb oshld" ::: "memory");
#elif defined(__arm__) && __ARM_ARCH >= 7
	__asm__ volatile("dmb" ::: "memory");
#elif defined(__x86_64__) || defined(__i386__)
	__asm__ volatile("" ::: "memory"); /* uncached accesses keep their order */
#else
	__atomic_thread_fence(__ATOMIC_SEQ_CST);
#endif
}

static inline uint64_t cm_mmio_read64(const volatile void *at)
{
#if UINTPTR_MAX > UINT32_MAX
	return *(const volatile uint64_t *)at;
#else
	const volatile uint32_t *half = at;
	uint64_t low = half[0];

	return low | (uint64_t)half[1] << 32;
#endif
}

static inline void cm_mmio_write64(volatile void *at, uint64_t value)
{
#if UINTPTR_MAX > UINT32_MAX
	*(volatile uint64_t *)at = value;
#else
	volatile uint32_t *half = at;

	half[0] = (uint32_t)value;
	half[1] = (uint32_t)(value >> 32);
#endif
}

/* @width is 8, 16, 32 or 64; the caller has checked it and the alignment. */
static inline uint64_t cm_mmio_read(const volatile void *at, unsigned int width)
{
	uint64_t value;

	if (width == 8)
		value = *(const volatile uint8_t *)at;
	else if (width == 16)
		value = *(const volatile uint16_t *)at;
	else if (width == 32)
		value = *(const volatile uint32_t *)at;
	else
		value = cm_mmio_read64(at);
	cm_mmio_after_read();
	return value;
}

static inline void cm_mmio_write(volatile void *at, unsigned int width, uint64_t value)
{
	cm_mmio_before_write();
	if (width == 8)
		*(volatile uint8_t *)at = (uint8_t)value;
	else if (width == 16)
		*(volatile uint16_t *)at = (uint16_t)value;
	else if (width == 32)
		*(volatile uint32_t *)at = (uint32_t)value;
	else
		cm_mmio_write64(at, value);
}

/*
 * Words one after the other, each one access of 32 bits; @length is in bytes, a
 * multiple of 4, and so is the alignment of the device's side.  Accesses to
 * device memory keep their order among each other, so that one barrier does
 * for all.
 */
static inline void cm_mmio_read_block(const volatile void *from, void *data, size_t length)
{
	const volatile uint32_t *word = from;
	unsigned char *to = data;
	size_t i;

	for (i = 0; i < length; i += 4) {
		uint32_t value = *word++;

		memcpy(to + i, &value, sizeof(value));
	}
	cm_mmio_after_read();
}

static inline void cm_mmio_write_block(volatile void *to, const void *data, size_t length)
{
	const unsigned char *from = data;
	volatile uint32_t *word = to;
	size_t i;

	cm_mmio_before_write();
	for (i = 0; i < length; i += 4) {
		uint32_t value;

		memcpy(&value, from + i, sizeof(value));
		*word++ = value;
	}
}

#endif /* CM_SHIM_MMIO_H */
