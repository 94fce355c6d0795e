// SPDX-License-Identifier: Apache-2.0
/// LD_PRELOAD: the power fails in the middle of a program's writing.
///
/// It watches the files right in folder $POWER_LOSS_FOLDER and counts the calls that change or sync them. The call number
/// $POWER_LOSS_AT is the last: it does not happen or, with $POWER_LOSS_HALF, a write puts half of its bytes down; then the
/// process ends with status 77. Folder $POWER_LOSS_DISK shows what a disk may hold then:
///   ID.synced   content of file ID when it was last synced; not there: it never was
///   ID.last     content of file ID when its last name went away
///   names       lines "synced NAME ID", names when their folder was last synced, and "kept NAME ID", names at the end
///   calls       the number of calls, written also when the program ends by itself
/// What is there at the start counts as synced. A file's content and its name are synced apart, as fsync(2) says. The real
/// disk is not waited for.
#ifndef _GNU_SOURCE
#define _GNU_SOURCE  // RTLD_NEXT
#endif
#include <dlfcn.h>
#include <dirent.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

enum { NAMES = 64, FDS = 256, STATUS = 77 };

typedef struct {
    char name[NAME_MAX + 1];
    int id;  ///< of its content, from 1; 0: no such name
} name_t;

static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static const char *folder, *disk;
static long at, n_calls;
static bool is_half;
static name_t kept[NAMES], synced[NAMES];
static int fd_id[FDS], last_id;
static bool fd_is_folder[FDS];

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

// ---- the disk ---------------------------------------------------------------------------------------------------------

static void fail(const char* what)
{
    perror(what);
    _exit(STATUS + 1);
}

