// SPDX-License-Identifier: Apache-2.0
/// The weak form: equations of motion averaged over smooth windows, so that no signal is differentiated.
///
/// Multiply F = Y(s, w, alpha) theta by a kernel phi and integrate; alpha = dw/dt moves over to the kernel by parts:
///   abar = integral(phi alpha) = -integral(phi' w)
/// phi is the cubic B-spline of length L, a new window every L/4, so four are open at any time. Integrals are sums over
/// the samples with their own spacing (trapezoid). abar is the slope of w against t under the weight phi':
///   abar = sum phi'_k d_k (w_k - wbar) / sum phi'_k d_k (t_k - tbar)
/// exact for a rate that changes linearly on any sample grid, and, because L/4 is a whole number of samples, with aliases
/// suppressed by the fourth power of a sinc on a regular one. The average of F equals the averaged Y times theta without
/// approximation whatever the weights; only abar carries an error.
/// Source: firmware/DESIGN.md, "Weak form". 4 KB of state, about 80 ns per row, one thread.
#ifndef IPE_WINDOW_H
#define IPE_WINDOW_H

#include "config.h"
#include "types.h"
#include "noise_density.h"

/// Averages of one finished window.
typedef struct {
    int64_t t_ns;                     ///< its middle
    double length;                    ///< s
    double s[3];                      ///< specific force, m/s2
    double w[3];                      ///< rate, rad/s
    double ww[6];                     ///< rate products xx yy zz yz xz xy, rad2/s2
    double alpha[3];                  ///< angular acceleration, rad/s2
    double s_variance[3];             ///< of s, by the accelerometer's white noise, m2/s4
    double alpha_variance[3];         ///< of alpha, by the gyro's, rad2/s4
    double y[IPE_NY];                 ///< wrench, N, N m
    double cable_inertia[IPE_NY];     ///< the cables' inertia that is in it, cable_inertia.h
    double p[3];                      ///< position of P in W, m
    double velocity[3];               ///< its slope, m/s
    double f[IPE_CABLES_MAX];         ///< tensions, N
    double f_slope[IPE_CABLES_MAX];   ///< their slopes, N/s
    double friction[IPE_CABLES_MAX];  ///< tensions with the sign of the cables' speeds, N
    double R[3][3];                   ///< P to W in the window's middle,
    ipe_attitude_error_t error;       ///< and its error
    uint32_t unknown_force;           ///< bit i: cable i's sensor failed in one of the rows
    int n_rows;
} ipe_average_t;

/// Averaged channels; those from IPE_CHANNEL_W to the tensions are also differentiated under the kernel.
enum {
    IPE_CHANNEL_S = 0,
    IPE_CHANNEL_WW = 3,
    IPE_CHANNEL_Y = 9,
    IPE_CHANNEL_W = 15,
    IPE_CHANNEL_P = 18,
    IPE_CHANNEL_F = 21,  ///< one of each cable; after them the tensions with the sign of speed, not differentiated
    IPE_CHANNELS = IPE_CHANNEL_F + 2 * IPE_CABLES_MAX,
    IPE_SLOPES = IPE_CHANNEL_F + IPE_CABLES_MAX - IPE_CHANNEL_W,
};

typedef struct {
    double weight;                 ///< sum phi d
    double moment;                 ///< sum phi d t
    double slope_weight;           ///< sum phi' d
    double slope_moment;           ///< sum phi' d t
    double channel[IPE_CHANNELS];  ///< sum phi d channel
    double slope[IPE_SLOPES];      ///< sum phi' d channel
    double R[3][3];                ///< of the last row up to the middle,
    ipe_attitude_error_t error;    ///< and its error
    uint32_t unknown_force;        ///< of any row
    int n_rows;
} ipe_accumulator_t;

typedef struct {
    int n_cables;
    int n_channels;        ///< in use: IPE_CHANNEL_F + 2 n_cables
    double window_length;  ///< s, as configured
    double max_age;        ///< s, gap that restarts the windows whatever the sample rate
    double period;         ///< s between rows; 0: being measured
    double length;         ///< s, 4 whole numbers of periods
    double max_gap;        ///< s

    bool is_running;
    int gap_permille;   ///< of the length, gap that does no harm
    int64_t origin_ns;  ///< start of window 0
    uint64_t first;     ///< index of the oldest open window
    ipe_accumulator_t open[IPE_WINDOWS_OPEN];
    struct {
        int64_t t_ns;
        double channel[IPE_CHANNELS];
        double R[3][3];
        ipe_attitude_error_t error;
        uint32_t unknown_force;
    } previous;                            ///< the row that waits for its successor's stamp
    double spacing;                        ///< s between previous and the one before
    int n_measured;                        ///< intervals seen while measuring the period
    double interval[IPE_WINDOW_MEASURED];  ///< s, those, ascending
    ipe_noise_density_t noise_density;     ///< once the period is known: of s and w

    uint64_t n_rows;                       ///< rows taken in
    uint64_t n_windows;                    ///< windows finished
    uint64_t n_restarts;                   ///< times a gap threw the open windows away
    uint64_t n_backwards;                  ///< rows refused: stamp not after the one before
} ipe_window_t;

void ipe_window_init(ipe_window_t* x, const ipe_config_t* config);

/// The same with windows of another length, s, which a gap of gap_permille / 1000 of it does not restart; period: s between rows
/// where it is known already, else 0.
void ipe_window_init_length(ipe_window_t* x, const ipe_config_t* config, double length, int gap_permille,
                            double period);

/// Use a period between rows that was measured before, > 0, s; length and max_gap follow from it. No window is open.
void ipe_window_set_period(ipe_window_t* x, double period);

/// Throw the open windows away: rows to come do not fit those in them.
void ipe_window_restart(ipe_window_t* x);

/// Take one row's motion and wrench at t_ns.
///
/// IPE_OK         a window ended: average is written
/// IPE_NOT_READY  none ended
/// IPE_ERR_TIME   t_ns not after the row before, by less than a second (more: a restart): refused, counted
ipe_status_t ipe_window_push(ipe_window_t* x, int64_t t_ns, const ipe_motion_t* motion, const ipe_wrench_t* wrench,
                             ipe_average_t* average);

#endif
