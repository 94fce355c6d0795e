// SPDX-License-Identifier: Apache-2.0
#define _GNU_SOURCE  // sem_clockwait
#include "record.h"

#include "atomic_file.h"
#include "crc.h"
#include "lock.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

static const char CHECK_CHANNEL[] = IPE_RECORD_CHECK_CHANNEL;
enum {
    BATCH_MAX = 1 << 18,
    CHECK_EACH = 1 << 18,  // bytes
    CHECK_BYTES = IPE_RECORD_HEADER + sizeof CHECK_CHANNEL - 1 + IPE_RECORD_CHECK,
    FILES_MAX = 1000000
};
static const uint32_t SYNC = 0xEDA1DA01U;
static const int64_t NS_PER_S = 1000000000;
static const int64_t PERIOD_NS = 100000000;  // between two looks at the queue
static const int64_t SYNC_NS = 500000000;    // between two syncs
static const int64_t CLOSE_NS = 2000000000;  // for which close waits for the reader of a pipe

static_assert((IPE_RECORD_QUEUE & (IPE_RECORD_QUEUE - 1)) == 0, "positions wrap with a mask");

static int64_t monotonic_ns(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * NS_PER_S + t.tv_nsec;
}

// ---- bytes ----------------------------------------------------------------------------------------------------------

static void put(uint8_t* to, uint64_t value, int n)
{
    for (int i = n - 1; i >= 0; --i, value >>= 8) { to[i] = (uint8_t)value; }
}

static uint64_t get(const uint8_t* from, int n)
{
    uint64_t value = 0;
    for (int i = 0; i < n; ++i) { value = (value << 8) | from[i]; }
    return value;
}

void ipe_record_put_header(uint8_t header[IPE_RECORD_HEADER], uint64_t number, int64_t t_us, size_t n_channel, size_t n)
{
    put(header, SYNC, 4);
    put(header + 4, number, 8);
    put(header + 12, (uint64_t)t_us, 8);
    put(header + 20, n_channel, 4);
    put(header + 24, n, 4);
}

/// The queue from position at on, n bytes: one piece, or two where it wraps.
static int pieces(ipe_record_t* r, uint64_t at, size_t n, struct iovec piece[2])
{
    const size_t begin = (size_t)(at & (IPE_RECORD_QUEUE - 1));
    const size_t to_end = IPE_RECORD_QUEUE - begin;
    piece[0] = (struct iovec){r->queue + begin, n < to_end ? n : to_end};
    piece[1] = (struct iovec){r->queue, n - piece[0].iov_len};
    return piece[1].iov_len > 0 ? 2 : 1;
}

static uint64_t copy_in(ipe_record_t* r, uint64_t at, const void* bytes, size_t n)
{
    struct iovec piece[2];
    (void)pieces(r, at, n, piece);
    memcpy(piece[0].iov_base, bytes, piece[0].iov_len);
    memcpy(piece[1].iov_base, (const uint8_t*)bytes + piece[0].iov_len, piece[1].iov_len);
    return at + n;
}

static void copy_out(ipe_record_t* r, uint64_t at, uint8_t* bytes, size_t n)
{
    struct iovec piece[2];
    (void)pieces(r, at, n, piece);
    memcpy(bytes, piece[0].iov_base, piece[0].iov_len);
    memcpy(bytes + piece[0].iov_len, piece[1].iov_base, piece[1].iov_len);
}

// ---- the caller's side ----------------------------------------------------------------------------------------------

static bool has_room(const ipe_record_t* r, uint64_t head, size_t n)
{
    return head + n - atomic_load_explicit(&r->tail, memory_order_acquire) <= IPE_RECORD_QUEUE;
}

static bool is_stopped(const ipe_record_t* r)
{
    struct pollfd stop = {.fd = r->option.stop_fd, .events = POLLIN};
    return r->option.stop_fd > 0 && poll(&stop, 1, 0) > 0;
}

