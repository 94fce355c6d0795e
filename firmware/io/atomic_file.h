// SPDX-License-Identifier: Apache-2.0
/// Replace a file atomically: write PATH.tmp, sync, rename. A reader finds the whole old or the whole new content.
///
/// A path that is not a regular file (/dev/stdout) is written to directly, a pipe only if its reader comes and reads within
/// 2 s. No heap, no state; waits for the disk.
#ifndef IPE_ATOMIC_FILE_H
#define IPE_ATOMIC_FILE_H

#include <stdbool.h>
#include <stddef.h>

/// True if path can be written; otherwise one line in message[size], always terminated. Leaves an existing file as it is.
bool ipe_atomic_file_check(const char* path, char* message, size_t size);

/// Replace the content of path by n bytes. 0, or -1 with the reason in message; then the file is as it was.
int ipe_atomic_file_write(const char* path, const void* bytes, size_t n, char* message, size_t size);

/// Make the newest name of path in its directory last through a power cut. Where that is not possible nothing is lost but
/// the name.
void ipe_atomic_file_sync_name(const char* path);

#endif
