// SPDX-License-Identifier: Apache-2.0
/// The daemon: options -> open -> loop -> close.
///
/// One thread with one epoll set, and one thread each that writes the record and the checkpoint; no heap after start.
/// SIGTERM, SIGINT, SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2, SIGALRM, SIGXCPU and SIGXFSZ end it as the end of the input does.
/// The exit status is described in the text of --help (options.c).
#include "close.h"
#include "loop.h"
#include "open.h"

#include <fcntl.h>
#include <unistd.h>

enum { STATUS_GOOD = 0, STATUS_NOT_WRITTEN = 1, STATUS_USAGE = 2, STATUS_RETRY = 3 };

/// Where stdin, stdout or stderr is closed, the next file opened would take its place, and messages would go into it. Who
/// reads stdin or writes stdout then gets an error.
static void fill_standard_descriptors(void)
{
    for (int fd = STDIN_FILENO; fd <= STDERR_FILENO; ++fd) {
        if (fcntl(fd, F_GETFD) < 0) { (void)open("/dev/null", fd == STDOUT_FILENO ? O_RDONLY : O_WRONLY); }
    }
}

static int status_of_refusal(const daemon_t* d)
{
    if (d->is_done) { return STATUS_GOOD; }  // stopped while it waited for an input
    return d->can_retry ? STATUS_RETRY : STATUS_USAGE;
}

int main(int argc, char** argv)
{
    static daemon_t self;
    fill_standard_descriptors();
    const options_result_t result = options_read(&self.option, argc, argv);
    if (result != OPTIONS_RUN) { return result == OPTIONS_PRINTED ? STATUS_GOOD : STATUS_USAGE; }
    if (daemon_open(&self) != 0) { return status_of_refusal(&self); }
    ipe_notify_send(&self.notify, "READY=1\nSTATUS=waiting for frames");
    loop_run(&self);
    ipe_notify_send(&self.notify, "STOPPING=1");
    return daemon_close(&self) ? STATUS_GOOD : STATUS_NOT_WRITTEN;
}
