// SPDX-License-Identifier: Apache-2.0
/// Start of the daemon.
#ifndef IPE_OPEN_H
#define IPE_OPEN_H

#include "daemon.h"

/// Open everything that d->option names, in the order of the data path. 0, or -1 with the reason on stderr.
int daemon_open(daemon_t* d);

#endif
