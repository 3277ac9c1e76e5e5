// SPDX-License-Identifier: Apache-2.0
/*
 * DMA_BUF_IOCTL_SYNC for buffers of `cm sim --non-coherent`, as a library to preload:
 *
 *	cc -shared -fPIC -o sim_dma_buf.so sim_dma_buf.c
 *	LD_PRELOAD=./sim_dma_buf.so cm serve ...
 *
 * A kernel without hardware has no memory that is not coherent, and a memfd no such call.  Here it
 * does what caches do: START brings what the device wrote into the processor's view, END what the
 * processor wrote into the device's; after the last END the processor's view is worth nothing.
 * Every call is also a line in the file $SIM_DMA_BUF_LOG, whatever it was for.
 */
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/dma-buf.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#define MEMFD "/memfd:cm-sim-noncoherent"
#define MAGIC UINT64_C(0x434D53594E430001)
#define LOST 0xC5 /* what the processor's view holds outside begin and end */

/* cm/simulation/software/transport/buffers.py */
struct counters {
	uint64_t magic;
	int64_t holders;
	uint64_t starts[2]; /* to read, to write */
	uint64_t ends[2];
	uint64_t unpaired;
};

struct view {
	int fd;
	size_t length, size;
	uint8_t *cpu, *device;
	struct counters *counters;
};

int ioctl(int fd, unsigned long request, ...);

static void note(int fd, uint64_t flags)
{
	const char *path = getenv("SIM_DMA_BUF_LOG");
	char line[64];
	int log = path ? open(path, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600) : -1;
	int length = snprintf(line, sizeof(line), "%d %d %#llx\n", getpid(), fd,
			      (unsigned long long)flags);

	if (log < 0)
		return;
	if (write(log, line, (size_t)length) != length)
		abort();
	close(log);
}

static bool ours(int fd, char link[32])
{
	char target[64];
	ssize_t length;

	snprintf(link, 32, "/proc/self/fd/%d", fd);
	length = readlink(link, target, sizeof(target));
	return length > 0 && !strncmp(target, MEMFD, strlen(MEMFD));
}

/* Opened anew, for a reader's descriptor is read-only; the lock ends with the descriptor. */
static int take(struct view *view, const char *link)
{
	struct flock lock = { .l_type = F_WRLCK, .l_whence = SEEK_SET };
	size_t page = (size_t)sysconf(_SC_PAGESIZE);
	struct stat st;

	view->fd = open(link, O_RDWR | O_CLOEXEC);
	if (view->fd < 0 || fstat(view->fd, &st) || fcntl(view->fd, F_OFD_SETLKW, &lock))
		return -1;
	view->size = (size_t)st.st_size;
	view->length = (view->size - page) / 2;
	view->cpu = mmap(NULL, view->size, PROT_READ | PROT_WRITE, MAP_SHARED, view->fd, 0);
	if (view->cpu == MAP_FAILED)
		return -1;
	view->device = view->cpu + view->length;
	view->counters = (struct counters *)(void *)(view->device + view->length);
	return view->counters->magic == MAGIC ? 0 : -1;
}

static void start(const struct view *view, bool writes)
{
	memcpy(view->cpu, view->device, view->length);
	view->counters->holders++;
	view->counters->starts[writes]++;
}

static void end(const struct view *view, bool writes)
{
	if (writes)
		memcpy(view->device, view->cpu, view->length);
	view->counters->ends[writes]++;
	if (view->counters->holders > 0)
		view->counters->holders--;
	else
		view->counters->unpaired++;
	if (!view->counters->holders)
		memset(view->cpu, LOST, view->length);
}

static int sync_views(const char *link, uint64_t flags)
{
	struct view view;

	if ((flags & ~(uint64_t)DMA_BUF_SYNC_VALID_FLAGS_MASK) || !(flags & DMA_BUF_SYNC_RW)) {
		errno = EINVAL;
		return -1;
	}
	if (take(&view, link)) {
		fprintf(stderr, "sim_dma_buf: %s: %s\n", link, strerror(errno));
		abort();
	}
	(flags & DMA_BUF_SYNC_END ? end : start)(&view, flags & DMA_BUF_SYNC_WRITE);
	munmap(view.cpu, view.size);
	close(view.fd);
	return 0;
}

int ioctl(int fd, unsigned long request, ...)
{
	static int (*real)(int, unsigned long, ...);
	char link[32];
	va_list list;
	void *arg;

	va_start(list, request);
	arg = va_arg(list, void *);
	va_end(list);
	if (request == DMA_BUF_IOCTL_SYNC) {
		note(fd, ((struct dma_buf_sync *)arg)->flags);
		if (ours(fd, link))
			return sync_views(link, ((struct dma_buf_sync *)arg)->flags);
	}
	if (!real)
		*(void **)&real = dlsym(RTLD_NEXT, "ioctl");
	return real(fd, request, arg);
}
