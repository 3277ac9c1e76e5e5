// SPDX-License-Identifier: Apache-2.0
/* Attributes, plain and simulated, and folders that are made by message. */
#include <sys/stat.h>
#include <unistd.h>

#include "attr.h"
#include "cm_node.h"
#include "fake_node.h"
#include "test.h"

#define FOLDER "sys/kernel/config/device-tree/overlays"

static void a_plain_attribute_is_read_and_written_without_truncating(void)
{
	char *root = fake_root_make(), text[8];

	fake_file(root, "sys/a", "abcdef");
	CHECK(!cm_attr_write(root, "sys/a", "XY", 2));
	CHECK(cm_attr_read(root, "sys/a", text, sizeof(text)) == 6 && !memcmp(text, "XYcdef", 6));
	CHECK(cm_attr_read(root, "sys/a", text, 6) == 6);
	CHECK_ERRNO(cm_attr_read(root, "sys/a", text, 5), EMSGSIZE);
	CHECK_ERRNO(cm_attr_read(root, "sys/b", text, 5), ENOENT);
	CHECK_ERRNO(cm_attr_write(root, "sys/b", text, 5), ENOENT);
	CHECK_ERRNO(cm_attr_read(root, "sys", text, 5), EISDIR);
	fake_root_remove(root);
}

static void a_simulated_attribute_is_read_and_written_by_message(void)
{
	char *root = fake_root_make(), text[16];
	struct fake_node *fake = fake_node_start(root, FOLDER "/a/dtbo", WELL_BEHAVED);
	static char much[CM_NODE_PAYLOAD_MAX + 1];

	CHECK(!cm_attr_write(root, FOLDER "/a/dtbo", "overlay", 7));
	CHECK(cm_attr_read(root, FOLDER "/a/dtbo", text, sizeof(text)) == 7);
	CHECK(!memcmp(text, "overlay", 7));
	CHECK_ERRNO(cm_attr_read(root, FOLDER "/a/dtbo", text, 6), EMSGSIZE);
	CHECK(!cm_attr_write(root, FOLDER "/a/dtbo", much, CM_NODE_PAYLOAD_MAX));
	CHECK_ERRNO(cm_attr_write(root, FOLDER "/a/dtbo", much, sizeof(much)), EMSGSIZE);
	CHECK(!cm_attr_write(root, FOLDER "/a/dtbo", "", 0));
	CHECK(cm_attr_read(root, FOLDER "/a/dtbo", text, sizeof(text)) == 0);
	fake_node_stop(fake);
	CHECK_ERRNO(cm_attr_write(root, FOLDER "/a/dtbo", "x", 1), ENODEV);
	fake_root_remove(root);
}

static void an_attribute_needs_no_event_socket(void)
{
	char *root = fake_root_make();
	struct fake_node *fake = fake_node_start(root, "sys/firmware", GREET_WITHOUT_FD);

	CHECK(!cm_attr_write(root, "sys/firmware", "a.bin", 5));
	fake_node_stop(fake);
	fake_root_remove(root);
}

static void the_errno_of_a_refused_attribute_arrives(void)
{
	static const struct {
		enum misdeed misdeed;
		int error;
	} cases[] = { { REFUSE_OPEN, EBUSY }, { REFUSE, EIO },	      { HANG_UP, ENODEV },
		      { WRONG_OP, EPROTO },   { UNASKED_FD, EPROTO }, { LONG_PAYLOAD, EPROTO } };
	size_t i;

	for (i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
		char *root = fake_root_make();
		struct fake_node *fake = fake_node_start(root, "sys/a", cases[i].misdeed);

		CHECK_ERRNO(cm_attr_write(root, "sys/a", "x", 1), cases[i].error);
		fake_node_stop(fake);
		fake_root_remove(root);
	}
}

static void a_real_folder_gets_mkdir_and_rmdir(void)
{
	char *root = fake_root_make();

	fake_file(root, FOLDER "/keep", "");
	CHECK(!cm_attr_mkdir(root, FOLDER, "a"));
	CHECK_ERRNO(cm_attr_mkdir(root, FOLDER, "a"), EEXIST);
	CHECK(!cm_attr_rmdir(root, FOLDER, "a"));
	CHECK_ERRNO(cm_attr_rmdir(root, FOLDER, "a"), ENOENT);
	CHECK_ERRNO(cm_attr_mkdir(root, FOLDER, "../a"), EINVAL);
	CHECK_ERRNO(cm_attr_mkdir(root, FOLDER, ".."), EINVAL);
	CHECK_ERRNO(cm_attr_mkdir(root, FOLDER, ""), EINVAL);
	CHECK_ERRNO(cm_attr_mkdir(root, "sys/none", "a"), ENOENT);
	fake_root_remove(root);
}

static void a_simulated_folder_is_told_the_name(void)
{
	char *root = fake_root_make(), text[16];
	struct fake_node *fake = fake_node_start(root, FOLDER "/.node", WELL_BEHAVED);

	CHECK(!cm_attr_mkdir(root, FOLDER, "camera"));
	CHECK(cm_attr_read(root, FOLDER "/.node", text, sizeof(text)) == 6);
	CHECK(!memcmp(text, "camera", 6));
	CHECK(!cm_attr_rmdir(root, FOLDER, "camera"));
	CHECK(fake_node_requests(fake) == 3);
	fake_node_stop(fake);
	fake_root_remove(root);
}

int main(void)
{
	RUN(a_plain_attribute_is_read_and_written_without_truncating);
	RUN(a_simulated_attribute_is_read_and_written_by_message);
	RUN(an_attribute_needs_no_event_socket);
	RUN(the_errno_of_a_refused_attribute_arrives);
	RUN(a_real_folder_gets_mkdir_and_rmdir);
	RUN(a_simulated_folder_is_told_the_name);
	return 0;
}
