// SPDX-License-Identifier: Apache-2.0
/// All state of the daemon, and the functions that every part may call. One static of this type in inertiad.c; nothing is
/// allocated. Parts call and include only parts further right or below:
///
///   inertiad -> options
///            -> open -> output_files           what may not be overwritten
///                    -> loop                   waits for input and calls one of
///            -> loop -> data_path              frames and positions -> pipeline -> LCM and record
///                    -> command_handler        commands; uses data_path
///                    -> monitor                buses, losses, clock, sensors; once a second HEALTH, watchdog, checkpoint
///            -> close                          last rows, result files, summary
///   data_path -> monitor -> health -> daemon   counters; time, refusals, gyro bias
#ifndef IPE_DAEMON_H
#define IPE_DAEMON_H

#include "checkpoint.h"
#include "command_guard.h"
#include "config_file.h"
#include "counters.h"
#include "host_clock.h"
#include "inbox.h"
#include "notify.h"
#include "options.h"
#include "pipeline.h"
#include "presence.h"
#include "publish.h"
#include "record.h"
#include "replay.h"
#include "rest_detector.h"
#include "source_socketcan.h"
#include "unbound.h"

#define NS_PER_S INT64_C(1000000000)

/// Losses of one kind, counted elsewhere.
typedef struct {
    uint64_t n_before;  ///< lost when the present loss began
    uint64_t n_last;    ///< at the last look
    bool is_losing;
} loss_t;

/// Counts of earlier pipelines and from before a reset: published counters never decrease.
typedef struct {
    uint64_t counter[IPE_COUNTERS_MAX];
    uint64_t n_rejected, n_incomplete;
} health_carried_t;

// NOLINTNEXTLINE(clang-analyzer-optin.performance.Padding): in the order of the data, once per process
typedef struct {
    options_t option;
    ipe_config_t config;
    uint8_t config_bytes[IPE_CONFIG_FILE_MAX];
    size_t n_config_bytes;  ///< without the CRC

    ipe_replay_t replay;
    ipe_source_socketcan_t interface[IPE_BUSES_MAX];
    unsigned n_interfaces;              ///< 0: recorded input
    ipe_inbox_t inbox;
    int64_t listening_ns;               ///< ipe_host_clock_now() when the inbox was opened
    ipe_command_guard_t command_guard;
    ipe_message_limit_t command_limit;  ///< of refusals on stderr
    ipe_pipeline_t pipelines[2];
    ipe_pipeline_t* pipeline;           ///< the one in use; the other is where a new configuration is tried
    ipe_announcement_t announcement;    ///< used by the pipeline while a payload is expected
    ipe_rest_detector_t rest;
    ipe_publish_t publisher;
    bool is_recording;
    ipe_record_t recorder;
    ipe_checkpoint_t checkpoint;
    ipe_counters_t counters;  ///< as last counted

    ipe_notify_t notify;
    int epoll_fd, signal_fd, second_fd, pace_fd;
    int64_t collect_ns;  ///< pause before frames are read, so that several are read at once; 0: none
    bool is_done;
    bool can_retry;      ///< the start was refused for a reason that may go away
    bool is_replay_runnable;
    ipe_host_clock_t clock;
    ipe_histogram_t decoded, estimated;
    ipe_unbound_t unbound;  ///< while no frame was decoded
    int64_t data_ns;        ///< host time of the newest frame, 0: none yet
    int64_t first_row_ns, last_row_ns;
    int64_t health_due_ns;  ///< data time of the next HEALTH
    bool was_health_sent;   ///< since the last tick

    health_carried_t carried;
    uint64_t n_commands_done;      ///< commands carried out
    uint64_t n_commands_refused;   ///< commands refused; the answer says why
    uint64_t n_commands_old;       ///< of the refused commands: not stamped with the present time, or before the start
    uint64_t n_commands_repeated;  ///< of the refused commands: carried out before
    uint64_t n_positions_unused;   ///< TRACKER messages not used: the position comes from elsewhere
    uint64_t n_frames_last;        ///< taken in until the last tick
    uint64_t n_frames_tick;        ///< of them in the second before it
    ipe_bus_state_t bus_state[IPE_BUSES_MAX];
    unsigned n_state_events[IPE_BUSES_MAX];                                         ///< since the last tick
    loss_t bus_loss[IPE_BUSES_MAX], record_loss, lcm_loss;
    loss_t foreign_commands, foreign_positions, other_positions, unused_positions;  ///< messages refused on arrival
    loss_t late[IPE_SENSOR_COUNT];                                                  ///< samples too late for the rows
    loss_t unknown_force[IPE_CABLES_MAX];        ///< samples of force that do not tell a cable's
    ipe_presence_t presence[IPE_SENSOR_COUNT];
    uint64_t n_sensor_frames[IPE_SENSOR_COUNT];  ///< frames with its values, at the last check
    int64_t presence_due_ns;                     ///< data time of the next check of the sensors
    ipe_host_facts_t facts;                      ///< read at the start
    int n_facts_ticks;                           ///< until HOST is sent again
    int n_ticks;                                 ///< since the last checkpoint
    uint64_t n_changes_reported;                 ///< payload changes
    ipe_announcement_state_t announcement_reported;
    double force_delay_reported;                 ///< s
    bool is_misfit_reported;
    bool is_widening_reported;
    bool is_damage_reported;
    bool interface_was_up[IPE_BUSES_MAX];
} daemon_t;

/// Host time now [ns]: of the clock for interfaces, the newest frame's stamp for recorded input.
int64_t daemon_now(const daemon_t* d);

/// Host time [ns] of the sensor's newest sample; 0: none yet.
int64_t daemon_newest_sample(const daemon_t* d, ipe_sensor_t sensor);

/// True if the open buses and LCM suffice for this configuration: every signal's bus, the position. Otherwise the reason is
/// in text[size].
bool daemon_can_use(const daemon_t* d, const ipe_config_t* config, char* text, size_t size);

/// Put a gyro bias [3], I axes, rad/s, into the configuration in use and its compiled bytes.
void daemon_set_gyro_bias(daemon_t* d, const double bias[3]);

/// Print "name: reason" to stderr. -1.
int daemon_refuse(const char* name, const char* reason);

#endif
