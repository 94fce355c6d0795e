// SPDX-License-Identifier: Apache-2.0
/// Commands: carried out between two samples, recorded, answered on EVENT with what changed or why not.
#ifndef IPE_CONTROL_H
#define IPE_CONTROL_H

#include "daemon.h"

/// Carry out the command in item.
void control_take(daemon_t* d, const ipe_inbox_item_t* item);

#endif
