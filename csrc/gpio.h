/* SPDX-License-Identifier: Apache-2.0 */
/*
 * One line of a GPIO chip, through the kernel's character device (uAPI v2, linux/gpio.h).
 *
 * A chip is /dev/gpiochipN.  A line is asked for as it is: neither its direction nor
 * its value changes before cm_gpio_line_drive().  It is held until it is closed, and
 * no other process gets it meanwhile.
 *
 * Errors, threads and simulated nodes: see node.h.
 */
#ifndef CM_SHIM_GPIO_H
#define CM_SHIM_GPIO_H

#include <linux/gpio.h>
#include <stdint.h>

struct cm_gpio_line;

/* What dev/@name is.  EINVAL for a name with a slash; see cm_node_open(). */
int cm_gpio_chip_info(const char *root, const char *name, struct gpiochip_info *info);

/**
 * cm_gpio_line_find() - the line of a chip by its name (gpio-line-names of the device tree)
 * @offset: set to its place in the chip
 *
 * Errors: ENOENT where the chip has none of that name, ENOTUNIQ where it has several.
 */
int cm_gpio_line_find(const char *root, const char *name, const char *line, uint32_t *offset);

/**
 * cm_gpio_line_open() - take line @offset of the chip dev/@name
 * @consumer: the name of its holder, as others see it
 * @active_low: 1 is a low level, for reading and for driving
 *
 * Errors: EINVAL for an @offset that the chip does not have or a @name with a slash,
 * EBUSY where it is taken; those of cm_node_open().
 */
struct cm_gpio_line *cm_gpio_line_open(const char *root, const char *name, uint32_t offset,
				       const char *consumer, int active_low);

/* Give the line back and free; @line may be NULL.  What it drives from then on is up to its chip. */
void cm_gpio_line_close(struct cm_gpio_line *line);

/* Give the line back, free nothing; see cm_node_release(). */
void cm_gpio_line_release(struct cm_gpio_line *line);

/* See cm_node_event_fd(); readable once a simulated line is gone. */
int cm_gpio_line_event_fd(struct cm_gpio_line *line);

/* The line's value as the chip reads it: 0 or 1. */
int cm_gpio_line_get(struct cm_gpio_line *line);

/* Make the line an output with this @value (0 or 1). */
int cm_gpio_line_drive(struct cm_gpio_line *line, int value);

#endif /* CM_SHIM_GPIO_H */
