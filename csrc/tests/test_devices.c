// SPDX-License-Identifier: Apache-2.0
/* The three devices over one fake node, and register access on plain memory. */
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include "axidma.h"
#include "fake_node.h"
#include "icap.h"
#include "mmio.h"
#include "test.h"
#include "uio.h"

#define S INT64_C(1000000000)

static void make_uio(const char *root, unsigned int number, const char *name, const char *address,
		     const char *size)
{
	char path[128];

	snprintf(path, sizeof(path), "sys/class/uio/uio%u/name", number);
	fake_file(root, path, name);
	snprintf(path, sizeof(path), "sys/class/uio/uio%u/maps/map0/addr", number);
	fake_file(root, path, address);
	snprintf(path, sizeof(path), "sys/class/uio/uio%u/maps/map0/size", number);
	fake_file(root, path, size);
}

static void a_uio_device_is_found_by_name_number_and_address(void)
{
	char *root = fake_root_make();
	struct cm_uio_info info;
	unsigned int numbers[1], map = 9;

	CHECK(cm_uio_list(root, numbers, 1) == 0);
	make_uio(root, 10, "b\n", "0x2000\n", "0x1000\n");
	make_uio(root, 2, "a\n", "0x1000\n", "0x1000\n");
	CHECK(cm_uio_list(root, numbers, 1) == 2);
	CHECK(!cm_uio_find_name(root, "b", &info) && info.number == 10);
	CHECK(!cm_uio_find_name(root, "uio2", &info) && !strcmp(info.name, "a"));
	CHECK(info.map_count == 1 && info.maps[0].address == 0x1000 && info.maps[0].offset == 0);
	CHECK(!cm_uio_find_address(root, 0x2ffc, 4, &info, &map) && info.number == 10 && map == 0);
	CHECK_ERRNO(cm_uio_find_address(root, 0x2ffc, 8, &info, &map), ENOENT);
	CHECK_ERRNO(cm_uio_find_address(root, UINT64_MAX, 2, &info, &map), ENOENT);
	CHECK_ERRNO(cm_uio_find_name(root, "uio3", &info), ENOENT);
	CHECK_ERRNO(cm_uio_find_name(root, "c", &info), ENOENT);
	fake_root_remove(root);
}

static void a_uio_device_is_found_whether_or_not_the_kernel_adds_the_address_to_its_name(void)
{
	char *root = fake_root_make();
	struct cm_uio_info info;

	make_uio(root, 0, "filter@43c00000\n", "0x43c00000\n", "0x1000\n"); /* Linux 6.12 */
	make_uio(root, 1, "mixer\n", "0x43c10000\n", "0x1000\n");	    /* Linux 6.1 */
	CHECK(!cm_uio_find_name(root, "filter", &info) && info.number == 0);
	CHECK(!cm_uio_find_name(root, "filter@43c00000", &info) && info.number == 0);
	CHECK(!cm_uio_find_name(root, "mixer@43c10000", &info) && info.number == 1);
	CHECK_ERRNO(cm_uio_find_name(root, "mixer@43c00000", &info), ENOENT);
	CHECK_ERRNO(cm_uio_find_name(root, "filter@43c10000", &info), ENOENT);
	CHECK_ERRNO(cm_uio_find_name(root, "filt", &info), ENOENT);
	CHECK_ERRNO(cm_uio_find_name(root, "mix@43c10000", &info), ENOENT);
	fake_root_remove(root);
}

static void a_malformed_attribute_is_einval(void)
{
	char *root = fake_root_make();
	struct cm_uio_info info;

	make_uio(root, 0, "a\n", "nonsense\n", "0x1000\n");
	CHECK_ERRNO(cm_uio_describe(root, 0, &info), EINVAL);
	fake_root_remove(root);
}

struct uio_scene {
	char *root;
	struct fake_node *fake;
	struct cm_uio *uio;
};

static struct uio_scene uio_make(enum misdeed misdeed)
{
	struct uio_scene scene = { .root = fake_root_make() };

