// SPDX-License-Identifier: Apache-2.0
/// The daemon's messages over LCM.
///
/// out: RAW and SIGNALS in blocks of 16 ms or when full, ORDER in blocks of six RAW, ESTIMATE at the configured rate of data
/// time, HEALTH, EVENT, HOST. Channels carry a prefix, "INERTIAD_". Messages are encoded into a static buffer, so publishing
/// allocates nothing. A message that cannot be sent is counted and dropped; publishing never waits. With a recorder every
/// message goes into its queue as well, and so do the messages from others that are used (inbox.h).
/// 360 KB of state, caller-allocated, one thread. Without LCM (url "none"), recorder and simulator every call succeeds
/// and has no effect.
#ifndef IPE_PUBLISH_H
#define IPE_PUBLISH_H

#include "command.h"
#include "bus_state.h"
#include "counters.h"
#include "findings.h"
#include "histogram.h"
#include "host_facts.h"
#include "lock_step.h"
#include "message.h"
#include "pipeline.h"
#include "record.h"
#include "systematic.h"
#include "types.h"

#include "inertiad_lcm_can_frame_t.h"
#include "inertiad_lcm_counter_t.h"
#include "inertiad_lcm_order_item_t.h"
#include "inertiad_lcm_signals_row_t.h"

#include <lcm/lcm.h>

enum {
    IPE_PUBLISH_FRAMES = 512,   ///< in one RAW message
    IPE_PUBLISH_ROWS = 128,     ///< in one SIGNALS message
    IPE_PUBLISH_ITEMS = 128,    ///< in one ORDER message
    IPE_PUBLISH_BYTES = 65000,  ///< of the largest message
    IPE_PUBLISH_NAME_MAX = 64,
};

typedef enum {
    IPE_PUBLISH_RAW,
    IPE_PUBLISH_SIGNALS,
    IPE_PUBLISH_ESTIMATE,
    IPE_PUBLISH_HEALTH,
    IPE_PUBLISH_EVENT,
    IPE_PUBLISH_HOST,
    IPE_PUBLISH_ORDER,
    IPE_PUBLISH_TRACKER,  ///< in records only, as are those below
    IPE_PUBLISH_COMMAND,
    IPE_PUBLISH_CONFIG,
    IPE_PUBLISH_ANSWER,  ///< to a simulator only: the end of an answer
    IPE_PUBLISH_COUNT
} ipe_publish_channel_t;

enum { IPE_LATENCIES_MAX = 2 };

/// Content of HEALTH. Pointers are used during the call only.
typedef struct {
    const ipe_counters_t* counters;
    double age[IPE_SENSOR_COUNT];  ///< s since the last imu, force, position sample, -1: none
    bool is_frozen;
    unsigned n_buses;
    struct {
        const char* name;
        bool is_up;
        ipe_bus_condition_t condition;
    } bus[IPE_BUSES_MAX];
    unsigned n_latencies;
    struct {
        const char* name;
        const ipe_histogram_t* histogram;
    } latency[IPE_LATENCIES_MAX];
} ipe_health_t;

typedef struct {
    lcm_t* lcm;                           ///< NULL: off
    ipe_record_t* record;                 ///< NULL: off
    ipe_lock_step_t* lock_step;           ///< NULL: off
    char channel[IPE_PUBLISH_COUNT][IPE_PUBLISH_NAME_MAX];
    int64_t sequence[IPE_PUBLISH_COUNT];  ///< of the next message
    int n_cables;
    int64_t estimate_period_ns, estimate_due_ns;
    bool has_estimate_due;
    int8_t verdict;  ///< of the estimates to come, as in estimate_t.lcm
    ipe_message_limit_t limit;

    char systematic_name[IPE_XI_MAX][IPE_SYSTEMATIC_NAME_MAX];
    char* systematic_names[IPE_XI_MAX];  ///< pointers to them, as the generated encoder takes them

    int n_frames, n_rows, n_items;       ///< in the open blocks
    inertiad_lcm_can_frame_t frame[IPE_PUBLISH_FRAMES];
    uint8_t frame_data[IPE_PUBLISH_FRAMES][IPE_DATA_MAX];
    inertiad_lcm_signals_row_t row[IPE_PUBLISH_ROWS];
    double row_f[IPE_PUBLISH_ROWS][IPE_CABLES_MAX];
    inertiad_lcm_order_item_t item[IPE_PUBLISH_ITEMS];
    int64_t order_ns;  ///< host time of the newest item's use
    inertiad_lcm_counter_t counter[IPE_COUNTERS_MAX];
    int64_t bucket[IPE_LATENCIES_MAX][IPE_HISTOGRAM_BUCKETS];
    uint8_t bytes[IPE_PUBLISH_BYTES];

    uint64_t n_input_dropped;  ///< frames and rows lost so far, as last given by the caller
    uint64_t n_messages;       ///< messages sent
    uint64_t n_failed;         ///< messages liblcm refused to send
    uint64_t n_frames_failed;  ///< frames in RAW messages that failed
    uint64_t n_items_failed;   ///< items in ORDER messages that failed
    uint64_t n_not_finite;     ///< estimates held back: a value is NaN or Inf
} ipe_publish_t;