/// Until the writer has emptied the queue, or the process is to stop.
static void wait_for_room(ipe_record_t* r, uint64_t head, size_t n)
{
    const struct timespec pause = {.tv_nsec = 200000};
    while (!has_room(r, head, n) && !is_stopped(r)) {
        (void)sem_post(&r->wake);
        (void)nanosleep(&pause, NULL);
    }
}

void ipe_record_push(ipe_record_t* r, const char* channel, int64_t t_ns, const uint8_t* data, size_t n)
{
    uint8_t header[IPE_RECORD_HEADER];
    const size_t n_channel = strlen(channel);
    const size_t size = IPE_RECORD_HEADER + n_channel + n;
    const uint64_t number = r->number++;
    uint64_t head = atomic_load_explicit(&r->head, memory_order_relaxed);
    const bool fits = n <= IPE_RECORD_MESSAGE_MAX && size <= IPE_RECORD_MESSAGE_MAX;
    if (fits && r->option.waits) { wait_for_room(r, head, size); }
    if (!fits || !has_room(r, head, size)) {
        atomic_fetch_add(&r->n_full, 1);
        return;
    }
    ipe_record_put_header(header, number, t_ns / 1000, n_channel, n);
    head = copy_in(r, head, header, sizeof header);
    head = copy_in(r, head, channel, n_channel);
    head = copy_in(r, head, data, n);
    atomic_store_explicit(&r->head, head, memory_order_release);
    const uint64_t used = head - atomic_load_explicit(&r->tail, memory_order_relaxed);
    if (used >= IPE_RECORD_QUEUE / 4 && used - size < IPE_RECORD_QUEUE / 4) { (void)sem_post(&r->wake); }
}

// ---- the writer -----------------------------------------------------------------------------------------------------

static void note_error(ipe_record_t* r)
{
    atomic_store(&r->error, errno);
    atomic_fetch_add(&r->n_errors, 1);
}

/// Wait for the reader of a pipe. False with errno set: it takes too long to end.
static bool wait_for_reader(ipe_record_t* r)
{
    const int64_t now_ns = monotonic_ns();
    struct pollfd pipe = {.fd = r->fd, .events = POLLOUT};
    if (atomic_load(&r->is_closing) && r->give_up_ns == 0) { r->give_up_ns = now_ns + CLOSE_NS; }
    errno = ETIMEDOUT;
    if (r->give_up_ns != 0 && now_ns >= r->give_up_ns) { return false; }
    (void)poll(&pipe, 1, (int)(PERIOD_NS / 1000000));
    return true;
}

static bool write_all(ipe_record_t* r, struct iovec piece[2], int n_pieces)
{
    while (n_pieces > 0) {
        const ssize_t n = writev(r->fd, piece, n_pieces);
        if (n < 0 && (errno == EINTR || (errno == EAGAIN && wait_for_reader(r)))) { continue; }
        if (n < 0) { return false; }
        size_t done = (size_t)n;
        while (n_pieces > 0 && done >= piece->iov_len) {
            done -= piece->iov_len;
            ++piece, --n_pieces;
        }
        if (n_pieces > 0) { *piece = (struct iovec){(uint8_t*)piece->iov_base + done, piece->iov_len - done}; }
    }
    return true;
}

/// Append the pieces as a whole or not at all.
static bool append(ipe_record_t* r, struct iovec piece[2], int n_pieces, size_t n)
{
    uint32_t crc = r->crc;
    for (int i = 0; i < n_pieces; ++i) { crc = ipe_crc_extend(crc, piece[i].iov_base, piece[i].iov_len); }
    if (write_all(r, piece, n_pieces)) {
        r->crc = crc;
        r->file_bytes += n;
        r->is_unsynced = true;
        atomic_fetch_add(&r->n_bytes, n);
        return true;
    }
    note_error(r);
    if (ftruncate(r->fd, (off_t)r->file_bytes) == 0) { (void)lseek(r->fd, (off_t)r->file_bytes, SEEK_SET); }
    return false;
}