	make_uio(scene.root, 0, "a\n", "0x1000\n", "0x40\n");
	scene.fake = fake_node_start(scene.root, "dev/uio0", misdeed);
	scene.uio = cm_uio_open_by_address(scene.root, 0x1004);
	CHECK(scene.uio);
	return scene;
}

static void uio_end(struct uio_scene *scene)
{
	cm_uio_close(scene->uio);
	fake_node_stop(scene->fake);
	fake_root_remove(scene->root);
}

static void a_register_holds_what_was_written(void)
{
	struct uio_scene scene = uio_make(WELL_BEHAVED);
	uint64_t value;

	CHECK(!cm_uio_write(scene.uio, 0, 0x3c, 32, 0x12345678));
	CHECK(!cm_uio_read(scene.uio, 0, 0x3c, 32, &value) && value == 0x12345678);
	uio_end(&scene);
}

static void an_access_that_does_not_fit_reaches_no_bus(void)
{
	struct uio_scene scene = uio_make(WELL_BEHAVED);
	uint64_t value;

	CHECK_ERRNO(cm_uio_read(scene.uio, 1, 0, 32, &value), EINVAL);
	CHECK_ERRNO(cm_uio_read(scene.uio, 0, 0x40, 32, &value), EINVAL);
	CHECK_ERRNO(cm_uio_read(scene.uio, 0, 0x3c, 64, &value), EINVAL);
	CHECK_ERRNO(cm_uio_read(scene.uio, 0, 2, 32, &value), EINVAL);
	CHECK_ERRNO(cm_uio_read(scene.uio, 0, 0, 24, &value), EINVAL);
	CHECK_ERRNO(cm_uio_read(scene.uio, 0, UINT64_MAX - 3, 32, &value), EINVAL);
	CHECK_ERRNO(cm_uio_write(scene.uio, 0, 0, 32, UINT64_C(1) << 32), ERANGE);
	CHECK_ERRNO(cm_uio_write(scene.uio, 0, 0, 8, 256), ERANGE);
	CHECK(fake_node_requests(scene.fake) == 0);
	uio_end(&scene);
}

static void an_interrupt_arrives_after_it_was_enabled(void)
{
	struct uio_scene scene = uio_make(WELL_BEHAVED);
	uint32_t count = 0;

	CHECK(cm_uio_take(scene.uio, &count) == 0);
	CHECK(!cm_uio_enable_interrupt(scene.uio));
	CHECK(cm_uio_wait(scene.uio, 5 * S, &count) == 1 && count == 1);
	CHECK(cm_uio_take(scene.uio, &count) == 0);
	CHECK_ERRNO(cm_uio_wait(scene.uio, 0, &count), ETIMEDOUT);
	uio_end(&scene);
}

static void interrupts_in_between_are_merged_into_the_newest_count(void)
{
	struct uio_scene scene = uio_make(MANY_INTERRUPTS);
	uint32_t count = 0;

	CHECK(!cm_uio_enable_interrupt(scene.uio));
	while (count < 40)
		CHECK(cm_uio_wait(scene.uio, 5 * S, &count) == 1);
	CHECK(count == 40 && cm_uio_take(scene.uio, &count) == 0);
	uio_end(&scene);
}

static void a_device_that_went_away_ends_the_wait_for_its_interrupt(void)
{
	struct uio_scene scene = uio_make(HANG_UP_EVENTS);
	uint32_t count;

	CHECK(!cm_uio_enable_interrupt(scene.uio));
	CHECK_ERRNO(cm_uio_wait(scene.uio, 5 * S, &count), ENODEV);
	uio_end(&scene);
}

static void accesses_of_every_width_touch_their_bytes_only(void)
{
	static const unsigned int widths[] = { 8, 16, 32, 64 };
	size_t i;

	for (i = 0; i < 4; i++) {
		uint64_t memory[2] = { ~UINT64_C(0), ~UINT64_C(0) };
		uint64_t ones = widths[i] == 64 ? ~UINT64_C(0) : (UINT64_C(1) << widths[i]) - 1;

		cm_mmio_write(memory, widths[i], 0);
		CHECK(memory[0] == ~ones && memory[1] == ~UINT64_C(0));
		cm_mmio_write(&memory[1], widths[i], 0x1122334455667788 & ones);
		CHECK(cm_mmio_read(&memory[1], widths[i]) == (0x1122334455667788 & ones));
	}
}

