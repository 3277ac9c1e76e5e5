/* SPDX-License-Identifier: GPL-2.0-only */
/*
 * What runs at EL2 in place of the kernel's stub: the two calls of the ZynqMP
 * platform firmware that cm_icap makes (drivers/firmware/xilinx/zynqmp.c and
 * xlnx-zynqmp.h: PM_SIP_SVC, PM_MMIO_WRITE, PM_MMIO_READ), to one register,
 * CSU's PCAP_CTRL, and the stub's own HVC_SET_VECTORS.  It is copied to a page
 * of its own, with struct axi_firmware behind it, and uses no stack.
 */
#include <linux/linkage.h>

	.text
	.align	11
SYM_DATA_START(axi_vectors)
	.rept	8		/* from EL2 itself: nothing takes any */
	b	.
	.align	7
	.endr
	b	call		/* synchronous, from EL1 */
	.align	7
	.rept	7
	b	.
	.align	7
	.endr

call:
	cbz	x0, set_vectors
	adr	x9, axi_vectors_end
	ldp	w10, w11, [x9]	/* granted, pcap_ctrl */
	mov	w12, #0x13
	movk	w12, #0xc200, lsl #16
	mov	w13, #0x3008
	movk	w13, #0xffca, lsl #16
	subs	w12, w0, w12	/* 0: PM_MMIO_WRITE, 1: PM_MMIO_READ */
	b.lo	unknown
	cmp	w12, #1
	b.hi	unknown
	cbz	w10, refused
	cmp	w1, w13
	b.ne	refused
	cbz	w12, write
	lsl	x0, x11, #32	/* status 0, the value above it */
	eret
write:
	lsr	x14, x1, #32	/* mask */
	bic	w11, w11, w14
	and	w2, w2, w14
	orr	w11, w11, w2
	str	w11, [x9, #4]
	ldr	w10, [x9, #8]
	add	w10, w10, #1
	str	w10, [x9, #8]	/* writes */
	mov	x0, #0
	eret
refused:
	ldr	w10, [x9, #12]
	add	w10, w10, #1
	str	w10, [x9, #12]	/* refusals */
	mov	x0, #2002	/* XST_PM_NO_ACCESS */
	eret
unknown:
	mov	x0, #-1		/* SMCCC_RET_NOT_SUPPORTED */
	eret
set_vectors:
	msr	vbar_el2, x1
	mov	x0, #0
	eret
	.align	3
SYM_DATA_END_LABEL(axi_vectors, SYM_L_GLOBAL, axi_vectors_end)
