// SPDX-License-Identifier: Apache-2.0
/// Values from several frames -> one complete sample of a sensor.
///
/// A sample of an IMU or of eight force sensors comes in several CAN frames. They belong together when they carry the
/// same sample counter; a frame that has no room for it belongs to the counter it follows, within a period. Without any
/// counter, they belong together when no value is repeated and they lie within 0.8 of the measured period.
/// A sample that stays incomplete is dropped whole and counted: values of two instants never meet in one sample.
/// 250 B of state per sensor, one thread.
#ifndef IPE_GROUP_H
#define IPE_GROUP_H

#include "config.h"
#include "decode.h"

enum { IPE_GROUP_VALUES = 16 };

/// One complete sample of a sensor.
typedef struct {
    int64_t t_ns;                    ///< host stamp of its first frame, less that frame's time on the wire
    bool has_device_time;
    double device_time;              ///< s, the sensor's own clock, wraps
    double value[IPE_GROUP_VALUES];  ///< SI, imu: acc 3, gyro 3, q 4 or rpy 3; force: f 1..m; position: x y z
} ipe_reading_t;

typedef struct {
    uint64_t required, optional;  ///< quantities as bits
    uint8_t place[IPE_Q_COUNT];   ///< index of a required quantity in ipe_reading_t.value
    uint8_t counter_quantity, time_quantity;
    bool has_counter;             ///< a counter signal is bound

    bool is_open;
    uint64_t present;
    double counter;            ///< of the open sample
    int64_t opened_ns;
    double period;             ///< s between complete samples, smoothed; 0: not known
    int64_t completed_ns;      ///< opening stamp of the last complete sample
    double completed_counter;  ///< its counter
    int n_dropped_in_a_row;    ///< many: the period is doubted and measured again
    int n_intervals;           ///< between complete samples since the period is measured
    ipe_reading_t reading;

    uint64_t n_complete;
    uint64_t n_incomplete;  ///< samples dropped: a frame or a value of them was missing
    uint64_t n_duplicate;   ///< values that repeated one of the same sample, ignored
} ipe_group_t;

/// Which quantities make a sample of this sensor, from the bound signals of config.
void ipe_group_init(ipe_group_t* g, ipe_sensor_t sensor, const ipe_config_t* config);

/// Take the values of one frame that belong to this sensor.
///
/// IPE_OK         reading is complete
/// IPE_NOT_READY  more frames needed
/// IPE_IGNORED    nothing in it for this sensor
ipe_status_t ipe_group_push(ipe_group_t* g, const ipe_sample_t* sample, ipe_reading_t* reading);

#endif