/// 0 if channels may have this prefix: 1 to 40 letters, digits, '_', '-', '/'. Otherwise -1, and one line in message.
int ipe_publish_check_prefix(const char* prefix, char* message, size_t size);

/// Open LCM.
///
///   url      in   as lcm_create(), "none": off
///   prefix   in   of every channel, good by ipe_publish_check_prefix()
///   message  out  one line on failure, with what to do; size bytes, always terminated
///
/// 0 or -1. Allocates, inside liblcm.
int ipe_publish_open(ipe_publish_t* p, const char* url, const char* prefix, const ipe_config_t* config, char* message,
                     size_t size);

/// Let every message go into an open recorder as well; NULL: no longer.
void ipe_publish_record(ipe_publish_t* p, ipe_record_t* record);

/// Let every ESTIMATE and EVENT go into the answers to a simulator as well.
void ipe_publish_lock_step(ipe_publish_t* p, ipe_lock_step_t* lock_step);

/// End an answer and write it. False: nobody reads it.
bool ipe_publish_lock_step_answer(ipe_publish_t* p, int64_t t_ns);

/// Record a message of n bytes that was received from another program at host time t_ns; it is not sent.
void ipe_publish_received(ipe_publish_t* p, ipe_publish_channel_t channel, int64_t t_ns, const uint8_t* data, size_t n);

/// Add a frame to the open RAW block; sends it when 16 ms are full.
void ipe_publish_frame(ipe_publish_t* p, const ipe_frame_t* frame);

/// Add to ORDER what is used now, between the last frame and the next: kind, t_ns and value [3] as in order_item_t.lcm;
/// value NULL: zeros.
void ipe_publish_order(ipe_publish_t* p, int kind, int64_t t_ns, const double* value);

/// The same of an announced payload that is expected from host time now_ns on, three of its numbers in each item.
void ipe_publish_expectation(ipe_publish_t* p, int64_t now_ns, const ipe_expectation_t* expectation);

/// The verdict of the estimates to come; before the first call they are not judged.
void ipe_publish_verdict(ipe_publish_t* p, ipe_severity_t verdict);

/// Add a row to the open SIGNALS block, which is sent when 16 ms are full; then send ESTIMATE if it is due at the row's
/// time. An estimate with a value that is not finite is never sent.
///
///   n_dropped  in  frames and rows lost so far, all causes
///
/// True: ESTIMATE was sent.
bool ipe_publish_row(ipe_publish_t* p, const ipe_row_t* row, const ipe_estimate_t* estimate, uint64_t n_dropped);

/// Record a position that did not come over LCM, as TRACKER; it is not sent.
void ipe_publish_position(ipe_publish_t* p, int64_t t_ns, const double position[3]);

/// From now on rows have this configuration's cables and estimates its names and rate; the same rate keeps
/// its phase, as after a tare. Sends the open blocks.
void ipe_publish_configure(ipe_publish_t* p, const ipe_config_t* config);

/// Send HEALTH.
void ipe_publish_health(ipe_publish_t* p, int64_t t_ns, const ipe_health_t* health);

/// Send HOST: facts of the machine, read at the start.
void ipe_publish_host(ipe_publish_t* p, int64_t t_ns, const ipe_host_facts_t* facts);

/// Send CONFIG, n encoded bytes of the configuration in use, so that a listener that comes late can draw the robot. It is
/// not recorded: the record has it at its start and at each change.
void ipe_publish_config(ipe_publish_t* p, const uint8_t* data, size_t n);

/// Send EVENT of kind NEWS: stage or bus, and one line of text.
void ipe_publish_event(ipe_publish_t* p, int64_t t_ns, const char* source, const char* text);

/// Send EVENT as the answer to a command, DONE or REFUSED; text is one line: the change, or the reason.
void ipe_publish_answer(ipe_publish_t* p, int64_t t_ns, const ipe_command_t* command, bool is_done, const char* text);

/// Send the blocks that are open.
void ipe_publish_flush(ipe_publish_t* p);

/// Send the open blocks and the final estimate, whether due or not. n_dropped as in ipe_publish_row().
void ipe_publish_last(ipe_publish_t* p, const ipe_estimate_t* estimate, uint64_t n_dropped);

/// Close LCM; the recorder stays open.
void ipe_publish_close(ipe_publish_t* p);

/// A counter by index: its cause, and its value. NULL past the last. The names are stable.
const char* ipe_publish_counter(const ipe_publish_t* p, unsigned index, uint64_t* value);

#endif
