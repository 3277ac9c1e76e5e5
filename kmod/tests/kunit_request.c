// SPDX-License-Identifier: GPL-2.0-only
/* KUnit suites of requests and addresses: what a channel is asked, and where. */
#include "cm_compat.h"
#include "suites.h"

/* cm_dma has it, and may be loaded */
#undef EXPORT_SYMBOL_CM
#define EXPORT_SYMBOL_CM(symbol)

#include "../core/request.c"
#include "../core/address.c"

#define MOST 4096

static struct cm_dma_info channel(u32 type)
{
	return (struct cm_dma_info){
		.type = type,
		.caps = CM_DMA_CAP_CYCLIC | CM_DMA_CAP_VIDEO,
		.alignment = 8,
		.max_length = MOST,
	};
}

static int check(const struct cm_request *request)
{
	struct cm_dma_info info = channel(CM_DMA_TYPE_AXIDMA);

	return cm_request_check(&info, request);
}

static void request_is_one_descriptor(struct kunit *test)
{
	struct cm_request request = { .offset = 8, .length = MOST };

	KUNIT_EXPECT_EQ(test, check(&request), 0);
	request.length = MOST + 8;
	KUNIT_EXPECT_EQ(test, check(&request), -EMSGSIZE);
	request.length = U64_MAX & ~7ULL;
	KUNIT_EXPECT_EQ(test, check(&request), -EMSGSIZE);
}

static void request_keeps_the_alignment(struct kunit *test)
{
	struct cm_request request = { .offset = 4, .length = 64 };

	KUNIT_EXPECT_EQ(test, check(&request), -EINVAL);
	request.offset = 8;
	request.length = 60;
	KUNIT_EXPECT_EQ(test, check(&request), -EINVAL);
}

static void request_has_a_period_only_where_it_is_cyclic(struct kunit *test)
{
	struct cm_request request = { .length = 64, .period = 64 };

	KUNIT_EXPECT_EQ(test, check(&request), -EINVAL);
	request.cyclic = true;
	KUNIT_EXPECT_EQ(test, check(&request), 0);
	request.period = 0;
	KUNIT_EXPECT_EQ(test, check(&request), -EINVAL);
}

static void cyclic_request_is_whole_periods(struct kunit *test)
{
	/* longer than one descriptor: each period is one */
	struct cm_request request = { .length = 4 * MOST, .period = MOST, .cyclic = true };
	struct cm_dma_info plain = channel(CM_DMA_TYPE_AXIDMA);

	KUNIT_EXPECT_EQ(test, check(&request), 0);
	request.length = 4 * MOST + 8;
	KUNIT_EXPECT_EQ(test, check(&request), -EINVAL);
	request.length = MOST / 2;
	KUNIT_EXPECT_EQ(test, check(&request), -EINVAL);
	request.length = 64;
	request.period = 4;
	KUNIT_EXPECT_EQ(test, check(&request), -EINVAL);
	request.length = 4 * MOST;
	request.period = 2 * MOST;
	KUNIT_EXPECT_EQ(test, check(&request), -EMSGSIZE);
	plain.caps = 0;
	KUNIT_EXPECT_EQ(test, cm_request_check(&plain, &request), -EOPNOTSUPP);
}

static void video_request_has_lines_in_a_stride(struct kunit *test)
{
	struct cm_request request = { .lines = 16, .line_bytes = 256, .stride = 1024 };
	struct cm_dma_info plain = channel(CM_DMA_TYPE_AXIDMA);

	KUNIT_EXPECT_EQ(test, check(&request), 0);
	request.stride = 248;
	KUNIT_EXPECT_EQ(test, check(&request), -EINVAL);
	request.stride = 1020;
	KUNIT_EXPECT_EQ(test, check(&request), -EINVAL);
	request.stride = 2 * MOST;
	request.line_bytes = 0;
	KUNIT_EXPECT_EQ(test, check(&request), -EINVAL);
	request.line_bytes = MOST + 8;
	KUNIT_EXPECT_EQ(test, check(&request), -EMSGSIZE);
	plain.caps = CM_DMA_CAP_CYCLIC;
	KUNIT_EXPECT_EQ(test, cm_request_check(&plain, &request), -EOPNOTSUPP);
}

