// SPDX-License-Identifier: Apache-2.0
/*
 * The registers of a window: a Config message of cm.proto, of which this reads what an access needs.
 *
 * https://protobuf.dev/programming-guides/encoding: a message is a run of fields, each a number and a kind,
 * then a varint, bytes with their count, or four or eight bytes.
 */
#include <errno.h>
#include <stdlib.h>
#include <string.h>

#include "cm_private.h"
#include "cm_registers.h"

struct bytes {
	const uint8_t *at;
	const uint8_t *end;
};

/* A field of a message: its number, and its value if that is a number, or its bytes. */
struct field {
	uint32_t number;
	uint64_t value;
	struct bytes bytes;
};

static bool take_varint(struct bytes *from, uint64_t *value)
{
	*value = 0;
	for (unsigned int shift = 0; shift < 64 && from->at < from->end; shift += 7) {
		uint8_t byte = *from->at++;

		*value |= (uint64_t)(byte & 0x7f) << shift;
		if (!(byte & 0x80))
			return true;
	}
	return false;
}

static bool skip(struct bytes *from, uint64_t count)
{
	if (count > (uint64_t)(from->end - from->at))
		return false;
	from->at += count;
	return true;
}

/* The next field: 1, or 0 at the end; -1 with EPROTO for what is no message. */
static int next(struct bytes *message, struct field *field)
{
	uint64_t key = 0;
	bool good;

	if (message->at == message->end)
		return 0;
	*field = (struct field){ .bytes = { message->at, message->at } };
	good = take_varint(message, &key);
	field->number = (uint32_t)(key >> 3);
	if (good && (key & 7) == 0) {
		good = take_varint(message, &field->value);
	} else if (good && (key & 7) == 2) {
		good = take_varint(message, &field->value);
		field->bytes.at = message->at;
		good = good && skip(message, field->value);
		field->bytes.end = message->at;
	} else if (good && ((key & 7) == 1 || (key & 7) == 5)) {
		good = skip(message, (key & 7) == 1 ? 8 : 4);
	} else {
		good = false;
	}
	if (good)
		return 1;
	errno = EPROTO;
	return -1;
}

/* A text that is left out is empty, and points nowhere: memcmp() must not be given that. */
static bool begins(const char *word, struct bytes text)
{
	size_t length = (size_t)(text.end - text.at);

	return !length || !strncmp(word, (const char *)text.at, length);
}

static bool is(struct bytes text, const char *word)
{
	return strlen(word) == (size_t)(text.end - text.at) && begins(word, text);
}

static uint64_t bits(uint64_t width)
{
	return width >= 64 ? UINT64_MAX : (UINT64_C(1) << width) - 1;
}

/* A RegisterInfo, or a FieldInfo, as far as it is read. */
struct info {
	struct bytes name;
	struct bytes access;
	uint64_t place; /* address, or lowest bit */
	uint64_t width;
	uint64_t minimum;
	uint64_t maximum;
};

static int read_info(struct bytes message, bool of_field, struct info *info)
{
	const uint32_t access = of_field ? 6 : 4;
	struct field field;
	int result;

	*info = (struct info){ .width = of_field ? 1 : 32, .maximum = UINT64_MAX };
	while ((result = next(&message, &field)) > 0) {
		if (field.number == 1)
			info->name = field.bytes;
		else if (field.number == 2)
			info->place = field.value;
		else if (field.number == 3)
			info->width = field.value;
		else if (field.number == access)
			info->access = field.bytes;
		else if (field.number == 6)
			info->minimum = field.value;
		else if (field.number == 7)
			info->maximum = field.value;
	}
	return result;
}

static uint32_t access_of(struct bytes text)
{
	if (is(text, "ro") || is(text, "rc"))
		return CM_REGISTER_READS;
	if (is(text, "wo"))
		return CM_REGISTER_WRITES;
	return CM_REGISTER_READS | CM_REGISTER_WRITES;
}

static void whole(const struct info *info, struct cm_register *found)
{
	*found = (struct cm_register){
		.offset = info->place,
		.width = (uint32_t)info->width,
		.access = access_of(info->access),
		.mask = bits(info->width),
		.minimum = info->minimum,
		.maximum = info->maximum,
	};
}

/*
 * The bits that a write of one field writes back: not those for which a 1 means something, nor any of a
 * register of such.  A register that cannot be read, or is changed by that, is written as a whole.
 */
static int kept_beside(struct bytes message, const struct info *info, uint64_t *kept)
{
	struct field field;
	struct info part;
	int result;

	*kept = is(info->access, "w1c") ? 0 : bits(info->width);
	while ((result = next(&message, &field)) > 0) {
		if (field.number != 9)
			continue;
		if (read_info(field.bytes, true, &part))
			return -1;
		if (is(part.access, "rc"))
			return 1;
		if (part.place < 64 && part.access.at != part.access.end &&
		    !is(part.access, "rw") && !is(part.access, "wo"))
			*kept &= ~(bits(part.width) << part.place);
	}
	return result ? result : is(info->access, "wo");
}

/* Look for the field @name of a register: 1 if it is there. */
static int find_field(struct bytes message, const struct info *info, const char *name,
		      struct cm_register *found)
{
	struct bytes rest = message;
	struct field field;
	struct info part;
	int result;

	while ((result = next(&rest, &field)) > 0) {
		if (field.number != 9)
			continue;
		if (read_info(field.bytes, true, &part))
			return -1;
		if (!is(part.name, name) || part.place >= 64)
			continue;
		whole(info, found);
		result = kept_beside(message, info, &found->kept);
		if (result < 0)
			return -1;
		if (part.access.at != part.access.end)
			found->access &= access_of(part.access);
		if (result) {
			found->access &= ~CM_REGISTER_WRITES;
			found->kept = 0;
		}
		found->lsb = (uint32_t)part.place;
		found->mask = bits(part.width);
		found->kept &= ~(found->mask << found->lsb);
		return 1;
	}
	return result;
}

/* 1 if @message, a RegisterInfo, is the register @name or has that field. */
static int find_in(struct bytes message, const char *name, struct cm_register *found)
{
	struct info info;
	size_t length;

	if (read_info(message, false, &info))
		return -1;
	if (is(info.name, name)) {
		whole(&info, found);
		return 1;
	}
	length = (size_t)(info.name.end - info.name.at);
	if (strlen(name) <= length || !begins(name, info.name) || name[length] != '.')
		return 0;
	return find_field(message, &info, name + length + 1, found);
}

int table_find(const char *table, size_t size, const char *name, struct cm_register *found)
{
	struct bytes rest = { (const uint8_t *)table, (const uint8_t *)table + size };
	struct field field;
	int result;

	while ((result = next(&rest, &field)) > 0) {
		int there = field.number == 5 ? find_in(field.bytes, name, found) : 0;

		if (there)
			return there > 0 ? 0 : -1;
	}
	if (!result)
		errno = ENOENT;
	return -1;
}
