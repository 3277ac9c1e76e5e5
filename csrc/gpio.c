// SPDX-License-Identifier: Apache-2.0
#include "gpio.h"

#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "node.h"

struct cm_gpio_line {
	struct cm_node *node;
	uint64_t flags;
};

static struct cm_node *open_chip(const char *root, const char *name)
{
	char path[sizeof("dev/") + NAME_MAX];
	int length = snprintf(path, sizeof(path), "dev/%s", name);

	if (!*name || strchr(name, '/') || (size_t)length >= sizeof(path)) {
		errno = EINVAL;
		return NULL;
	}
	return cm_node_open(root, path);
}

int cm_gpio_chip_info(const char *root, const char *name, struct gpiochip_info *info)
{
	struct cm_node *chip = open_chip(root, name);
	int result;

	if (!chip)
		return -1;
	memset(info, 0, sizeof(*info));
	result = cm_node_request(chip, GPIO_GET_CHIPINFO_IOCTL, info, sizeof(*info), NULL,
				 CM_NODE_FD_NONE);
	cm_node_close(chip);
	info->name[sizeof(info->name) - 1] = info->label[sizeof(info->label) - 1] = '\0';
	return result;
}

static int name_of(struct cm_node *chip, uint32_t offset, struct gpio_v2_line_info *info)
{
	memset(info, 0, sizeof(*info));
	info->offset = offset;
	return cm_node_request(chip, GPIO_V2_GET_LINEINFO_IOCTL, info, sizeof(*info), NULL,
			       CM_NODE_FD_NONE);
}

static int find_line(struct cm_node *chip, const char *line, uint32_t *offset)
{
	struct gpiochip_info what = { .lines = 0 };
	struct gpio_v2_line_info info;
	uint32_t i, found = 0;

	if (cm_node_request(chip, GPIO_GET_CHIPINFO_IOCTL, &what, sizeof(what), NULL,
			    CM_NODE_FD_NONE))
		return -1;
	for (i = 0; i < what.lines; i++) {
		if (name_of(chip, i, &info))
			return -1;
		if (*line && !strncmp(info.name, line, sizeof(info.name))) {
			*offset = i;
			found++;
		}
	}
	errno = found ? ENOTUNIQ : ENOENT;
	return found == 1 ? 0 : -1;
}

int cm_gpio_line_find(const char *root, const char *name, const char *line, uint32_t *offset)
{
	struct cm_node *chip = open_chip(root, name);
	int result = chip ? find_line(chip, line, offset) : -1;

	cm_node_close(chip);
	return result;
}

/* Without a direction flag, the line keeps its direction. */
static struct cm_node *take_line(struct cm_node *chip, uint32_t offset, const char *consumer,
				 uint64_t flags)
{
	struct gpio_v2_line_request request = {
		.offsets = { offset },
		.config = { .flags = flags },
		.num_lines = 1,
		.fd = -1,
	};

	snprintf(request.consumer, sizeof(request.consumer), "%s", consumer);
	if (cm_node_request(chip, GPIO_V2_GET_LINE_IOCTL, &request, sizeof(request), &request.fd,
			    CM_NODE_FD_RECEIVE))
		return NULL;
	return cm_node_adopt(request.fd);
}

struct cm_gpio_line *cm_gpio_line_open(const char *root, const char *name, uint32_t offset,
				       const char *consumer, int active_low)
{
	struct cm_gpio_line *line = calloc(1, sizeof(*line));
	struct cm_node *chip;

	if (!line)
		return NULL;
	line->flags = active_low ? GPIO_V2_LINE_FLAG_ACTIVE_LOW : 0;
	chip = open_chip(root, name);
	if (chip)
		line->node = take_line(chip, offset, consumer, line->flags);
	cm_node_close(chip);
	if (!line->node) {
		cm_gpio_line_close(line);
		return NULL;
	}
	return line;
}

void cm_gpio_line_close(struct cm_gpio_line *line)
{
	int error = errno;

	if (!line)
		return;
	cm_node_close(line->node);
	free(line);
	errno = error;
}

void cm_gpio_line_release(struct cm_gpio_line *line)
{
	cm_node_release(line->node);
}

int cm_gpio_line_event_fd(struct cm_gpio_line *line)
{
	return cm_node_event_fd(line->node);
}

int cm_gpio_line_get(struct cm_gpio_line *line)
{
	struct gpio_v2_line_values values = { .mask = 1 };

	if (cm_node_request(line->node, GPIO_V2_LINE_GET_VALUES_IOCTL, &values, sizeof(values),
			    NULL, CM_NODE_FD_NONE))
		return -1;
	return values.bits & 1;
}

int cm_gpio_line_drive(struct cm_gpio_line *line, int value)
{
	struct gpio_v2_line_config config = {
		.flags = GPIO_V2_LINE_FLAG_OUTPUT | line->flags,
		.num_attrs = 1,
		.attrs = { {
			.attr = { .id = GPIO_V2_LINE_ATTR_ID_OUTPUT_VALUES,
				  .values = value ? 1 : 0 },
			.mask = 1,
		} },
	};

	return cm_node_request(line->node, GPIO_V2_LINE_SET_CONFIG_IOCTL, &config, sizeof(config),
			       NULL, CM_NODE_FD_NONE);
}
