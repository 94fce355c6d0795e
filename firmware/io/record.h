// SPDX-License-Identifier: Apache-2.0
/// LCM event log. Messages go into a bounded queue, and one thread writes them; every lost message is counted.
///
/// Per message, big-endian: sync 0xEDA1DA01 u32, number u64, time u64 [us], channel length u32, data length u32,
/// channel, data; lcm-logplayer and lcm's EventLog read it. The number counts every message pushed, so a step of more
/// than one is a loss. The time is the message's data time. Each file begins with the configuration; a message on its
/// channel is the configuration from there on.
/// Every 256 KB and half second, and at the end, a message on IPE_RECORD_CHECK_CHANNEL follows: its own number u64 and time
/// u64, the place u64 in the file of the first byte that it covers, and the CRC-32 u32 (IEEE 802.3) of the bytes from there
/// to itself. `inertiactl` finds damage by it; for other tools it is one more channel.
/// Written messages are on the disk half a second later (fdatasync), the file's name before them, and a failed write is cut
/// back to the last whole message, so after a power cut or on a full disk only the end is missing.
/// A file that is there already is not overwritten but moved to PATH.1, PATH.2, ...; so is one that is full (rotation).
/// The file is locked (flock): a second recorder is refused. A pipe that nobody reads is given up 2 s after close.
/// 8.4 MB, caller-allocated, no heap after open. One thread calls; it waits for the disk only with options.waits.
#ifndef IPE_RECORD_H
#define IPE_RECORD_H

#include "config_file.h"

#include <limits.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
    IPE_RECORD_QUEUE = 8 << 20,        ///< bytes; a power of two
    IPE_RECORD_MESSAGE_MAX = 1 << 18,  ///< bytes of one message with its channel
    IPE_RECORD_HEADER = 28,            ///< bytes before the channel
    IPE_RECORD_NAME_MAX = 64,
    IPE_RECORD_CHECK = 28,             ///< bytes of the message on the check channel
};

#define IPE_RECORD_CHECK_CHANNEL "INERTIAD_CHECK"

typedef struct {
    const char* path;             ///< kept by pointer
    const char* config_channel;   ///< kept by pointer
    const uint8_t* config_bytes;  ///< first message of each file, at most IPE_CONFIG_FILE_MAX bytes; copied
    size_t n_config_bytes;
    uint64_t rotate_bytes;        ///< begin a new file before one grows longer; 0: never
    int64_t rotate_us;            ///< ... before it spans more data time; 0: never
    bool waits;                   ///< when the queue is full wait for the disk instead of dropping: for replays
    int stop_fd;                  ///< ... until this is readable, such as a signalfd; 0: for ever
} ipe_record_options_t;

typedef struct ipe_record {
    ipe_record_options_t option;
    pthread_t thread;
    sem_t wake;                   ///< of the writer, before its time
    atomic_bool is_closing;
    _Atomic uint64_t head, tail;  ///< bytes ever put in by the caller, taken out by the writer
    uint64_t number;              ///< of the next message, from 1

    int fd;                       ///< below: the writer's
    uint8_t config[IPE_CONFIG_FILE_MAX];
    size_t n_config;
    bool has_begun;               ///< the file holds its configuration
    bool is_unsynced;
    uint64_t last_number;         ///< of the last message written
    uint64_t file_bytes;
    uint64_t checked_bytes;       ///< of them, before the first one that no check covers yet
    uint32_t crc;                 ///< of the rest, as ipe_crc_extend() takes it
    int64_t last_us;              ///< time of the last message written
    int64_t file_begin_us;        ///< time of its first message
    int64_t synced_ns;            ///< CLOCK_MONOTONIC
    unsigned n_files;             ///< number last given to a file moved aside
    int64_t give_up_ns;           ///< CLOCK_MONOTONIC at which a pipe that nobody reads is given up; 0: not closing yet

    _Atomic uint64_t n_messages;  ///< messages written, without configurations
    _Atomic uint64_t n_bytes;     ///< bytes written
    _Atomic uint64_t n_full;      ///< messages dropped: queue full, or longer than IPE_RECORD_MESSAGE_MAX
    _Atomic uint64_t n_unwritten;  ///< messages dropped: the disk refused them
    _Atomic uint64_t n_errors;     ///< failed writes, syncs and rotations
    atomic_int error;              ///< errno of the last
    uint8_t queue[IPE_RECORD_QUEUE];
} ipe_record_t;

/// Write the header of a message: see above. t_us: data time, us; n: bytes of data.
void ipe_record_put_header(uint8_t header[IPE_RECORD_HEADER], uint64_t number, int64_t t_us, size_t n_channel,
                           size_t n);

/// Open the file, move an earlier one aside, start the writer. Signals should be blocked: the thread inherits that.
///
///   message  out  one line on failure; size bytes, always terminated
///
/// 0 or -1.
int ipe_record_open(ipe_record_t* r, const ipe_record_options_t* options, char* message, size_t size);

/// Push one message of data time t_ns: n bytes for a channel of 1 to 63 characters. Copies; a full queue drops it,
/// counted, or with options.waits waits for the writer.
void ipe_record_push(ipe_record_t* r, const char* channel, int64_t t_ns, const uint8_t* data, size_t n);

/// Write what is in the queue, sync, end the thread, close. 0, or -1: messages were lost since open.
int ipe_record_close(ipe_record_t* r);

/// Messages lost since open, for any reason.
uint64_t ipe_record_lost(const ipe_record_t* r);

/// A counter by index: its cause, and its value. NULL past the last. The names are stable.
const char* ipe_record_counter(const ipe_record_t* r, unsigned index, uint64_t* value);

#endif