static void video_request_fits_the_registers_of_a_vdma(struct kunit *test)
{
	struct cm_request request = { .lines = 8191, .line_bytes = 64, .stride = 65528 };
	struct cm_dma_info vdma = channel(CM_DMA_TYPE_VDMA);

	KUNIT_EXPECT_EQ(test, cm_request_check(&vdma, &request), 0);
	request.lines = 8192;
	KUNIT_EXPECT_EQ(test, cm_request_check(&vdma, &request), -EMSGSIZE);
	request.lines = 1;
	request.stride = 65536;
	KUNIT_EXPECT_EQ(test, cm_request_check(&vdma, &request), -EMSGSIZE);
	/* another engine may take it */
	KUNIT_EXPECT_EQ(test, check(&request), 0);
}

static void footprint_does_not_overflow(struct kunit *test)
{
	struct cm_request request = { .length = 100 };

	KUNIT_EXPECT_EQ(test, cm_request_footprint(&request), 100ULL);
	request.lines = 3;
	request.line_bytes = 10;
	request.stride = 64;
	KUNIT_EXPECT_EQ(test, cm_request_footprint(&request), 2 * 64 + 10ULL);
	request.lines = U32_MAX;
	request.line_bytes = U32_MAX;
	request.stride = U32_MAX;
	KUNIT_EXPECT_EQ(test, cm_request_footprint(&request), (u64)U32_MAX * U32_MAX);
}

static void all_periods_but_one_can_be_read(struct kunit *test)
{
	struct cm_request request = { .length = 64, .period = 16, .cyclic = true };

	KUNIT_EXPECT_EQ(test, cm_request_readable(&request), 3U);
	request.period = 64;
	KUNIT_EXPECT_EQ(test, cm_request_readable(&request), 1U);
	request.lines = 1;
	KUNIT_EXPECT_EQ(test, cm_request_readable(&request), U32_MAX);
	request.cyclic = false;
	KUNIT_EXPECT_EQ(test, cm_request_readable(&request), 1U);
	request.cyclic = true;
	request.lines = 0;
	request.period = 1;
	request.length = 1ULL << 40;
	KUNIT_EXPECT_EQ(test, cm_request_readable(&request), U32_MAX);
}

static void channel_name_can_be_a_file(struct kunit *test)
{
	KUNIT_EXPECT_TRUE(test, cm_channel_name_valid("to_pl-0.raw"));
	KUNIT_EXPECT_TRUE(test, cm_channel_name_valid("1234567890123456789012345678901"));
	KUNIT_EXPECT_FALSE(test, cm_channel_name_valid("12345678901234567890123456789012"));
	KUNIT_EXPECT_FALSE(test, cm_channel_name_valid(""));
	KUNIT_EXPECT_FALSE(test, cm_channel_name_valid(".."));
	KUNIT_EXPECT_FALSE(test, cm_channel_name_valid("a/b"));
	KUNIT_EXPECT_FALSE(test, cm_channel_name_valid("a!b"));
	KUNIT_EXPECT_FALSE(test, cm_channel_name_valid("a b"));
	KUNIT_EXPECT_FALSE(test, cm_channel_name_valid("\xc3\xa9"));
}

static struct kunit_case request_cases[] = {
	KUNIT_CASE(request_is_one_descriptor),
	KUNIT_CASE(request_keeps_the_alignment),
	KUNIT_CASE(request_has_a_period_only_where_it_is_cyclic),
	KUNIT_CASE(cyclic_request_is_whole_periods),
	KUNIT_CASE(video_request_has_lines_in_a_stride),
	KUNIT_CASE(video_request_fits_the_registers_of_a_vdma),
	KUNIT_CASE(footprint_does_not_overflow),
	KUNIT_CASE(all_periods_but_one_can_be_read),
	KUNIT_CASE(channel_name_can_be_a_file),
	{}
};

struct kunit_suite cm_request_suite = {
	.name = "cm_request",
	.test_cases = request_cases,
};

#define BASE 0x50000000

