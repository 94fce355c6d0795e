// SPDX-License-Identifier: Apache-2.0
#include "output_files.h"

#include "file_identity.h"

#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

enum { FILES_MAX = IPE_BUSES_MAX + 8 };

typedef struct {
    const char* option;
    bool is_output;
    char path[PATH_MAX];
} file_t;

typedef struct {
    unsigned n;
    file_t file[FILES_MAX];
} files_t;

/// Add SCHEMEpath?options; a path without the scheme only where it is optional. Nothing for other addresses and for NULL.
static void add(files_t* f, const char* option, bool is_output, const char* scheme, bool is_optional,
                const char* address, const char* suffix)
{
    if (address == NULL) { return; }
    const bool has_scheme = strncmp(address, scheme, strlen(scheme)) == 0;
    if (!has_scheme && !is_optional) { return; }
    const char* path = has_scheme ? address + strlen(scheme) : address;
    const int n = (int)(scheme[0] != '\0' ? strcspn(path, "?") : strlen(path));
    file_t* file = &f->file[f->n++];
    file->option = option;
    file->is_output = is_output;
    (void)snprintf(file->path, sizeof file->path, "%.*s%s", n, path, suffix);
}

static void collect(const options_t* o, files_t* f)
{
    f->n = 0;
    add(f, "--config", false, "", true, o->config, "");
    for (unsigned i = 0; i < o->n_buses; ++i) { add(f, "--bus", false, "file:", false, o->bus[i], ""); }
    add(f, "--tracker", false, "file:", false, o->tracker, "");
    add(f, "--lcm", true, "file://", false, o->lcm, "");
    add(f, "--record", true, "file:", true, o->record, "");
    add(f, "--estimate", true, "", true, o->estimate, "");
    add(f, "--estimate", true, "", true, o->estimate, ".tmp");  // where atomic_file.h writes first
    add(f, "--checkpoint", true, "", true, o->checkpoint, "");
    add(f, "--checkpoint", true, "", true, o->checkpoint, ".tmp");
}

/// liblcm would wait for the pipe's reader, where no signal is heard.
static int refuse_pipe(const char* url)
{
    struct stat info;
    char path[PATH_MAX];
    if (strncmp(url, "file://", strlen("file://")) != 0) { return 0; }
    (void)snprintf(path, sizeof path, "%.*s", (int)strcspn(url + strlen("file://"), "?"), url + strlen("file://"));
    if (stat(path, &info) != 0 || !S_ISFIFO(info.st_mode)) { return 0; }
    return daemon_refuse("--lcm", "a pipe can be written with --record only");
}

int output_files_check(const daemon_t* d)
{
    static files_t f;
    char reason[REASON_SIZE];
    collect(&d->option, &f);
    for (unsigned i = 0; i < f.n; ++i) {
        for (unsigned k = 0; k < f.n; ++k) {
            const file_t *output = &f.file[i], *other = &f.file[k];
            if (!output->is_output || i == k || !ipe_file_is_same(output->path, other->path)) { continue; }
            (void)snprintf(reason, sizeof reason, "%.300s is the file of %s; name another", output->path,
                           other->option);
            return daemon_refuse(output->option, reason);
        }
    }
    return refuse_pipe(d->option.lcm);
}
