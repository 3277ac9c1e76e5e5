// SPDX-License-Identifier: Apache-2.0
/* Blocks of a window: on a mapped device, on a node that takes them, and on one that does not. */
#include <stdint.h>
#include <sys/mman.h>
#include <unistd.h>

#include "cm_node.h"
#include "fake_node.h"
#include "mirror.h"
#include "test.h"
#include "uio.h"

#define BYTES ((size_t)FAKE_NODE_WORDS * 4)

struct scene {
	char *root;
	struct fake_node *fake; /* NULL: /dev/zero, which is a mapped device with memory */
	struct cm_uio *uio;
};

static void make_sysfs(const char *root)
{
	char size[32];

	snprintf(size, sizeof(size), "%#zx\n", BYTES);
	fake_file(root, "sys/class/uio/uio0/name", "a\n");
	fake_file(root, "sys/class/uio/uio0/maps/map0/addr", "0x1000\n");
	fake_file(root, "sys/class/uio/uio0/maps/map0/size", size);
}

static struct scene scene_of_node(enum misdeed misdeed)
{
	struct scene scene = { .root = fake_root_make() };

	make_sysfs(scene.root);
	scene.fake = fake_node_start(scene.root, "dev/uio0", misdeed);
	scene.uio = cm_uio_open(scene.root, 0);
	CHECK(scene.uio);
	return scene;
}

static struct scene scene_of_device(void)
{
	struct scene scene = { .root = fake_root_make() };
	char path[256];

	make_sysfs(scene.root);
	fake_file(scene.root, "dev/there", "");
	snprintf(path, sizeof(path), "%s/dev/uio0", scene.root);
	CHECK(!symlink("/dev/zero", path));
	scene.uio = cm_uio_open(scene.root, 0);
	CHECK(scene.uio);
	return scene;
}

static void scene_end(struct scene *scene)
{
	cm_uio_close(scene->uio);
	if (scene->fake)
		fake_node_stop(scene->fake);
	fake_root_remove(scene->root);
}

static unsigned char *pattern(size_t length)
{
	unsigned char *data = malloc(length + 1);
	size_t i;

	CHECK(data);
	for (i = 0; i < length; i++)
		data[i + 1] = (unsigned char)(i * 7 + i / 251);
	return data; /* from data + 1 on, which no word is aligned to */
}

/* What is written as a block is there, word by word and as a block, and nothing else has changed. */
static void check_holds(struct cm_uio *uio)
{
	unsigned char *wrote = pattern(BYTES), *got = pattern(BYTES);
	uint64_t value;
	uint32_t word;

	CHECK(!cm_uio_write_block(uio, 0, 0, wrote + 1, BYTES));
	memset(got + 1, 0, BYTES);
	CHECK(!cm_uio_read_block(uio, 0, 0, got + 1, BYTES) && !memcmp(got + 1, wrote + 1, BYTES));
	memcpy(&word, wrote + 1 + 0x20, 4);
	CHECK(!cm_uio_read(uio, 0, 0x20, 32, &value) && value == word);
	memset(got + 1, 0, 8);
	CHECK(!cm_uio_write_block(uio, 0, BYTES - 8, got + 1, 4));
	CHECK(!cm_uio_read_block(uio, 0, BYTES - 12, got + 1, 12));
	CHECK(!memcmp(got + 1, wrote + 1 + BYTES - 12, 4));
	CHECK(!memcmp(got + 5, "\0\0\0\0", 4));
	CHECK(!memcmp(got + 9, wrote + 1 + BYTES - 4, 4));
	free(wrote);
	free(got);
}

static void a_mapped_device_holds_a_block(void)
{
	struct scene scene = scene_of_device();

	check_holds(scene.uio);
	scene_end(&scene);
}

static void a_node_gets_as_few_messages_as_a_block_needs(void)
{
	struct scene scene = scene_of_node(OFFER_BLOCKS);
	unsigned int needed = (BYTES + CM_NODE_BLOCK_MAX - 1) / CM_NODE_BLOCK_MAX;
	unsigned char *data = pattern(BYTES);

	CHECK(!cm_uio_write_block(scene.uio, 0, 0, data + 1, BYTES));
	CHECK(fake_node_requests(scene.fake) == needed);
	CHECK(!cm_uio_read_block(scene.uio, 0, 0, data + 1, BYTES));
	CHECK(fake_node_requests(scene.fake) == 2 * needed);
	free(data);
	check_holds(scene.uio);
	scene_end(&scene);
}

static void a_node_without_blocks_is_asked_word_by_word(void)
{
	struct scene scene = scene_of_node(WELL_BEHAVED);
	uint32_t words[3] = { 1, 2, 3 }, got[3];

	CHECK(!cm_uio_write_block(scene.uio, 0, 0x10, words, sizeof(words)));
	CHECK(!cm_uio_read_block(scene.uio, 0, 0x10, got, sizeof(got)));
	CHECK(!memcmp(words, got, sizeof(got)) && fake_node_requests(scene.fake) == 6);
	scene_end(&scene);
}