/// Copy what a descriptor, or a path where that is -1, holds now to ID.suffix.
static void copy(int from_fd, const char* path, int id, const char* suffix)
{
    char name[PATH_MAX], bytes[65536], own[64];
    (void)snprintf(own, sizeof own, "/proc/self/fd/%d", from_fd);
    (void)snprintf(name, sizeof name, "%s/%d.%s", disk, id, suffix);
    const int from = REAL(open)(from_fd >= 0 ? own : path, O_RDONLY | O_CLOEXEC);
    const int to = REAL(open)(name, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    if (from < 0 || to < 0) { fail(name); }
    for (ssize_t n; (n = read(from, bytes, sizeof bytes)) > 0;) {
        if (REAL(write)(to, bytes, (size_t)n) != n) { fail(name); }
    }
    (void)REAL(close)(from);
    (void)REAL(close)(to);
}

static void write_names(FILE* file, const char* kind, const name_t* names)
{
    for (int i = 0; i < NAMES; ++i) {
        if (names[i].id != 0) { (void)fprintf(file, "%s %s %d\n", kind, names[i].name, names[i].id); }
    }
}

static void write_disk(void)
{
    char name[PATH_MAX];
    (void)snprintf(name, sizeof name, "%s/names", disk);
    FILE* file = fopen(name, "w");
    if (file == NULL) { fail(name); }
    write_names(file, "synced", synced);
    write_names(file, "kept", kept);
    (void)fclose(file);
    (void)snprintf(name, sizeof name, "%s/calls", disk);
    file = fopen(name, "w");
    if (file == NULL) { fail(name); }
    (void)fprintf(file, "%ld\n", n_calls);
    (void)fclose(file);
}

/// Count a call; true if the power fails in it.
static bool is_last_call(void)
{
    return ++n_calls == at;
}

static void lose_power(void)
{
    write_disk();
    _exit(STATUS);
}

// ---- names ------------------------------------------------------------------------------------------------------------

/// The name of a path right in the folder; NULL: it is elsewhere.
static const char* name_of(const char* path)
{
    const size_t n = strlen(folder);
    if (strncmp(path, folder, n) != 0 || path[n] != '/' || strchr(path + n + 1, '/') != NULL) { return NULL; }
    return path[n + 1] != '\0' ? path + n + 1 : NULL;
}

static name_t* find(const char* name)
{
    for (int i = 0; i < NAMES; ++i) {
        if (kept[i].id != 0 && strcmp(kept[i].name, name) == 0) { return &kept[i]; }
    }
    return NULL;
}

static void put(const char* name, int id)
{
    name_t* at_name = find(name);
    for (int i = 0; i < NAMES && at_name == NULL; ++i) {
        if (kept[i].id == 0) { at_name = &kept[i]; }
    }
    if (at_name == NULL) { fail("power_loss: too many files"); }
    (void)snprintf(at_name->name, sizeof at_name->name, "%s", name);
    at_name->id = id;
}

/// The file of this name, if there is one, is about to lose it.
static void drop(const char* path, const char* name)
{
    name_t* there = find(name);
    if (there == NULL) { return; }
    copy(-1, path, there->id, "last");
    there->id = 0;
}

static void __attribute__((constructor)) begin(void)
{
    const char* number = getenv("POWER_LOSS_AT");
    folder = getenv("POWER_LOSS_FOLDER");
    disk = getenv("POWER_LOSS_DISK");
    is_half = getenv("POWER_LOSS_HALF") != NULL;
    at = number != NULL ? strtol(number, NULL, 10) : 0;
    DIR* d = folder != NULL && disk != NULL ? opendir(folder) : NULL;
    if (d == NULL) { fail("power_loss: POWER_LOSS_FOLDER, POWER_LOSS_DISK"); }
    for (struct dirent* entry; (entry = readdir(d)) != NULL;) {
        char path[PATH_MAX];
        if (entry->d_type != DT_REG) { continue; }
        (void)snprintf(path, sizeof path, "%s/%s", folder, entry->d_name);
        put(entry->d_name, ++last_id);
        copy(-1, path, last_id, "synced");
    }
    (void)closedir(d);
    memcpy(synced, kept, sizeof kept);
}

static void __attribute__((destructor)) end(void)
{
    write_disk();
}

// ---- calls ------------------------------------------------------------------------------------------------------------

static int id_of(int fd)
{
    return fd >= 0 && fd < FDS ? fd_id[fd] : 0;
}

static int open_watched(const char* path, const char* name, int flags, mode_t mode)
{
    (void)pthread_mutex_lock(&mutex);
    const bool is_new = find(name) == NULL && (flags & O_CREAT) != 0;
    const bool changes = is_new || (flags & O_TRUNC) != 0;
    if (changes && is_last_call()) { lose_power(); }
    const int fd = REAL(open)(path, flags, mode);
    if (fd >= FDS) { fail("power_loss: too many descriptors"); }
    if (fd >= 0 && is_new) { put(name, ++last_id); }
    if (fd >= 0) { fd_id[fd] = find(name)->id; }
    (void)pthread_mutex_unlock(&mutex);
    return fd;
}

int open(const char* path, int flags, ...)
{
    va_list arguments;
    va_start(arguments, flags);
    const mode_t mode = (flags & (O_CREAT | O_TMPFILE)) != 0 ? va_arg(arguments, mode_t) : 0;
    va_end(arguments);
    const char* name = folder != NULL ? name_of(path) : NULL;
    if (name != NULL) { return open_watched(path, name, flags, mode); }
    const int fd = REAL(open)(path, flags, mode);
    const size_t n = folder != NULL ? strlen(folder) : 0;
    const bool is_it = n > 0 && strncmp(path, folder, n) == 0 && strcmp(path + n, "/") == 0;
    if (fd >= 0 && fd < FDS && (flags & O_DIRECTORY) != 0) { fd_is_folder[fd] = is_it; }
    return fd;
}

int __open_2(const char* path, int flags);
int __open_2(const char* path, int flags)
{
    return open(path, flags);
}

int close(int fd)
{
    (void)pthread_mutex_lock(&mutex);
    if (fd >= 0 && fd < FDS) { fd_id[fd] = 0, fd_is_folder[fd] = false; }
    const int result = REAL(close)(fd);
    (void)pthread_mutex_unlock(&mutex);
    return result;
}

ssize_t write(int fd, const void* bytes, size_t n)
{
    if (id_of(fd) == 0) { return REAL(write)(fd, bytes, n); }
    (void)pthread_mutex_lock(&mutex);
    if (is_last_call()) {
        if (is_half && REAL(write)(fd, bytes, n / 2) < 0) { fail("power_loss: write"); }
        lose_power();
    }
    const ssize_t result = REAL(write)(fd, bytes, n);
    (void)pthread_mutex_unlock(&mutex);
    return result;
}

ssize_t writev(int fd, const struct iovec* piece, int n_pieces)
{
    if (id_of(fd) == 0) { return REAL(writev)(fd, piece, n_pieces); }
    (void)pthread_mutex_lock(&mutex);
    if (is_last_call()) {
        const struct iovec half = {piece[0].iov_base, piece[0].iov_len / 2};
        if (is_half && REAL(writev)(fd, &half, 1) < 0) { fail("power_loss: writev"); }
        lose_power();
    }
    const ssize_t result = REAL(writev)(fd, piece, n_pieces);
    (void)pthread_mutex_unlock(&mutex);
    return result;
}

int ftruncate(int fd, off_t n)
{
    if (id_of(fd) == 0) { return REAL(ftruncate)(fd, n); }
    (void)pthread_mutex_lock(&mutex);
    if (is_last_call()) { lose_power(); }
    const int result = REAL(ftruncate)(fd, n);
    (void)pthread_mutex_unlock(&mutex);
    return result;
}

static int sync_watched(int fd, int (*sync)(int))
{
    const bool is_folder = fd >= 0 && fd < FDS && fd_is_folder[fd];
    if (id_of(fd) == 0 && !is_folder) { return sync(fd); }
    (void)pthread_mutex_lock(&mutex);
    if (is_last_call()) { lose_power(); }
    if (is_folder) {
        memcpy(synced, kept, sizeof kept);
    } else {
        copy(fd, NULL, id_of(fd), "synced");
    }
    (void)pthread_mutex_unlock(&mutex);
    return 0;
}

int fsync(int fd)
{
    return sync_watched(fd, REAL(fsync));
}

int fdatasync(int fd)
{
    return sync_watched(fd, REAL(fdatasync));
}

int rename(const char* from, const char* to)
{
    const char *from_name = name_of(from), *to_name = name_of(to);
    if (from_name == NULL || to_name == NULL) { return REAL(rename)(from, to); }
    (void)pthread_mutex_lock(&mutex);
    if (is_last_call()) { lose_power(); }
    name_t* moved = find(from_name);
    if (moved != NULL) {
        const int id = moved->id;
        drop(to, to_name);
        moved->id = 0;
        put(to_name, id);
    }
    const int result = REAL(rename)(from, to);
    (void)pthread_mutex_unlock(&mutex);
    return result;
}

int unlink(const char* path)
{
    const char* name = name_of(path);
    if (name == NULL) { return REAL(unlink)(path); }
    (void)pthread_mutex_lock(&mutex);
    if (is_last_call()) { lose_power(); }
    drop(path, name);
    const int result = REAL(unlink)(path);
    (void)pthread_mutex_unlock(&mutex);
    return result;
}
