// SPDX-License-Identifier: Apache-2.0
/// A sensor that repeats one value while the platform moves has failed, however fresh its stamps are.
///
/// A force channel, all of a position or all of an IMU sample is stuck when it has not changed by a bit for 0.25 s and 8
/// samples although another sensor saw the platform move:
///   force      the specific force turned or changed by 0.2 m/s2, or by what 4 steps of the signal's resolution answer to
///   position   the specific force's size changed by 0.2 m/s2
///   IMU        the forces changed by 5 %, all together
/// each as a mean over some 0.2 s, which vibration does not move. At rest nothing is stuck: there a coarse signal may
/// repeat for long. Sooner, after 8 samples and four times as many as it ever repeated, a force channel is stuck whose noise is
/// over four steps of its resolution and which repeats while at least half of the others change.
/// Until it reads more, a sample of that very value is stuck at once (a saturated sensor comes back to it), as is one at the end of
/// its signal's range.
/// Up to two force channels, fewer than half, may be stuck: the sample is used, their forces are unknown. Else it is refused.
/// 1.2 KB of state, 20 ns per sample, one thread.
#ifndef IPE_STUCK_SENSOR_H
#define IPE_STUCK_SENSOR_H

#include "config.h"
#include "types.h"

enum { IPE_STUCK_SENSOR_IMU = IPE_CABLES_MAX, IPE_STUCK_SENSOR_POSITION, IPE_STUCK_SENSOR_CHANNELS };

/// History of one channel since it last changed.
typedef struct {
    int64_t since_ns;
    int32_t n_same;
    bool has_moved;      ///< the platform, meanwhile
    float reference[3];  ///< smoothed specific force at the time, m/s2; 0: not seen yet
    float lag;           ///< lag of the smoothing then, m/s2: catching it up is no motion
} ipe_stuck_sensor_channel_t;

/// What is known of a force signal.
typedef struct {
    float before;       ///< the sample before the last
    float noise;        ///< mean of |second difference| over recent samples, N
    float resolution;   ///< smallest change seen, N
    int32_t n_seen;     ///< samples that changed, until there are enough
    int32_t n_longest;  ///< most samples that it was the same for while well
    float stuck_at;     ///< value at which it was stuck last,
    bool was_stuck;     ///< if it ever was
    double range_end;   ///< value from which on it is saturated
} ipe_stuck_sensor_force_t;

typedef struct {
    int n_cables, n_imu;
    float threshold[IPE_CABLES_MAX];    ///< m/s2
    float f[IPE_CABLES_MAX], imu[10], position[3];
    float acc[3];                       ///< specific force, smoothed
    int64_t acc_ns, acc_since_ns;       ///< its last sample and its first
    float f_reference[IPE_CABLES_MAX];  ///< forces when the IMU last changed, N; 0: not seen yet
    ipe_stuck_sensor_channel_t channel[IPE_STUCK_SENSOR_CHANNELS];
    ipe_stuck_sensor_force_t force[IPE_CABLES_MAX];
    uint32_t unknown;                       ///< cables whose force the last sample does not tell, bit i: cable i

    uint64_t n_stuck[IPE_SENSOR_COUNT];     ///< samples refused
    uint64_t n_unknown;                     ///< samples of force used with a force unknown
    uint64_t n_unknown_of[IPE_CABLES_MAX];  ///< of these, each cable's
} ipe_stuck_sensor_t;

void ipe_stuck_sensor_init(ipe_stuck_sensor_t* k, const ipe_config_t* config);

/// Look at one sample: stamp [ns], value as in ipe_reading_t. True, counted: it is stuck, do not use it. Else, for a sample of
/// force, k->unknown names the cables whose value is none.
bool ipe_stuck_sensor_push(ipe_stuck_sensor_t* k, ipe_sensor_t sensor, int64_t t_ns, const double* value);

#endif
