// SPDX-License-Identifier: Apache-2.0
/// The daemon: arguments -> configuration -> open -> loop -> close.
///
/// One epoll set in one thread, beside it the writers of record and checkpoint; no heap after start.
/// Exit status: 0 end of input, SIGTERM or SIGINT; 1 estimate, checkpoint or the record of a replay not written;
/// 2 could not start.
#include "daemon.h"
#include "loop.h"

enum { STATUS_GOOD = 0, STATUS_NOT_WRITTEN = 1, STATUS_USAGE = 2 };

int main(int argc, char** argv)
{
    static daemon_t self;
    const int help = options_read(&self.option, argc, argv);
    if (help != 0) { return help > 0 ? STATUS_GOOD : STATUS_USAGE; }
    if (daemon_open(&self) != 0) { return STATUS_USAGE; }
    ipe_notify_send(&self.notify, "READY=1\nSTATUS=waiting for frames");
    loop_run(&self);
    ipe_notify_send(&self.notify, "STOPPING=1");
    return daemon_close(&self) ? STATUS_GOOD : STATUS_NOT_WRITTEN;
}
