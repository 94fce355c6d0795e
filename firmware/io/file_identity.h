// SPDX-License-Identifier: Apache-2.0
/// Whether two paths name the same file. No heap, no state.
#ifndef IPE_FILE_IDENTITY_H
#define IPE_FILE_IDENTITY_H

#include <stdbool.h>

/// True if what is written to one path would be found under the other: both are the same regular file, by whatever links,
/// or neither exists and both would become the same entry of the same directory. False for devices and pipes.
bool ipe_file_is_same(const char* a, const char* b);

#endif