static void range_lies_in_the_buffer(struct kunit *test)
{
	struct cm_buffer buffer = { .kind = CM_BUFFER_PAGES, .length = 4096, .dma = BASE };
	dma_addr_t address = 0;

	KUNIT_EXPECT_EQ(test, cm_buffer_address(&buffer, 16, 4080, &address), 0);
	KUNIT_EXPECT_EQ(test, (u64)address, BASE + 16ULL);
	KUNIT_EXPECT_EQ(test, cm_buffer_address(&buffer, 16, 4081, &address), -EINVAL);
	KUNIT_EXPECT_EQ(test, cm_buffer_address(&buffer, 0, 0, &address), -EINVAL);
	KUNIT_EXPECT_EQ(test, cm_buffer_address(&buffer, 4096, 1, &address), -EINVAL);
	KUNIT_EXPECT_EQ(test, cm_buffer_address(&buffer, U64_MAX, 2, &address), -EINVAL);
	KUNIT_EXPECT_EQ(test, cm_buffer_address(&buffer, 8, U64_MAX, &address), -EINVAL);
}

/* three pieces of a page: the second goes on where the first ends, the third does not */
static struct cm_buffer *imported(struct kunit *test)
{
	static const dma_addr_t starts[] = { BASE, BASE + 4096, BASE + 65536 };
	struct cm_buffer *buffer = kunit_kzalloc(test, sizeof(*buffer), GFP_KERNEL);
	struct sg_table *table = kunit_kzalloc(test, sizeof(*table), GFP_KERNEL);
	struct scatterlist *list = kunit_kcalloc(test, 3, sizeof(*list), GFP_KERNEL);
	int i;

	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, buffer);
	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, table);
	KUNIT_ASSERT_NOT_ERR_OR_NULL(test, list);
	sg_init_table(list, 3);
	for (i = 0; i < 3; i++) {
		sg_dma_address(&list[i]) = starts[i];
		sg_dma_len(&list[i]) = 4096;
	}
	table->sgl = list;
	table->nents = 3;
	table->orig_nents = 3;
	buffer->kind = CM_BUFFER_IMPORTED;
	buffer->length = 3 * 4096;
	buffer->table = table;
	return buffer;
}

static void imported_range_may_go_over_adjoining_pieces(struct kunit *test)
{
	struct cm_buffer *buffer = imported(test);
	dma_addr_t address = 0;

	KUNIT_EXPECT_EQ(test, cm_buffer_address(buffer, 0, 8192, &address), 0);
	KUNIT_EXPECT_EQ(test, (u64)address, (u64)BASE);
	KUNIT_EXPECT_EQ(test, cm_buffer_address(buffer, 4000, 4000, &address), 0);
	KUNIT_EXPECT_EQ(test, (u64)address, BASE + 4000ULL);
	KUNIT_EXPECT_EQ(test, cm_buffer_address(buffer, 4096, 1, &address), 0);
	KUNIT_EXPECT_EQ(test, (u64)address, BASE + 4096ULL);
	KUNIT_EXPECT_EQ(test, cm_buffer_address(buffer, 8192 + 16, 4080, &address), 0);
	KUNIT_EXPECT_EQ(test, (u64)address, BASE + 65536 + 16ULL);
}

static void imported_range_with_a_gap_is_refused(struct kunit *test)
{
	struct cm_buffer *buffer = imported(test);
	dma_addr_t address;

	KUNIT_EXPECT_EQ(test, cm_buffer_address(buffer, 0, 8193, &address), -EINVAL);
	KUNIT_EXPECT_EQ(test, cm_buffer_address(buffer, 8191, 2, &address), -EINVAL);
	/* an exporter that mapped less than it said */
	buffer->length = 4 * 4096;
	KUNIT_EXPECT_EQ(test, cm_buffer_address(buffer, 3 * 4096, 1, &address), -EINVAL);
	KUNIT_EXPECT_EQ(test, cm_buffer_address(buffer, 8192, 8192, &address), -EINVAL);
}

static struct kunit_case address_cases[] = {
	KUNIT_CASE(range_lies_in_the_buffer),
	KUNIT_CASE(imported_range_may_go_over_adjoining_pieces),
	KUNIT_CASE(imported_range_with_a_gap_is_refused),
	{}
};

struct kunit_suite cm_address_suite = {
	.name = "cm_address",
	.test_cases = address_cases,
};
