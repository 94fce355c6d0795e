// SPDX-License-Identifier: Apache-2.0
/// Values from several frames -> one complete sample of a sensor.
///
/// A sample of an IMU or of eight force sensors comes in several CAN frames. They belong together when they carry the
/// same sample counter; a frame that has no room for it belongs to the counter it follows, within a period. Without any
/// counter, they belong together when no value is repeated and they lie within 0.8 of the measured period, from the frame on
/// that comes after the longest silence: the rest of a sample that lost its first frame does not join the next one.
/// A sample that stays incomplete is dropped whole and counted: values of two instants never meet in one sample.
/// Every frame is counted as used, dropped or duplicate. 0.4 KB of state per sensor, one thread.
#ifndef IPE_SAMPLE_ASSEMBLER_H
#define IPE_SAMPLE_ASSEMBLER_H

#include "config.h"
#include "decode.h"

enum { IPE_SAMPLE_ASSEMBLER_VALUES = 16 };

/// One complete sample of a sensor.
typedef struct {
    int64_t t_ns;        ///< host stamp of its first frame, less that frame's time on the wire
    bool has_device_time;
    double device_time;  ///< s, the sensor's own clock, wraps
    uint64_t step;       ///< samples since the one before by their counter; 0: no counter, or it jumped
    double
        value[IPE_SAMPLE_ASSEMBLER_VALUES];  ///< SI, imu: acc 3, gyro 3, q 4 or rpy 3; force: f 1..m; position: x y z
} ipe_reading_t;

typedef struct {
    uint64_t required, optional;  ///< quantities as bits
    uint8_t place[IPE_Q_COUNT];   ///< index of a required quantity in ipe_reading_t.value
    uint8_t counter_quantity, time_quantity;
    bool has_counter;             ///< a counter signal is bound
    double counter_wrap;          ///< it starts again at 0 after this; 0: never

    bool is_open;
    uint64_t present;
    double counter;            ///< of the open sample
    int64_t opened_ns;
    double period;             ///< s between complete samples, smoothed; 0: not known
    int64_t completed_ns;      ///< opening stamp of the last complete sample
    double completed_counter;  ///< its counter
    int n_dropped_in_a_row;    ///< many: the period is doubted and measured again
    int n_intervals;           ///< between complete samples since the period is measured
    int n_dropped_since;       ///< samples dropped since the last complete one
    unsigned n_open_frames;    ///< frames in the open sample
    float silence[IPE_SAMPLE_ASSEMBLER_VALUES +
                  1];          ///< s before the frame whose first value has this place, or time, the last
    int64_t last_ns;           ///< the last frame
    ipe_reading_t reading;

    uint64_t n_complete;    ///< samples handed on: every value came
    uint64_t n_incomplete;  ///< samples dropped: a frame or a value of them was missing
    uint64_t n_lost;        ///< samples that the counter says were never seen, and that did not come late either
    uint64_t n_jumps;       ///< times the counter went on where it cannot have been
    uint64_t n_used;        ///< frames in complete samples
    uint64_t n_dropped;     ///< frames in incomplete samples
    uint64_t n_duplicate;   ///< frames that repeated one of the same sample, ignored
} ipe_sample_assembler_t;

/// Which quantities make a sample of this sensor, from the bound signals of config.
void ipe_sample_assembler_init(ipe_sample_assembler_t* g, ipe_sensor_t sensor, const ipe_config_t* config);

/// Take the values of one frame that belong to this sensor.
///
/// IPE_OK         reading is complete
/// IPE_NOT_READY  more frames needed
/// IPE_IGNORED    nothing in it for this sensor
ipe_status_t ipe_sample_assembler_push(ipe_sample_assembler_t* g, const ipe_sample_t* sample, ipe_reading_t* reading);

#endif
