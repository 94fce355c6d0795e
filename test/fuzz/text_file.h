// SPDX-License-Identifier: Apache-2.0
/// An input as a file in memory, for the readers of files.
#ifndef TEST_FUZZ_TEXT_FILE_H
#define TEST_FUZZ_TEXT_FILE_H

#include "fuzz.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

/// Path of the one file, which now holds these bytes.
static inline const char* text_file(const void* bytes, size_t n)
{
    static char path[32];
    static int fd = -1;
    if (fd < 0) {
        fd = memfd_create("input", MFD_CLOEXEC);
        (void)snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
        REQUIRE(fd >= 0);
    }
    REQUIRE(ftruncate(fd, 0) == 0 && pwrite(fd, bytes, n, 0) == (ssize_t)n);
    return path;
}

#endif
