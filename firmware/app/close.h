// SPDX-License-Identifier: Apache-2.0
/// End of the daemon.
#ifndef IPE_CLOSE_H
#define IPE_CLOSE_H

#include "daemon.h"

/// Publish the remaining rows and the final estimate, write the result files, print the summary. False, with the reason on
/// stderr: the estimate, the checkpoint or the record of a replay is incomplete.
bool daemon_close(daemon_t* d);

#endif
