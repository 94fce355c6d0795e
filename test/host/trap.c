// SPDX-License-Identifier: Apache-2.0
/// LD_PRELOAD: counts the calls of the heap, by any thread, between the first and the last epoll_wait(), that is after the
/// start and before the end, and writes "calls waits" into the file $TRAP when the process ends.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <unistd.h>

extern void* __libc_malloc(size_t n);
extern void* __libc_calloc(size_t n, size_t size);
extern void* __libc_realloc(void* p, size_t n);
extern void* __libc_memalign(size_t alignment, size_t n);
extern void __libc_free(void* p);

static _Atomic long n_calls, n_waits;
static long n_calls_at_wait;

static void note(void)
{
    if (n_waits > 0) { ++n_calls; }
}

void* malloc(size_t n)
{
    note();
    return __libc_malloc(n);
}

void* calloc(size_t n, size_t size)
{
    note();
    return __libc_calloc(n, size);
}

void* realloc(void* p, size_t n)
{
    note();
    return __libc_realloc(p, n);
}

void* aligned_alloc(size_t alignment, size_t n)
{
    note();
    return __libc_memalign(alignment, n);
}

int posix_memalign(void** p, size_t alignment, size_t n)
{
    note();
    *p = __libc_memalign(alignment, n);
    return *p == NULL;
}

void free(void* p)
{
    if (p != NULL) { note(); }
    __libc_free(p);
}

int epoll_wait(int fd, struct epoll_event* event, int n, int timeout)
{
    static int (*next)(int, struct epoll_event*, int, int);
    if (next == NULL) { *(void**)&next = dlsym(RTLD_NEXT, "epoll_wait"); }
    n_calls_at_wait = n_calls;
    ++n_waits;
    return next(fd, event, n, timeout);
}

__attribute__((destructor)) static void report(void)
{
    char text[64];
    const int length = snprintf(text, sizeof text, "%ld %ld\n", n_calls_at_wait, n_waits);
    const int fd = open(getenv("TRAP"), O_WRONLY | O_CREAT | O_TRUNC, 0644);
    (void)!write(fd, text, (size_t)length);
    (void)close(fd);
}