/// Numbered and stamped like the message before it.
static void append_check(ipe_record_t* r)
{
    uint8_t message[IPE_RECORD_HEADER + sizeof CHECK_CHANNEL + IPE_RECORD_CHECK];
    const size_t n_channel = sizeof CHECK_CHANNEL - 1;
    uint8_t* at = message + IPE_RECORD_HEADER + n_channel;
    if (r->file_bytes == r->checked_bytes) { return; }
    ipe_record_put_header(message, r->last_number, r->last_us, n_channel, IPE_RECORD_CHECK);
    memcpy(message + IPE_RECORD_HEADER, CHECK_CHANNEL, n_channel);
    put(at, r->last_number, 8);
    put(at + 8, (uint64_t)r->last_us, 8);
    put(at + 16, r->checked_bytes, 8);
    put(at + 24, r->crc, 4);
    struct iovec piece[2] = {{message, CHECK_BYTES}, {NULL, 0}};
    if (!append(r, piece, 1, CHECK_BYTES)) { return; }
    r->checked_bytes = r->file_bytes;
    r->crc = 0;
}

static void sync_file(ipe_record_t* r)
{
    r->synced_ns = monotonic_ns();
    append_check(r);
    if (!r->is_unsynced) { return; }
    r->is_unsynced = false;
    if (fdatasync(r->fd) != 0 && errno != EINVAL && errno != EROFS) { note_error(r); }  // EINVAL: a pipe, a device
}

/// The configuration, stamped like the message that follows, numbered like the one written before.
static bool begin_file(ipe_record_t* r, int64_t t_us)
{
    uint8_t start[IPE_RECORD_HEADER + IPE_RECORD_NAME_MAX];
    const ipe_record_options_t* o = &r->option;
    const size_t n_channel = strlen(o->config_channel);
    const size_t n_start = IPE_RECORD_HEADER + n_channel;
    ipe_record_put_header(start, r->last_number, t_us, n_channel, r->n_config);
    memcpy(start + IPE_RECORD_HEADER, o->config_channel, n_channel);
    struct iovec piece[2] = {{start, n_start}, {r->config, r->n_config}};
    r->file_begin_us = r->last_us = t_us;
    r->has_begun = append(r, piece, 2, n_start + r->n_config);
    return r->has_begun;
}

/// Give the file its next free number.
static bool move_aside(ipe_record_t* r)
{
    char name[PATH_MAX + 16];
    while (r->n_files < FILES_MAX) {
        (void)snprintf(name, sizeof name, "%s.%u", r->option.path, ++r->n_files);
        if (access(name, F_OK) == 0) { continue; }
        return rename(r->option.path, name) == 0 || errno == ENOENT;
    }
    errno = EMFILE;
    return false;
}

/// Emptied only once it is locked, its name synced. -1 with errno set. Never waits for the other end of a pipe, nor do writes to it.
static int open_file(const char* path)
{
    struct stat info;
    const int fd = open(path, O_WRONLY | O_CREAT | O_CLOEXEC | O_NONBLOCK, 0644);
    if (fd < 0 || fstat(fd, &info) != 0 || !S_ISREG(info.st_mode)) { return fd; }
    if (ipe_lock_descriptor(fd) == 0 && ftruncate(fd, 0) == 0) {
        ipe_atomic_file_sync_name(path);
        return fd;
    }
    const int cause = errno;
    (void)close(fd);
    errno = cause;
    return -1;
}

/// True if another process holds the record at path.
static bool is_in_use(const char* path)
{
    const int fd = open(path, O_WRONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0) { return false; }
    const bool is_held = ipe_lock_descriptor(fd) != 0 && errno == EWOULDBLOCK;
    (void)close(fd);
    return is_held;
}

