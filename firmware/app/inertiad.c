// SPDX-License-Identifier: Apache-2.0
/// The daemon: options -> open -> loop -> close.
///
/// One thread with one epoll set, and one thread each that writes the record and the checkpoint; no heap after start.
/// Exit status: 0 end of input, SIGTERM or SIGINT; 1 estimate, checkpoint or the record of a replay not written, or no
/// frame of a log belongs to a signal; 2 could not start.
#include "close.h"
#include "loop.h"
#include "open.h"

enum { STATUS_GOOD = 0, STATUS_NOT_WRITTEN = 1, STATUS_USAGE = 2 };

int main(int argc, char** argv)
{
    static daemon_t self;
    const options_result_t result = options_read(&self.option, argc, argv);
    if (result != OPTIONS_RUN) { return result == OPTIONS_PRINTED ? STATUS_GOOD : STATUS_USAGE; }
    if (daemon_open(&self) != 0) { return STATUS_USAGE; }
    ipe_notify_send(&self.notify, "READY=1\nSTATUS=waiting for frames");
    loop_run(&self);
    ipe_notify_send(&self.notify, "STOPPING=1");
    return daemon_close(&self) ? STATUS_GOOD : STATUS_NOT_WRITTEN;
}