struct dma_scene {
	char *root;
	struct fake_node *fake;
	struct cm_dma *dma;
	struct cm_buffer buffer;
};

static struct dma_scene dma_make(enum misdeed misdeed)
{
	struct dma_scene scene = { .root = fake_root_make() };

	scene.fake = fake_node_start(scene.root, "dev/cm_dma/cam", misdeed);
	scene.dma = cm_dma_open(scene.root, "cam");
	CHECK(scene.dma && !cm_dma_alloc(scene.dma, 5000, &scene.buffer));
	return scene;
}

static void dma_end(struct dma_scene *scene)
{
	cm_buffer_close(&scene->buffer);
	cm_buffer_close(&scene->buffer);
	cm_dma_close(scene->dma);
	fake_node_stop(scene->fake);
	fake_root_remove(scene->root);
}

static void a_channel_describes_itself_with_a_name_that_ends(void)
{
	struct dma_scene scene = dma_make(WELL_BEHAVED);
	struct cm_dma_info info;

	CHECK(!cm_dma_get_info(scene.dma, &info) && info.direction == CM_DMA_S2MM);
	CHECK(strlen((const char *)info.name) == CM_DMA_NAME_MAX - 1);
	dma_end(&scene);
}

static void a_channel_name_with_a_slash_is_refused(void)
{
	CHECK_NULL_ERRNO(cm_dma_open("/", "../null"), EINVAL);
	CHECK_NULL_ERRNO(cm_dma_open("/", ""), EINVAL);
	CHECK_NULL_ERRNO(cm_dma_open("/", "a-name-that-is-longer-than-the-kernel-allows"), EINVAL);
	CHECK_NULL_ERRNO(cm_icap_open("/", "../null"), EINVAL);
}

static void a_buffer_is_memory_that_both_sides_see(void)
{
	struct dma_scene scene = dma_make(WELL_BEHAVED);
	char *ours = cm_buffer_map(&scene.buffer, true), theirs[6];

	CHECK(ours && scene.buffer.length == 8192 && scene.buffer.handle == 7);
	memcpy(ours, "hello", 6);
	CHECK(pread(scene.buffer.fd, theirs, 6, 0) == 6 && !strcmp(theirs, "hello"));
	scene.buffer.coherent = false;
	CHECK(!cm_buffer_sync(&scene.buffer, true, true)); /* a memfd: nothing to do */
	CHECK(!cm_buffer_sync(&scene.buffer, false, true));
	CHECK(!cm_buffer_unmap(ours, scene.buffer.length));
	dma_end(&scene);
}

static void a_buffer_shorter_than_it_says_is_not_mapped(void)
{
	struct dma_scene scene = dma_make(WELL_BEHAVED);

	CHECK(!ftruncate(scene.buffer.fd, 4096));
	CHECK_NULL_ERRNO(cm_buffer_map(&scene.buffer, true), EPROTO);
	dma_end(&scene);
}

static void an_imported_buffer_gets_a_descriptor_of_its_own(void)
{
	struct dma_scene scene = dma_make(WELL_BEHAVED);
	struct cm_buffer imported = { .fd = -1 };

	CHECK(!cm_dma_import(scene.dma, scene.buffer.fd, &imported));
	CHECK(imported.fd != scene.buffer.fd && imported.length == 8192 && imported.handle == 8);
	CHECK_ERRNO(cm_dma_import(scene.dma, -1, &imported), EBADF);
	cm_buffer_close(&imported);
	CHECK(!cm_dma_free(scene.dma, 8));
	dma_end(&scene);
}

static void completions_come_in_order_with_the_length_that_moved(void)
{
	struct dma_scene scene = dma_make(WELL_BEHAVED);
	struct cm_dma_completion done[4];
	uint64_t i;

	CHECK(cm_dma_take(scene.dma, done, 4) == 0);
	for (i = 0; i < 3; i++)
		CHECK(!cm_dma_submit(scene.dma, 7, 0, 100 + i * 2, i, 0, 0));
	/* the node sends a completion before its reply, so all are there */
	CHECK(cm_dma_wait(scene.dma, 0, &done[0]) == 1);
	CHECK(cm_dma_take(scene.dma, done + 1, 3) == 2);
	for (i = 0; i < 3; i++)
		CHECK(done[i].cookie == i && done[i].length == 50 + i && done[i].sequence == i);
	dma_end(&scene);
}

