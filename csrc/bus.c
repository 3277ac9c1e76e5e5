// SPDX-License-Identifier: Apache-2.0
#include "bus.h"

#include <errno.h>
#include <pthread.h>
#include <setjmp.h>
#include <signal.h>
#include <stdatomic.h>

#include "mmio.h"

/* Where this thread goes on if its access fails.  In static TLS, so that the handler allocates nothing. */
static _Thread_local sigjmp_buf *volatile back __attribute__((tls_model("initial-exec")));

static struct sigaction before;
static int watching; /* errno of the attempt */
static pthread_once_t once = PTHREAD_ONCE_INIT;

static void give_to_others(int number, siginfo_t *info, void *context)
{
	if (before.sa_flags & SA_SIGINFO) {
		before.sa_sigaction(number, info, context);
	} else if (before.sa_handler != SIG_DFL && before.sa_handler != SIG_IGN) {
		before.sa_handler(number);
	} else {
		/* what faulted does so again, and nobody catches it */
		signal(number, SIG_DFL);
		if (info->si_code <= 0)
			raise(number);
	}
}

/* A signal that somebody sent (si_code <= 0) is not an access of ours. */
static void no_answer(int number, siginfo_t *info, void *context)
{
	sigjmp_buf *to = back;

	if (to && info->si_code > 0) {
		back = NULL;
		siglongjmp(*to, 1);
	}
	give_to_others(number, info, context);
}

static void watch(void)
{
	/* not deferred: the way out of the handler does not restore the mask */
	struct sigaction action = { .sa_sigaction = no_answer,
				    .sa_flags = SA_SIGINFO | SA_NODEFER | SA_ONSTACK };

	sigemptyset(&action.sa_mask);
	if (sigaction(SIGBUS, &action, &before))
		watching = errno;
}

int cm_bus_watch(void)
{
	pthread_once(&once, watch);
	errno = watching;
	return watching ? -1 : 0;
}

/* Between these two a SIGBUS of this thread ends the function that they are in. */
#define BEGIN()                    \
	sigjmp_buf place;          \
                                   \
	if (sigsetjmp(place, 0)) { \
		errno = EIO;       \
		return -1;         \
	}                          \
	back = &place;             \
	atomic_signal_fence(memory_order_seq_cst)

#define END()                                              \
	do {                                               \
		atomic_signal_fence(memory_order_seq_cst); \
		back = NULL;                               \
	} while (0)

int cm_bus_read(const volatile void *at, unsigned int width, uint64_t *value)
{
	BEGIN();
	*value = cm_mmio_read(at, width);
	END();
	return 0;
}

int cm_bus_write(volatile void *at, unsigned int width, uint64_t value)
{
	BEGIN();
	cm_mmio_write(at, width, value);
	END();
	return 0;
}

int cm_bus_read_block(const volatile void *from, void *data, size_t length)
{
	BEGIN();
	cm_mmio_read_block(from, data, length);
	END();
	return 0;
}

int cm_bus_write_block(volatile void *to, const void *data, size_t length)
{
	BEGIN();
	cm_mmio_write_block(to, data, length);
	END();
	return 0;
}
