// SPDX-License-Identifier: Apache-2.0
/// All sizes of the core, fixed at build time. Nothing here depends on a robot; what does is in ipe_config_t.
#ifndef IPE_DIMS_H
#define IPE_DIMS_H

/// Two profiles. The default is for Linux: 16 cables, rows wait up to 0.5 s at 2 kHz, state under 512 KiB. With
/// -DIPE_PROFILE_MICRO, for microcontrollers: 8 cables, rows wait up to 40 samples, 40 signals, state under 64 KiB.
#ifdef IPE_PROFILE_MICRO
enum {
    IPE_CABLES_MAX = 8,
    IPE_SIGNALS_MAX = 40,
    IPE_WAIT_MAX = 40,
    IPE_RING_SLACK = 34,
    IPE_SAMPLE_TIMING_HOLD = 32,
    IPE_DECODE_SLOTS = 64,
    IPE_STATE_MAX = 64 * 1024,
};
#else
enum {
    IPE_CABLES_MAX = 16,
    IPE_SIGNALS_MAX = 64,
    IPE_WAIT_MAX = 1000,
    IPE_RING_SLACK = 280,
    IPE_SAMPLE_TIMING_HOLD = 64,  ///< samples held at most until their instants are known; fewer than IPE_RING_SLACK
    IPE_DECODE_SLOTS = 256,       ///< of the hash table of messages: a power of two, more than IPE_SIGNALS_MAX
    IPE_STATE_MAX = 512 * 1024,
};
#endif

enum {
    /// IMU samples that rows may wait for max_wait, and beyond it: two periods of the slowest sensor, 80 ms at 25 Hz, and
    /// the IPE_SAMPLE_TIMING_HOLD samples whose instant is not known yet.
    IPE_RING = IPE_WAIT_MAX + IPE_RING_SLACK,

    IPE_BUSES_MAX = 8,
    IPE_DATA_MAX = 64,  ///< bytes in a CAN FD frame
    IPE_NP = 10,        ///< inertial parameters: m, h (3), J (6)
    IPE_NY = 6,         ///< equations of a window: force and moment

    IPE_XI_FIXED = 32,  ///< systematic parameters that do not depend on the cables, systematic.h
    IPE_XI_MAX = IPE_XI_FIXED + 3 * IPE_CABLES_MAX,
    IPE_PATTERNS = 2,   ///< patterns of misplaced attachments, filter_states.h
    IPE_WANDERS = 3,    ///< states of the attitude's wander
    IPE_X_FIXED = 26,   ///< IPE_XI_FIXED less two scales, the gyro bias and the low-pass, no states of the filter
    IPE_NX_MAX = IPE_NP + IPE_X_FIXED + 2 * IPE_CABLES_MAX + 3 * IPE_PATTERNS + IPE_WANDERS,  ///< states of the filter
    IPE_NU_MAX = IPE_NX_MAX * (IPE_NX_MAX - 1) / 2,  ///< elements of the unit upper triangle of P's factor

    IPE_MOTION_NP = 8,                               ///< parameters that the motion stage's errors depend on, types.h
    IPE_NOISE_LAGS = 25,       ///< windows over which residuals are taken to be correlated: 2.5 s at a window of 0.4 s
    IPE_WINDOWS_OPEN = 4,      ///< a new window every quarter of its length
    IPE_WINDOW_MEASURED = 24,  ///< intervals looked at before the sample period is believed
};

#endif
