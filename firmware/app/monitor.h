// SPDX-License-Identifier: Apache-2.0
/// Looks after what surrounds the data: tells on EVENT what changed, keeps the checkpoint fresh.
#ifndef IPE_MONITOR_H
#define IPE_MONITOR_H

#include "daemon.h"

/// Tell when interface i went down or came back.
void monitor_interface(daemon_t* d, unsigned i);

/// Tell once when messages begin to miss in the record, and again after a second in which none did.
void monitor_record(daemon_t* d);

/// Once a second of real time. HEALTH goes out here when no data moved it.
void monitor_tick(daemon_t* d);

#endif