static void a_completion_of_another_size_is_eproto(void)
{
	static const enum misdeed cases[] = { SHORT_EVENT, LONG_EVENT };
	size_t i;

	for (i = 0; i < 2; i++) {
		struct dma_scene scene = dma_make(cases[i]);
		struct cm_dma_completion done[2];

		CHECK(!cm_dma_submit(scene.dma, 7, 0, 8, 0, 0, 0));
		CHECK_ERRNO(cm_dma_wait(scene.dma, 5 * S, &done[0]), EPROTO);
		dma_end(&scene);
	}
}

static void a_load_ends_with_an_event(void)
{
	char *root = fake_root_make();
	struct fake_node *fake = fake_node_start(root, "dev/cm_icap0", WELL_BEHAVED);
	struct cm_icap *icap = cm_icap_open(root, "cm_icap0");
	struct cm_icap_completion done;
	struct cm_icap_status status;

	CHECK(icap && cm_icap_take(icap, &done) == 0);
	CHECK(!cm_icap_load(icap, 1, 0, 16, 5, 0) && cm_icap_wait(icap, 5 * S, &done) == 1);
	CHECK(done.cookie == 5 && done.length == 16 && done.status == 0);
	CHECK(!cm_icap_load(icap, 1, 0, 8, 6, 0) && cm_icap_wait(icap, 5 * S, &done) == 1);
	CHECK(done.cookie == 6 && done.status == -EILSEQ && done.errors == CM_ICAP_ERR_CRC);
	CHECK(!cm_icap_get_status(icap, &status) && status.loads == 3);
	cm_icap_close(icap);
	fake_node_stop(fake);
	fake_root_remove(root);
}

static void a_read_names_its_parts_and_ends_with_an_event(void)
{
	struct cm_icap_parts parts = { 0, 64, 64, 808, 872, 32 };
	char *root = fake_root_make();
	struct fake_node *fake = fake_node_start(root, "dev/cm_icap0", WELL_BEHAVED);
	struct cm_icap *icap = cm_icap_open(root, "cm_icap0");
	struct cm_icap_completion done;

	CHECK(icap && !cm_icap_read_back(icap, 1, &parts, 9));
	CHECK(cm_icap_wait(icap, 5 * S, &done) == 1);
	CHECK(done.cookie == 9 && done.length == 808 && done.status == 0);
	cm_icap_close(icap);
	fake_node_stop(fake);
	fake_root_remove(root);
}

int main(void)
{
	RUN(a_uio_device_is_found_by_name_number_and_address);
	RUN(a_uio_device_is_found_whether_or_not_the_kernel_adds_the_address_to_its_name);
	RUN(a_malformed_attribute_is_einval);
	RUN(a_register_holds_what_was_written);
	RUN(an_access_that_does_not_fit_reaches_no_bus);
	RUN(an_interrupt_arrives_after_it_was_enabled);
	RUN(interrupts_in_between_are_merged_into_the_newest_count);
	RUN(a_device_that_went_away_ends_the_wait_for_its_interrupt);
	RUN(accesses_of_every_width_touch_their_bytes_only);
	RUN(a_channel_describes_itself_with_a_name_that_ends);
	RUN(a_channel_name_with_a_slash_is_refused);
	RUN(a_buffer_is_memory_that_both_sides_see);
	RUN(a_buffer_shorter_than_it_says_is_not_mapped);
	RUN(an_imported_buffer_gets_a_descriptor_of_its_own);
	RUN(completions_come_in_order_with_the_length_that_moved);
	RUN(a_completion_of_another_size_is_eproto);
	RUN(a_load_ends_with_an_event);
	RUN(a_read_names_its_parts_and_ends_with_an_event);
	return 0;
}
