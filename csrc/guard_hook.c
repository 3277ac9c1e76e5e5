// SPDX-License-Identifier: Apache-2.0
/*
 * Calls of libzmq into the C library, led through the guard: in the table of its ELF object that the dynamic linker
 * filled in with their addresses (relocations of type JUMP_SLOT and GLOB_DAT), our functions take the place of those.
 */
#include <elf.h>
#include <link.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "guard_private.h"

#if defined(__x86_64__) || defined(__i386__)
#define IS_FUNCTION(type) \
	((type) == R_X86_64_JUMP_SLOT || (type) == R_X86_64_GLOB_DAT) /* the same as R_386_ */
#elif defined(__aarch64__)
#define IS_FUNCTION(type) ((type) == R_AARCH64_JUMP_SLOT || (type) == R_AARCH64_GLOB_DAT)
#elif defined(__arm__)
#define IS_FUNCTION(type) ((type) == R_ARM_JUMP_SLOT || (type) == R_ARM_GLOB_DAT)
#elif defined(__riscv)
#define IS_FUNCTION(type) ((type) == R_RISCV_JUMP_SLOT || (type) == R_RISCV_64)
#else
#define IS_FUNCTION(type) 0
#endif

#if __SIZEOF_POINTER__ == 8
#define SYMBOL(info) ELF64_R_SYM(info)
#define TYPE(info) ELF64_R_TYPE(info)
#else
#define SYMBOL(info) ELF32_R_SYM(info)
#define TYPE(info) ELF32_R_TYPE(info)
#endif

struct replacement {
	const char *name;
	void (*function)(void);
};

static const struct replacement replacements[] = {
	{ "accept", (void (*)(void))cm_guard_accept },
	{ "accept4", (void (*)(void))cm_guard_accept4 },
	{ "listen", (void (*)(void))cm_guard_listen },
	{ "close", (void (*)(void))cm_guard_close },
	{ "epoll_ctl", (void (*)(void))cm_guard_epoll_ctl },
	{ "recv", (void (*)(void))cm_guard_recv },
	{ "__recv_chk", (void (*)(void))cm_guard_recv_chk },
};

/* The contents of an object's dynamic section. */
struct object {
	ElfW(Addr) base;
	const ElfW(Sym) * symbols;
	const char *names;
	const char *jumps; /* DT_JMPREL, and DT_RELA or DT_REL */
	const char *others;
	size_t jumps_size;
	size_t others_size;
	size_t entry;
};

/* Some C libraries do not add the base to the addresses. */
static const void *at(const struct object *object, ElfW(Addr) value)
{
	return (const void *)(value < object->base ? value + object->base : value);
}

static void read_dynamic(struct object *object, const ElfW(Dyn) * dynamic)
{
	object->entry = sizeof(ElfW(Rela));
	for (; dynamic->d_tag != DT_NULL; dynamic++) {
		ElfW(Addr) value = dynamic->d_un.d_ptr;

		if (dynamic->d_tag == DT_SYMTAB)
			object->symbols = at(object, value);
		else if (dynamic->d_tag == DT_STRTAB)
			object->names = at(object, value);
		else if (dynamic->d_tag == DT_JMPREL)
			object->jumps = at(object, value);
		else if (dynamic->d_tag == DT_PLTRELSZ)
			object->jumps_size = value;
		else if (dynamic->d_tag == DT_PLTREL)
			object->entry = value == DT_RELA ? sizeof(ElfW(Rela)) : sizeof(ElfW(Rel));
		else if (dynamic->d_tag == DT_RELA || dynamic->d_tag == DT_REL)
			object->others = at(object, value);
		else if (dynamic->d_tag == DT_RELASZ || dynamic->d_tag == DT_RELSZ)
			object->others_size = value;
	}
}

/* The page stays writable: the linker may have to fill in others of its functions yet. */
static bool put(void **slot, void (*function)(void))
{
	uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE), start = (uintptr_t)slot & ~(page - 1);

	if (mprotect((void *)start, page, PROT_READ | PROT_WRITE))
		return false;
	memcpy(slot, &function, sizeof(function)); /* aligned: one store */
	return true;
}

static int replace(const struct object *object, const char *table, size_t size)
{
	int replaced = 0;

	for (size_t place = 0; table && place + object->entry <= size; place += object->entry) {
		const ElfW(Rel) *relocation =
			(const ElfW(Rel) *)(table + place); /* a Rela begins the same */
		const char *name =
			object->names + object->symbols[SYMBOL(relocation->r_info)].st_name;

		if (!IS_FUNCTION(TYPE(relocation->r_info)))
			continue;
		for (size_t i = 0; i < sizeof(replacements) / sizeof(*replacements); i++)
			if (!strcmp(name, replacements[i].name))
				replaced += put((void **)(object->base + relocation->r_offset),
						replacements[i].function);
	}
	return replaced;
}

/* libzmq as a shared library, or inside pyzmq's module `_zmq`. */
static int look(struct dl_phdr_info *info, size_t size, void *replaced)
{
	const char *file = strrchr(info->dlpi_name, '/');
	struct object object = { .base = info->dlpi_addr };

	(void)size;
	if (!strstr(file ? file : info->dlpi_name, "zmq"))
		return 0;
	for (int i = 0; i < info->dlpi_phnum; i++)
		if (info->dlpi_phdr[i].p_type == PT_DYNAMIC)
			read_dynamic(&object, (const ElfW(Dyn) *)(info->dlpi_addr +
								  info->dlpi_phdr[i].p_vaddr));
	if (object.symbols && object.names) {
		*(int *)replaced += replace(&object, object.jumps, object.jumps_size);
		*(int *)replaced += replace(&object, object.others, object.others_size);
	}
	return 0;
}

int cm_guard_install(void)
{
	int replaced = 0;

	dl_iterate_phdr(look, &replaced);
	return replaced;
}
