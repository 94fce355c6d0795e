// SPDX-License-Identifier: Apache-2.0
/// CAN frames and tracker positions in, the estimated inertial parameters out: the sequence of the stages, nothing else.
///
///   frame --> decode --> sample_assembler --> stuck_sensor --> clock, sample_timing --> align --> motion --> wrench
///         --> window --> estimator
///
/// All state is in ipe_pipeline_t, which the caller allocates (one static in the daemon). One thread per pipeline.
#ifndef IPE_PIPELINE_H
#define IPE_PIPELINE_H

#include "align.h"
#include "announcement.h"
#include "clock.h"
#include "config.h"
#include "decode.h"
#include "estimator.h"
#include "motion.h"
#include "sample_assembler.h"
#include "sample_timing.h"
#include "stuck_sensor.h"
#include "types.h"
#include "window.h"
#include "wrench.h"

/// What the last row has left to do.
typedef enum {
    IPE_PART_ROW = 0,  ///< nothing: the next row
    IPE_PART_WINDOW,   ///< the window that ended with it to become equations
    IPE_PART_UPDATE,   ///< rows of these to fold in
    IPE_PART_CORRECT,  ///< an estimate to publish: its first part,
    IPE_PART_PUBLISH,  ///< and the rest
} ipe_part_t;

/// Counters and state of every stage; read freely, write never.
typedef struct {
    ipe_config_t config;
    ipe_decode_t decode;
    ipe_sample_assembler_t sample_assembler[IPE_SENSOR_COUNT];
    ipe_stuck_sensor_t stuck_sensor;
    ipe_clock_t clock[IPE_SENSOR_COUNT];
    ipe_sample_timing_t sample_timing[IPE_SENSOR_COUNT];
    uint64_t n_untimed[IPE_SENSOR_COUNT];  ///< steps of refused samples, which sample_timing has not seen yet
    ipe_align_t align;
    uint64_t n_unsettled;                  ///< rows refused: a clock was not settled yet
    ipe_motion_stage_t motion;
    ipe_wrench_stage_t wrench;
    ipe_window_t window;
    ipe_estimator_t estimator;
    ipe_announcement_t* announcement;   ///< the caller's, NULL: none
    uint64_t n_announced_taken;         ///< announced payloads that came as announced
    uint64_t n_announced_other;         ///< contacts after which another mass hangs than the announced one
    uint64_t n_announced_failed;        ///< contacts that were broken off
    uint64_t n_announced_missed;        ///< announced payloads that did not come in time
    bool is_of_two_bodies;              ///< an announced payload is in contact, or was before the last row
    bool is_frozen;                     ///< windows do not reach the estimator
    uint64_t n_frozen;                  ///< windows that did not reach the estimator while it was frozen
    ipe_part_t part;
    bool is_contact;                    ///< the estimate to publish is that of an announced payload's contact
    int64_t window_ns;                  ///< middle of the last window
    union {
        ipe_average_t average;          ///< while part is IPE_PART_WINDOW
        ipe_update_t update;            ///< while it is IPE_PART_UPDATE
        ipe_publication_t publication;  ///< while it is IPE_PART_PUBLISH
    };
} ipe_pipeline_t;

/// Set up every stage from a checked configuration.
///
/// IPE_OK; IPE_ERR_CONFIG with the reason in message[size] (pipeline not usable). Copies config.
ipe_status_t ipe_pipeline_init(ipe_pipeline_t* p, const ipe_config_t* config, char* message, size_t size);

/// Take in one CAN frame. Rows that become complete wait for ipe_pipeline_step().
///
/// IPE_OK           signals taken
/// IPE_IGNORED      no signal is bound to this ID (counted)
/// IPE_ERR_*        frame refused, counted by cause; nothing else changed
/// IPE_ERR_TIME     also, not counted: a stamp outside 0 .. IPE_TIME_MAX_NS
ipe_status_t ipe_pipeline_push_frame(ipe_pipeline_t* p, const ipe_frame_t* frame);

/// Take in one tracked position: host stamp [ns], position [3] in W, m.
///
/// IPE_OK, or IPE_ERR_NONFINITE / IPE_ERR_TIME: refused, counted; not counted: a stamp outside 0 .. IPE_TIME_MAX_NS.
ipe_status_t ipe_pipeline_push_position(ipe_pipeline_t* p, int64_t t_ns, const double position[3]);

/// Advance by one aligned row, if one is ready. Call until IPE_NOT_READY after each push.
///
///   row       out  the aligned row, as measured
///   estimate  out  written when the row completed a window; may be NULL, the last one stays in p->estimator.estimate
///
/// IPE_OK           a row was used and it completed a window: the estimate is new
/// IPE_IGNORED      a row was used, no window ended with it
/// IPE_NOT_READY    no row ready
/// IPE_ERR_*        a row or window was refused, counted by cause
ipe_status_t ipe_pipeline_step(ipe_pipeline_t* p, ipe_row_t* row, ipe_estimate_t* estimate);

/// The same in parts, for a processor that has no threads: a part does a bounded share of the work, and frames and positions may
/// be pushed between two parts. The estimates are the same, bit by bit, as long as rows get the same samples.
///
///   row       out  written by the part that takes a row
///   estimate  out  written with IPE_OK; may be NULL
///
/// IPE_UNFINISHED: call again, the row has more to do; else as of ipe_pipeline_step(), which may also end what this began.
ipe_status_t ipe_pipeline_step_part(ipe_pipeline_t* p, ipe_row_t* row, ipe_estimate_t* estimate);

/// The input has ended: let rows out that were waiting for samples that will not come, then step as usual.
void ipe_pipeline_flush(ipe_pipeline_t* p);

/// Stop learning from the windows, or go on with it. Rows and the last estimate keep coming.
void ipe_pipeline_freeze(ipe_pipeline_t* p, bool is_frozen);

/// Forget what was learnt and start from the prior; samples, clocks and open windows stay. The counters of filter, noise
/// and change detector begin again at 0.
void ipe_pipeline_reset(ipe_pipeline_t* p);

/// Expect an announced payload. It replaces the one announced before, unless that is in contact. A reset forgets it; while the
/// pipeline is frozen it waits, and a contact that has begun by then is broken off 3 s after its begin.
///
///   a              the caller's, used until the payload has come or was missed; on the pipeline's thread, as p
///   body, from_ns  as in ipe_announcement_init()
///
/// IPE_OK; IPE_ERR_RANGE: as ipe_announcement_init(), or a payload is in contact: the reason is in message[size], nothing changed.
ipe_status_t ipe_pipeline_expect(ipe_pipeline_t* p, ipe_announcement_t* a, const double body[IPE_ANNOUNCEMENT_NUMBERS],
                                 int64_t from_ns, char* message, size_t size);

/// From the next row on use this gyro bias [3], I axes, rad/s; the open windows are thrown away.
void ipe_pipeline_set_gyro_bias(ipe_pipeline_t* p, const double bias[3]);

/// Go on with another pipeline's estimator and its gyro bias [3], I axes, rad/s; p must have the same robot, sensors and
/// priors. The open windows are thrown away; a contact of an announced payload is broken off.
void ipe_pipeline_continue(ipe_pipeline_t* p, const ipe_estimator_t* estimator, const double gyro_bias[3]);

/// True unless memory was corrupted or the code is wrong: covariance positive, state finite, indices in range.
bool ipe_pipeline_invariants_hold(const ipe_pipeline_t* p);

#endif
