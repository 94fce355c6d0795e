// SPDX-License-Identifier: Apache-2.0
/// All state of the daemon, and what its parts share. One static of this type in inertiad.c; nothing is allocated.
///
///   options -> open -> loop:  flow     frames and positions -> pipeline -> LCM and record
///                             monitor  once a second: interfaces, record, checkpoint
///                             health   counters
///           -> close
#ifndef IPE_DAEMON_H
#define IPE_DAEMON_H

#include "checkpoint.h"
#include "config_file.h"
#include "counters.h"
#include "options.h"
#include "pipeline.h"
#include "publish.h"
#include "record.h"
#include "replay.h"
#include "source_socketcan.h"

#define NS_PER_S INT64_C(1000000000)

typedef struct {
    options_t option;
    ipe_config_t config;
    uint8_t config_bytes[IPE_CONFIG_FILE_MAX];
    size_t n_config_bytes;  ///< without the CRC

    ipe_replay_t replay;
    ipe_source_socketcan_t interface[IPE_BUSES_MAX];
    unsigned n_interfaces;  ///< 0: recorded input
    ipe_pipeline_t pipeline;
    ipe_publish_t publisher;
    bool is_recording;
    ipe_record_t recorder;
    ipe_checkpoint_t checkpoint;
    ipe_counters_t counters;  ///< as last counted

    int epoll_fd, signal_fd, second_fd, pace_fd;
    bool is_done;
    bool is_replay_runnable;
    int64_t data_ns;              ///< host time of the newest frame or position, 0: none yet
    int64_t first_row_ns, last_row_ns;
    int64_t health_due_ns;        ///< data time of the next HEALTH
    bool was_health_sent;         ///< since the last tick

    int n_ticks;                  ///< since the last checkpoint
    uint64_t n_changes_reported;  ///< payload changes
    uint64_t n_lost_reported;     ///< messages that the record lacks
    bool is_losing_record;        ///< since a tick ago
    bool is_damage_reported;
    bool interface_was_up[IPE_BUSES_MAX];
} daemon_t;

/// Open everything that the options name, in the order of the data. 0, or -1: said why.
int daemon_open(daemon_t* d);

/// Let out what waits, tell the world a last time, write the result, print the summary. False: something that was asked
/// for is not written, said why.
bool daemon_close(daemon_t* d);

/// Say what is wrong with an option's value. -1.
int daemon_refuse(const char* name, const char* reason);

#endif
