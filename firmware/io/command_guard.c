// SPDX-License-Identifier: Apache-2.0
#include "command_guard.h"

#include <stdbool.h>

/// Forget what would be refused as too old anyway.
static void forget_old(ipe_command_guard_t* g, int64_t oldest_ns)
{
    unsigned n = 0;
    for (unsigned i = 0; i < g->n; ++i) {
        if (g->accepted[i].t_ns >= oldest_ns) { g->accepted[n++] = g->accepted[i]; }
    }
    g->n = n;
}

static bool is_known(const ipe_command_guard_t* g, const ipe_command_t* command)
{
    for (unsigned i = 0; i < g->n; ++i) {
        if (g->accepted[i].sender == command->sender && g->accepted[i].sequence == command->sequence) { return true; }
    }
    return false;
}

ipe_command_novelty_t ipe_command_guard_check(ipe_command_guard_t* g, const ipe_command_t* command, int64_t now_ns,
                                              int64_t listened_ns)
{
    forget_old(g, now_ns - IPE_COMMAND_AGE_MAX);
    if (command->t_ns < now_ns - IPE_COMMAND_AGE_MAX) { return IPE_COMMAND_OLD; }
    if (command->t_ns > now_ns + IPE_COMMAND_AGE_MAX) { return IPE_COMMAND_AHEAD; }
    if (command->t_ns < now_ns - listened_ns) { return IPE_COMMAND_EARLY; }
    if (is_known(g, command)) { return IPE_COMMAND_REPEATED; }
    if (g->n == IPE_COMMANDS_KEPT) { return IPE_COMMAND_TOO_MANY; }
    g->accepted[g->n].t_ns = command->t_ns;
    g->accepted[g->n].sender = command->sender;
    g->accepted[g->n].sequence = command->sequence;
    g->n++;
    return IPE_COMMAND_NEW;
}