static void check_refused(struct cm_uio *uio)
{
	unsigned char data[8] = { 0 };

	CHECK_ERRNO(cm_uio_read_block(uio, 1, 0, data, 8), EINVAL);
	CHECK_ERRNO(cm_uio_read_block(uio, 0, 2, data, 8), EINVAL);
	CHECK_ERRNO(cm_uio_read_block(uio, 0, 0, data, 6), EINVAL);
	CHECK_ERRNO(cm_uio_read_block(uio, 0, BYTES - 4, data, 8), EINVAL);
	CHECK_ERRNO(cm_uio_read_block(uio, 0, BYTES, data, 4), EINVAL);
	CHECK_ERRNO(cm_uio_read_block(uio, 0, UINT64_MAX - 3, data, 8), EINVAL);
	CHECK_ERRNO(cm_uio_write_block(uio, 0, 0, data, BYTES + 4), EINVAL);
	CHECK_ERRNO(cm_uio_write_block(uio, 0, 4, data, SIZE_MAX - 3), EINVAL);
	CHECK(!cm_uio_read_block(uio, 0, BYTES, data, 0)); /* nothing is there to be read */
}

static void a_block_that_does_not_fit_reaches_no_bus(void)
{
	struct scene scene = scene_of_node(OFFER_BLOCKS), device = scene_of_device();

	check_refused(scene.uio);
	CHECK(fake_node_requests(scene.fake) == 0);
	check_refused(device.uio);
	scene_end(&scene);
	scene_end(&device);
}

static void what_the_node_says_is_the_error(void)
{
	static const struct {
		enum misdeed misdeed;
		int error;
	} cases[] = {
		{ OFFER_BLOCKS_AND_REFUSE, EIO },
		{ OFFER_BLOCKS_AND_CUT_SHORT, EPROTO },
		{ REFUSE, EIO },
		{ HANG_UP, ENODEV },
	};
	size_t i;

	for (i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		struct scene scene = scene_of_node(cases[i].misdeed);
		uint32_t word = 0;

		CHECK_ERRNO(cm_uio_read_block(scene.uio, 0, 0, &word, 4), cases[i].error);
		if (cases[i].error == EPROTO) /* the two ends do not agree any more */
			CHECK_ERRNO(cm_uio_write_block(scene.uio, 0, 0, &word, 4), EPROTO);
		else if (cases[i].error == EIO)
			CHECK_ERRNO(cm_uio_write_block(scene.uio, 0, 0, &word, 4), EIO);
		scene_end(&scene);
	}
}

static void a_late_answer_is_not_taken_for_the_next(void)
{
	struct scene scene = scene_of_node(OFFER_BLOCKS_AND_ANSWER_LATE);
	uint32_t words[2] = { 1, 2 }, got[2] = { 0 };

	CHECK_ERRNO(cm_uio_read_block(scene.uio, 0, 0, got, 8), ETIMEDOUT);
	CHECK_ERRNO(cm_uio_write_block(scene.uio, 0, 0, words, 8), ETIMEDOUT); /* at once */
	fake_node_speak(scene.fake);
	while (cm_uio_write_block(scene.uio, 0, 0, words, 8)) {
		CHECK(errno == ETIMEDOUT);
		usleep(1000);
	}
	CHECK(!cm_uio_read_block(scene.uio, 0, 4, got, 4) && got[0] == 2);
	CHECK(fake_node_requests(scene.fake) == 3);
	scene_end(&scene);
}

static void a_closed_device_has_no_blocks(void)
{
	struct scene scene = scene_of_device(), node = scene_of_node(OFFER_BLOCKS);
	uint32_t word = 0;

	cm_uio_release(scene.uio);
	CHECK_ERRNO(cm_uio_read_block(scene.uio, 0, 0, &word, 4), EBADF);
	CHECK_ERRNO(cm_uio_write_block(scene.uio, 0, 0, &word, 4), EBADF);
	cm_uio_release(node.uio);
	CHECK_ERRNO(cm_uio_read_block(node.uio, 0, 0, &word, 4), EBADF);
	CHECK_ERRNO(cm_uio_write_block(node.uio, 0, 0, &word, 4), EBADF);
	scene_end(&scene);
	scene_end(&node);
}

static void a_mirror_tells_a_block_unless_a_word_has_a_flag(void)
{
	int fd = memfd_create("mirror", MFD_CLOEXEC);
	unsigned char data[8] = "abcdefgh", flag = 1, none = 0, got[8];
	struct cm_mirror mirror = { 0 };

	CHECK(fd >= 0 && !ftruncate(fd, 2 * 4096) && pwrite(fd, data, 8, 4088) == 8);
	CHECK(!cm_mirror_map(&mirror, fd, 4096));
	CHECK(cm_mirror_read_block(&mirror, 4088, got, 8) && !memcmp(got, data, 8));
	CHECK(pwrite(fd, &flag, 1, 4096 + 4095) == 1);
	CHECK(!cm_mirror_read_block(&mirror, 4088, got, 8));
	CHECK(cm_mirror_read_block(&mirror, 4088, got, 4)); /* the flag is behind it */
	CHECK(pwrite(fd, &none, 1, 4096 + 4095) == 1);
	CHECK(cm_mirror_read_block(&mirror, 4088, got, 8));
	CHECK(!cm_mirror_read_block(&mirror, 4092, got, 8)); /* behind its end */
	cm_mirror_unmap(&mirror);
	close(fd);
}

int main(void)
{
	RUN(a_mapped_device_holds_a_block);
	RUN(a_node_gets_as_few_messages_as_a_block_needs);
	RUN(a_node_without_blocks_is_asked_word_by_word);
	RUN(a_block_that_does_not_fit_reaches_no_bus);
	RUN(what_the_node_says_is_the_error);
	RUN(a_mirror_tells_a_block_unless_a_word_has_a_flag);
	RUN(a_late_answer_is_not_taken_for_the_next);
	RUN(a_closed_device_has_no_blocks);
	return 0;
}