/// Begin the next file; where that fails the old one goes on.
static void rotate(ipe_record_t* r)
{
    sync_file(r);
    const int fd = move_aside(r) ? open_file(r->option.path) : -1;
    r->has_begun = false;
    if (fd < 0) {
        note_error(r);
        return;
    }
    (void)close(r->fd);
    r->fd = fd;
    r->file_bytes = r->checked_bytes = 0;
    r->crc = 0;
}

/// Whole messages from tail on that go into the file at hand.
typedef struct {
    size_t n_bytes;
    uint64_t n_messages;
    int64_t t_us;          ///< of the first
    uint64_t last_number;  ///< of the last
    int64_t last_us;       ///< its time
    size_t n_config;       ///< a new configuration of so many bytes, alone, at the end of the batch; 0: none
} batch_t;

/// True if a message of time t_us that would end the file at byte end belongs into the next one.
static bool is_past_file(const ipe_record_t* r, uint64_t end, int64_t t_us)
{
    const ipe_record_options_t* o = &r->option;
    if (!r->has_begun) { return false; }
    return (o->rotate_bytes > 0 && end + CHECK_BYTES > o->rotate_bytes) ||
           (o->rotate_us > 0 && (t_us - r->file_begin_us >= o->rotate_us || t_us < r->file_begin_us - o->rotate_us));
}

/// Length of the message at position at, whose header this is, if it is a configuration; otherwise 0.
static size_t config_length(ipe_record_t* r, uint64_t at, const uint8_t header[IPE_RECORD_HEADER])
{
    uint8_t channel[IPE_RECORD_NAME_MAX];
    const size_t n_channel = (size_t)get(header + 20, 4), n = (size_t)get(header + 24, 4);
    if (n_channel != strlen(r->option.config_channel) || n > sizeof r->config) { return 0; }
    copy_out(r, at + IPE_RECORD_HEADER, channel, n_channel);
    return memcmp(channel, r->option.config_channel, n_channel) == 0 ? n : 0;
}

static batch_t next_batch(ipe_record_t* r, uint64_t tail, uint64_t head)
{
    batch_t b = {0};
    while (tail + b.n_bytes < head && b.n_bytes < BATCH_MAX) {
        uint8_t header[IPE_RECORD_HEADER];
        copy_out(r, tail + b.n_bytes, header, sizeof header);
        const size_t n = IPE_RECORD_HEADER + (size_t)get(header + 20, 4) + (size_t)get(header + 24, 4);
        const int64_t t_us = (int64_t)get(header + 12, 8);
        if (is_past_file(r, r->file_bytes + b.n_bytes + n, t_us)) {
            if (b.n_messages > 0) { return b; }
            rotate(r);
        }
        b.n_config = config_length(r, tail + b.n_bytes, header);
        if (b.n_messages == 0) { b.t_us = t_us; }
        b.last_number = get(header + 4, 8);
        b.last_us = t_us;
        b.n_bytes += n;
        b.n_messages++;
        if (!r->has_begun || b.n_config > 0) { return b; }  // the configuration comes before what follows
    }
    return b;
}

static void drain(ipe_record_t* r)
{
    const uint64_t head = atomic_load_explicit(&r->head, memory_order_acquire);
    uint64_t tail = atomic_load_explicit(&r->tail, memory_order_relaxed);
    while (tail < head) {
        struct iovec piece[2];
        const batch_t b = next_batch(r, tail, head);
        const int n_pieces = pieces(r, tail, b.n_bytes, piece);
        const bool good = (r->has_begun || begin_file(r, b.t_us)) && append(r, piece, n_pieces, b.n_bytes);
        if (good) {
            r->last_number = b.last_number;
            r->last_us = b.last_us;
        }
        if (r->file_bytes - r->checked_bytes >= CHECK_EACH) { append_check(r); }
        atomic_fetch_add(good ? &r->n_messages : &r->n_unwritten, b.n_messages);
        tail += b.n_bytes;
        if (b.n_config > 0) {
            copy_out(r, tail - b.n_config, r->config, b.n_config);
            r->n_config = b.n_config;
        }
        atomic_store_explicit(&r->tail, tail, memory_order_release);
        if (monotonic_ns() - r->synced_ns >= SYNC_NS) { sync_file(r); }
    }
}

