// SPDX-License-Identifier: Apache-2.0
/// A file with given content that goes away by itself.
#ifndef TEST_TEMP_FILE_H
#define TEST_TEMP_FILE_H

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <unity.h>

enum { TEMP_FILES_MAX = 16 };

static char temp_path[TEMP_FILES_MAX][32];
static int n_temp_files;

/// A new file that holds n bytes; its path, good until remove_temp_files().
static inline const char* temp_file_of(const void* content, size_t n)
{
    TEST_ASSERT_LESS_THAN(TEMP_FILES_MAX, n_temp_files);
    char* path = temp_path[n_temp_files++];
    (void)snprintf(path, sizeof temp_path[0], "/tmp/inertiad-XXXXXX");
    const int fd = mkstemp(path);
    TEST_ASSERT_GREATER_OR_EQUAL(0, fd);
    TEST_ASSERT_EQUAL(n, write(fd, content, n));
    (void)close(fd);
    return path;
}

static inline const char* temp_file(const char* text)
{
    return temp_file_of(text, strlen(text));
}

static inline void remove_temp_files(void)
{
    while (n_temp_files > 0) { (void)unlink(temp_path[--n_temp_files]); }
}

/// Messages to stderr are expected: keep them out of the test's output.
static inline void silence_stderr(void)
{
    (void)fflush(stderr);
    const int fd = open("/dev/null", O_WRONLY | O_CLOEXEC);
    (void)dup2(fd, STDERR_FILENO);
    (void)close(fd);
}

#endif
