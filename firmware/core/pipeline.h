// SPDX-License-Identifier: Apache-2.0
/// CAN frames and tracker positions in, the ten inertial parameters out.
///
///   frame --> decode --> group --> stuck --> clock, pace --> align --> wrench --> window --> still, regressor, systematic, states
///         --> noise, rls --> attenuation, body, consistency
///
/// All state is in ipe_pipeline_t, which the caller allocates (one static in the daemon). One thread per pipeline.
#ifndef IPE_PIPELINE_H
#define IPE_PIPELINE_H

#include "align.h"
#include "eiv_correction.h"
#include "body.h"
#include "clock.h"
#include "config.h"
#include "decode.h"
#include "change_detector.h"
#include "sample_assembler.h"
#include "noise.h"
#include "sample_timing.h"
#include "rls.h"
#include "filter_states.h"
#include "pose_dwell.h"
#include "stuck_sensor.h"
#include "types.h"
#include "window.h"
#include "wrench.h"

/// What is known about the platform. P: platform frame, C: centre of gravity; inertia xx yy zz yz xz xy, matrix entries.
typedef struct {
    int64_t t_ns;                          ///< middle of the last window used
    uint64_t n_windows, n_rows;            ///< used so far
    ipe_body_t body;                       ///< mass, CoG, inertia about C, with standard deviations
    double theta[IPE_NP];                  ///< m, h, J about P
    double covariance[IPE_NP][IPE_NP];     ///< of theta
    int n_systematic;                      ///< systematic parameters carried, see systematic.h
    double systematic[IPE_XI_FILTER_MAX];  ///< correction to the configured calibration
    double systematic_std[IPE_XI_FILTER_MAX];
    bool observable[IPE_NP];               ///< of m, cog, inertia_cog: sigma at most half the prior's
    bool consistent;     ///< a body that can exist; false: theta and body are the nearest one that can
    double distance;     ///< Mahalanobis distance squared to it, 0 if consistent
    double nis;          ///< normalised innovation squared of the last window
    uint64_t n_changes;  ///< payload changes noticed so far
} ipe_estimate_t;

/// What was learnt from the data: kept by a checkpoint, and when settings change that do not touch it.
typedef struct {
    ipe_filter_states_t states;
    ipe_rls_t rls;
    ipe_noise_t noise;
    ipe_eiv_correction_t attenuation;
    ipe_change_detector_t detect;
    double gyro_bias[3];  ///< as configured or tared, I axes, rad/s
    uint64_t n_excited, n_rows, n_refused;
    ipe_estimate_t estimate;
} ipe_learnt_t;

/// Counters and state of every stage; read freely, write never.
typedef struct {
    ipe_config_t config;
    ipe_decode_t decode;
    ipe_sample_assembler_t group[IPE_SENSOR_COUNT];
    ipe_clock_t clock[IPE_SENSOR_COUNT];
    ipe_sample_timing_t pace[IPE_SENSOR_COUNT];
    uint64_t n_unpaced[IPE_SENSOR_COUNT];  ///< steps of refused samples, which the pace did not see yet
    ipe_stuck_sensor_t stuck;
    ipe_align_t align;
    ipe_wrench_stage_t wrench;
    ipe_window_t window;
    ipe_filter_states_t states;
    ipe_rls_t rls;
    ipe_noise_t noise;
    ipe_eiv_correction_t attenuation;
    ipe_change_detector_t detect;
    ipe_pose_dwell_t still;
    uint64_t n_excited;    ///< windows not at rest
    ipe_estimate_t estimate;
    uint64_t n_unsettled;  ///< rows refused: a clock was not known well yet
    uint64_t n_rows;       ///< aligned rows that entered the window
    uint64_t n_refused;    ///< estimates not published because a value was not finite
    bool is_frozen;        ///< windows are not learnt from
    uint64_t n_frozen;     ///< windows that were not
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
ipe_status_t ipe_pipeline_push_frame(ipe_pipeline_t* p, const ipe_frame_t* frame);

/// Take in one tracked position: host stamp [ns], position [3] in W, m.
///
/// IPE_OK, or IPE_ERR_NONFINITE / IPE_ERR_TIME: refused, counted.
ipe_status_t ipe_pipeline_push_position(ipe_pipeline_t* p, int64_t t_ns, const double position[3]);

/// Advance by one aligned row, if one is ready. Call until IPE_NOT_READY after each push.
///
///   row       out  the aligned row, as measured
///   estimate  out  written when the row completed a window; may be NULL, the last one stays in p->estimate
///
/// IPE_OK           a row was used and it completed a window: the estimate is new
/// IPE_IGNORED      a row was used, no window ended with it
/// IPE_NOT_READY    no row ready
/// IPE_ERR_*        a row or window was refused, counted by cause
ipe_status_t ipe_pipeline_step(ipe_pipeline_t* p, ipe_row_t* row, ipe_estimate_t* estimate);

/// The input has ended: let rows out that were waiting for samples that will not come, then step as usual.
void ipe_pipeline_flush(ipe_pipeline_t* p);

/// Stop learning from the windows, or go on with it. Rows and the last estimate keep coming.
void ipe_pipeline_freeze(ipe_pipeline_t* p, bool is_frozen);

/// Forget what was learnt and start from the prior; samples, clocks and open windows stay. The filter's, the noise's and
/// the detector's counters begin again at 0.
void ipe_pipeline_reset(ipe_pipeline_t* p);

/// From the next row on use this gyro bias [3], I axes, rad/s; the open windows are thrown away.
void ipe_pipeline_set_gyro_bias(ipe_pipeline_t* p, const double bias[3]);

/// Copy what was learnt so far, and go on from such a copy: p must have the same robot, sensors and priors.
void ipe_pipeline_learnt(const ipe_pipeline_t* p, ipe_learnt_t* learnt);
void ipe_pipeline_continue(ipe_pipeline_t* p, const ipe_learnt_t* learnt);

/// A counter of the pipeline by index: "stage.cause" and its value. NULL past the last. The names are stable.
const char* ipe_pipeline_counter(const ipe_pipeline_t* p, unsigned index, uint64_t* value);

/// True unless memory was corrupted or the code is wrong: covariance positive, state finite, indices in range.
bool ipe_pipeline_invariants_hold(const ipe_pipeline_t* p);

#endif