static void* run(void* argument)
{
    ipe_record_t* r = argument;
    bool is_last = false;
    while (!is_last) {
        const int64_t due_ns = monotonic_ns() + PERIOD_NS;
        const struct timespec due = {.tv_sec = due_ns / NS_PER_S, .tv_nsec = due_ns % NS_PER_S};
        (void)sem_clockwait(&r->wake, CLOCK_MONOTONIC, &due);
        is_last = atomic_load(&r->is_closing);
        drain(r);
        if (monotonic_ns() - r->synced_ns >= SYNC_NS) { sync_file(r); }
    }
    if (!r->has_begun) { (void)begin_file(r, 0); }
    sync_file(r);
    return NULL;
}

// ---- open and close -------------------------------------------------------------------------------------------------

static int fail(const ipe_record_t* r, const char* what, int cause, char* message, size_t size)
{
    const char* reason = cause == EWOULDBLOCK ? "another inertiad writes it; name another file"
                         : cause == ENXIO     ? "a pipe that nobody reads"
                                              : strerror(cause);
    (void)snprintf(message, size, "%s: %s: %s", r->option.path, what, reason);
    return -1;
}

int ipe_record_open(ipe_record_t* r, const ipe_record_options_t* options, char* message, size_t size)
{
    struct stat info;
    memset(r, 0, offsetof(ipe_record_t, queue));
    r->option = *options;
    r->number = 1;
    r->fd = -1;
    r->synced_ns = monotonic_ns();
    assert(strlen(options->config_channel) < IPE_RECORD_NAME_MAX && options->n_config_bytes <= sizeof r->config);
    memcpy(r->config, options->config_bytes, options->n_config_bytes);
    r->n_config = options->n_config_bytes;
    if (strlen(options->path) >= PATH_MAX) { return fail(r, "cannot write", ENAMETOOLONG, message, size); }
    const bool is_there = stat(options->path, &info) == 0;
    const bool is_file = is_there && S_ISREG(info.st_mode);
    if (is_file && is_in_use(options->path)) { return fail(r, "cannot write", EWOULDBLOCK, message, size); }
    if (is_file && info.st_size > 0 && !move_aside(r)) {
        return fail(r, "cannot move the earlier record aside", errno, message, size);
    }
    r->fd = open_file(options->path);
    if (r->fd < 0) { return fail(r, "cannot write", errno, message, size); }
    (void)sem_init(&r->wake, 0, 0);
    const int cause = pthread_create(&r->thread, NULL, run, r);
    if (cause == 0) { return 0; }
    (void)close(r->fd);
    return fail(r, "cannot start the writer", cause, message, size);
}

int ipe_record_close(ipe_record_t* r)
{
    atomic_store(&r->is_closing, true);
    (void)sem_post(&r->wake);
    (void)pthread_join(r->thread, NULL);
    (void)sem_destroy(&r->wake);
    (void)close(r->fd);
    r->fd = -1;
    return ipe_record_lost(r) == 0 ? 0 : -1;
}

uint64_t ipe_record_lost(const ipe_record_t* r)
{
    return atomic_load(&r->n_full) + atomic_load(&r->n_unwritten);
}

const char* ipe_record_counter(const ipe_record_t* r, unsigned index, uint64_t* value)
{
    const struct {
        const char* cause;
        uint64_t value;
    } counter[] = {
        {"messages", atomic_load(&r->n_messages)},
        {"bytes", atomic_load(&r->n_bytes)},
        {"dropped", ipe_record_lost(r)},
        {"errors", atomic_load(&r->n_errors)},
    };
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].cause;
}
