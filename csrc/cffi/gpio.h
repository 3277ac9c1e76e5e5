/* SPDX-License-Identifier: Apache-2.0 */
struct gpiochip_info {
	char name[32];
	char label[32];
	uint32_t lines;
};

struct cm_gpio_line;
int cm_gpio_chip_info(const char *root, const char *name, struct gpiochip_info *info);
struct cm_gpio_line *cm_gpio_line_open(const char *root, const char *name, uint32_t offset,
				       const char *consumer, int active_low);
int cm_gpio_line_find(const char *root, const char *name, const char *line, uint32_t *offset);
void cm_gpio_line_close(struct cm_gpio_line *line);
void cm_gpio_line_release(struct cm_gpio_line *line);
int cm_gpio_line_event_fd(struct cm_gpio_line *line);
int cm_gpio_line_get(struct cm_gpio_line *line);
int cm_gpio_line_drive(struct cm_gpio_line *line, int value);
