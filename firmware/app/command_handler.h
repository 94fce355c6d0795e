// SPDX-License-Identifier: Apache-2.0
/// Commands: executed between two samples, recorded, answered on EVENT.
#ifndef IPE_COMMAND_HANDLER_H
#define IPE_COMMAND_HANDLER_H

#include "daemon.h"

/// Execute the command in item and publish the answer: DONE and what changed, or REFUSED and why.
void command_handler_execute(daemon_t* d, const ipe_inbox_item_t* item);

#endif
