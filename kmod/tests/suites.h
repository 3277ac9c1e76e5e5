/* SPDX-License-Identifier: GPL-2.0-only */
/* The KUnit suites of the module's files. */
#ifndef _CM_TESTS_SUITES_H
#define _CM_TESTS_SUITES_H

#include <kunit/test.h>

extern struct kunit_suite cm_request_suite;
extern struct kunit_suite cm_address_suite;
extern struct kunit_suite cm_axidma_frame_suite;
extern struct kunit_suite cm_axidma_video_suite;
extern struct kunit_suite cm_engine_suite;
extern struct kunit_suite cm_stop_suite;
extern struct kunit_suite cm_polled_suite;
extern struct kunit_suite cm_axi_intc_suite;

#endif /* _CM_TESTS_SUITES_H */
