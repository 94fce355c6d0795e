// SPDX-License-Identifier: Apache-2.0
#include "file_identity.h"

#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

static const char* name_of(const char* path)
{
    const char* slash = strrchr(path, '/');
    return slash == NULL ? path : slash + 1;
}

/// The directory in which path lies, or would.
static bool find_folder(const char* path, struct stat* info)
{
    char folder[PATH_MAX];
    const size_t n = (size_t)(name_of(path) - path);
    if (n + 2 > sizeof folder) { return false; }
    (void)snprintf(folder, sizeof folder, "%.*s.", (int)n, path);
    return stat(folder, info) == 0;
}

static bool is_same_inode(const struct stat* a, const struct stat* b)
{
    return a->st_dev == b->st_dev && a->st_ino == b->st_ino;
}

bool ipe_file_is_same(const char* a, const char* b)
{
    struct stat of_a, of_b;
    const bool has_a = stat(a, &of_a) == 0, has_b = stat(b, &of_b) == 0;
    if (has_a && has_b) { return S_ISREG(of_a.st_mode) && is_same_inode(&of_a, &of_b); }
    return has_a == has_b && strcmp(name_of(a), name_of(b)) == 0 && find_folder(a, &of_a) && find_folder(b, &of_b) &&
           is_same_inode(&of_a, &of_b);
}
