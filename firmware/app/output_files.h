// SPDX-License-Identifier: Apache-2.0
/// Files that the daemon is to write.
#ifndef IPE_OUTPUT_FILES_H
#define IPE_OUTPUT_FILES_H

#include "daemon.h"

/// 0, or -1 with the reason on stderr: an output would overwrite an input or another output. Looks at d->option only, before
/// anything is opened.
int output_files_check(const daemon_t* d);

#endif
