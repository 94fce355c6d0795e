// SPDX-License-Identifier: Apache-2.0
#include "motion.h"

#include "smallmat.h"

#include <string.h>

#define EPOCH_NS 40000000LL        // 25 Hz: chosen so that the covariance costs little beside the state
#define STEP_BACK_NS 1000000000LL  // 1 s, chosen over any reordering: a stamp this far back means a stepped clock
#define ACC_DENSITY 2e-3   // m/s2/rtHz, beside the measured noise: chosen as twice a MEMS sensor's own, for vibration
#define GYRO_DENSITY 1e-4  // rad/s/rtHz, beside it: chosen as a MEMS gyro's own, 0.006 deg/s/rtHz
#define BIAS_DRIVE 2e-6    // rad/s/rts, of the gyro's bias: 4 deg/h in 100 s, chosen as a MEMS gyro
#define SCALE_DRIVE 1e-5   // 1/rts, of the scales: chosen so that warming by 1e-4 in 100 s is followed
#define START_POSITION_STD 2e-3  // m, of one tracker sample until it is learnt: chosen between laser and total station
#define POSITION_MEMORY 250      // epochs, 10 s: chosen so that the tracker's noise is known to a tenth, sqrt(2/250)
#define POSITION_PRIOR 20        // epochs that the start counts for: chosen so that 1 s of positions outweighs it
#define POSITION_STD_MIN 2e-4    // m: chosen as a laser tracker's, and
#define POSITION_STD_MAX 2e-2    // m: as the worst indoor positioning's, so that outliers are not learnt as noise
#define START_VELOCITY_STD 2.0   // m/s: chosen over a cable robot's usual speed
#define TILT_STD_MIN 0.1         // rad: an AHRS that follows acceleration may be this far off at the start
#define YAW_STD_MIN 0.01         // rad: chosen so that the gyro and the positions decide after some seconds of motion
#define GYRO_BIAS_STD_MIN 2e-3   // rad/s: chosen as an uncalibrated MEMS gyro's, 0.1 deg/s
#define SCALE_STD_MIN 5e-3       // chosen as an uncalibrated MEMS sensor's
#define SETTLED_TILT 3e-3        // rad: motion is published from here on, chosen as 3 mm at 1 m, and
#define SETTLED_SCALE 1e-3       // of the scale factors: chosen so that it adds 0.1 % to the mass
#define SETTLE_TIME 10.0         // s, chosen over the 1 to 3 s that this takes: sensors that need longer tell no more
#define DECAY_MEMORY 0.4        // s, over which the decay of the attitude's error is averaged: chosen as a usual window
#define SLOWEST_DECAY 1e-4      // 1/s: chosen so that the correlation time stays finite
#define STEP_RATIO_MAX 2.0      // of neighbouring steps: chosen over jitter and under the 2 of a lost row
#define GATE 6.0                // sigmas: chosen so that noise is beyond once in 5e8 positions; with it
#define JUMP 0.05               // m: chosen over what stamps 50 ms late do at 1 m/s; further off contradicts
#define FASTEST 10.0            // m/s: chosen as no platform moves faster
#define RESTART_POSITIONS 5     // refused one after another, chosen over a burst of outliers,
#define RESTART_NS 200000000LL  // for 0.2 s: the target is elsewhere now
#define BRIDGE_NS 2000000000LL  // 2 s: a gap between rows that the AHRS carries the attitude through, chosen so that it
#define BRIDGE_STD 0.01         // rad: turns by no more than this wrongly
#define NOMINAL_STD 3e-4        // rad and
#define NOMINAL_TIME 1.0        // s: measured, of a fused attitude with 1 mm at 100 Hz and a MEMS gyro
#define CARRIED_STD_MAX 0.03    // m, of a position that rows are made from: chosen over a gap of 0.5 s

enum {
    N = IPE_MOTION_STATES,
    NP = IPE_MOTION_NP,
    PP = IPE_MOTION_P,
    VV = IPE_MOTION_V,
    PHI = IPE_MOTION_PHI,
    BIAS = IPE_MOTION_BIAS,
    BETA = IPE_MOTION_BETA,
    KAPPA = IPE_MOTION_KAPPA,
    MOVING = BIAS,  // states before it change within an epoch, those from it on are constants
};

static double square(double x)
{
    return x * x;
}

static void transpose(const double A[3][3], double out[3][3])
{
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) { out[i][j] = A[j][i]; }
    }
}

/// An attitude as the AHRS measures it: yaw is its own, and it wanders.
static void set_sensor_error(double std_wander, ipe_attitude_error_t* error)
{
    memset(error, 0, sizeof *error);
    error->attitude[2][IPE_MOTION_BY_YAW] = 1.0;
    for (int i = 0; i < 3; ++i) {
        error->attitude_std[i] = std_wander;
        error->attitude_time[i] = IPE_WANDER_TIME;
    }
}

bool ipe_motion_is_fused(const ipe_config_t* config)
{
    return config->attitude_estimate == IPE_ATTITUDE_FUSED && config->position_source != IPE_POSITION_FIXED;
}

void ipe_motion_init(ipe_motion_stage_t* m, const ipe_config_t* config)
{
    memset(m, 0, sizeof *m);
    m->is_fixed = config->position_source == IPE_POSITION_FIXED;
    m->delay_attitude = config->delay_attitude;
    m->is_fused = ipe_motion_is_fused(config);
    m->gravity = config->gravity;
    mat3_from_quat(config->imu_orientation, m->R_PI);
    const double yaw[3] = {0.0, 0.0, config->world_yaw};
    double R_IP[3][3], bias[3][3], lever[3];
    mat3_exp(yaw, m->yaw);
    mat3_exp(config->attitude_bias, bias);
    transpose(m->R_PI, R_IP);
    mat3_mul(R_IP, bias, m->ahrs_to_platform);
    mat3_mul(m->ahrs_to_platform, m->R_PI, m->ahrs_to_imu);
    memcpy(m->acc_bias, config->acc_bias, sizeof m->acc_bias);
    memcpy(m->gyro_bias, config->gyro_bias, sizeof m->gyro_bias);
    memcpy(m->imu_position, config->imu_position, sizeof m->imu_position);
    memcpy(m->tracker_target, config->tracker_target, sizeof m->tracker_target);
    vec3_axpy(config->tracker_target, -1.0, config->imu_position, lever);
    mat3_tmul_vec(m->R_PI, lever, m->lever);
    m->std_tilt = fmax(config->std_attitude, TILT_STD_MIN);
    m->std_yaw = fmax(config->std_attitude_wander, YAW_STD_MIN);
    m->std_gyro_bias = fmax(config->std_gyro_bias, GYRO_BIAS_STD_MIN);
    m->std_acc_scale = fmax(config->std_acc_scale, SCALE_STD_MIN) + config->std_acc_bias / fmax(config->gravity, 1.0);
    m->std_gyro_scale = fmax(config->std_gyro_scale, SCALE_STD_MIN);
    m->max_gap_ns = (int64_t)llround(1e9 * config->max_age[IPE_IMU]);
    m->max_carry_ns = (int64_t)llround(1e9 * config->max_carry);
    m->position_variance = square(START_POSITION_STD);
    m->std_wander = config->std_attitude_wander;
    m->n_learnt = POSITION_PRIOR;
}

void ipe_motion_set_gyro_bias(ipe_motion_stage_t* m, const double bias[3])
{
    for (int i = 0; i < 3; ++i) { m->b[i] += m->gyro_bias[i] - bias[i]; }  // the rate stays
    memcpy(m->gyro_bias, bias, sizeof m->gyro_bias);
}

/// Specific force and rate of raw readings, I axes, by the filter's own calibration.
static void calibrate(const ipe_motion_stage_t* m, const double acc[3], const double gyro[3], double s[3], double w[3])
{
    for (int i = 0; i < 3; ++i) {
        s[i] = (acc[i] - m->acc_bias[i]) * (1.0 - m->beta[i]);
        w[i] = (gyro[i] - m->gyro_bias[i] - m->b[i]) * (1.0 - m->kappa[i]);
    }
}

/// Attitude of the AHRS, calibrated: from axes [3][3] (I or P) to W.
static void ahrs_attitude(const ipe_motion_stage_t* m, const double q[4], const double axes[3][3], double R[3][3])
{
    double R_q[3][3], turned[3][3];
    mat3_from_quat(q, R_q);
    mat3_mul(m->yaw, R_q, turned);
    mat3_mul(turned, axes, R);
}

// ---- the mean ------------------------------------------------------------------------------------------------------

static void clear_sums(ipe_motion_stage_t* m)
{
    memset(m->sum_R, 0, sizeof m->sum_R);
    memset(m->sum_turn, 0, sizeof m->sum_turn);
    memset(m->sum_force, 0, sizeof m->sum_force);
    memset(m->sum_e, 0, sizeof m->sum_e);
    memset(m->sum_R_position, 0, sizeof m->sum_R_position);
    memset(m->sum_velocity, 0, sizeof m->sum_velocity);
    m->sum_since = 0.0;
    m->n_positions = 0;
}

/// Acceleration of the IMU point at the last row.
static void accelerate(ipe_motion_stage_t* m)
{
    double w[3];
    calibrate(m, m->acc, m->gyro, m->s, w);
    mat3_mul_vec(m->R, m->s, m->a);
    m->a[2] -= m->gravity;
}

/// Second derivative over a step of dt, from its slope and that of the step before. 0 where the two steps are so different that
/// their slopes' difference is mostly noise.
static double bend(const ipe_motion_stage_t* m, double dt, double slope, double slope_before)
{
    const bool is_regular = m->step > dt / STEP_RATIO_MAX && m->step < dt * STEP_RATIO_MAX;
    return is_regular ? 2.0 * (slope - slope_before) / (m->step + dt) : 0.0;
}

/// Integrate p, v, R over dt seconds to a row with these readings: the parabola through three rows, and coning.
static void advance_mean(ipe_motion_stage_t* m, double dt, const double acc[3], const double gyro[3])
{
    double s[3], w[3], w_before[3], w_now[3], cone[3], mean[3], turn[3], turned[3][3], R[3][3], s_before[3],
        a_before[3];
    calibrate(m, m->acc, m->gyro, s, w_before);
    calibrate(m, acc, gyro, s, w_now);
    vec3_cross(w_before, w_now, cone);
    for (int i = 0; i < 3; ++i) {
        const double slope = (gyro[i] - m->gyro[i]) / dt;
        mean[i] = 0.5 * (m->gyro[i] + gyro[i]) - dt * dt / 12.0 * bend(m, dt, slope, m->gyro_slope[i]);
        m->gyro_slope[i] = slope;
    }
    calibrate(m, acc, mean, s, w);
    for (int i = 0; i < 3; ++i) { turn[i] = dt * (w[i] + dt / 12.0 * cone[i]); }
    mat3_exp(turn, turned);
    mat3_mul(m->R, turned, R);
    memcpy(s_before, m->s, sizeof s_before);
    memcpy(a_before, m->a, sizeof a_before);
    memcpy(m->acc, acc, sizeof m->acc);
    memcpy(m->gyro, gyro, sizeof m->gyro);
    if (m->block_length == 0) { m->block_length = (int)fmax(1.0, round(1e-9 * EPOCH_NS / dt)); }
    ipe_noise_density_push(&m->noise, (double[]){acc[0], acc[1], acc[2], gyro[0], gyro[1], gyro[2]}, m->block_length);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            m->sum_R[i][j] += 0.5 * dt * (m->R[i][j] + R[i][j]);
            m->sum_turn[i][j] += 0.5 * (m->R[i][j] + R[i][j]) * turn[j];
            m->sum_force[i][j] += 0.5 * dt * (m->R[i][j] * s_before[j] + R[i][j] * s[j]);
        }
    }
    memcpy(m->R, R, sizeof m->R);
    accelerate(m);
    for (int i = 0; i < 3; ++i) {
        const double slope = (m->a[i] - a_before[i]) / dt;
        const double bent = dt * dt * bend(m, dt, slope, m->a_slope[i]);
        m->p[i] += dt * (m->v[i] + dt * ((2.0 * a_before[i] + m->a[i]) / 6.0 - bent / 24.0));
        m->v[i] += dt * (0.5 * (a_before[i] + m->a[i]) - bent / 12.0);
        m->a_slope[i] = slope;
    }
    m->step = dt;
}

/// The rotation matrix nearest to R, which is close to one.
static void orthonormalise(double R[3][3])
{
    double product[3][3], kept[3][3];
    memcpy(kept, R, sizeof kept);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            product[i][j] = -0.5 * (R[0][i] * R[0][j] + R[1][i] * R[1][j] + R[2][i] * R[2][j]) + (i == j ? 1.5 : 0.0);
        }
    }
    mat3_mul(kept, product, R);
}

static void apply(ipe_motion_stage_t* m, const double d[N])
{
    double turned[3][3], R[3][3];
    mat3_exp(d + PHI, turned);
    mat3_mul((const double (*)[3])turned, (const double (*)[3])m->R, R);
    orthonormalise(R);
    memcpy(m->R, R, sizeof m->R);
    for (int i = 0; i < 3; ++i) {
        m->p[i] += d[PP + i];
        m->v[i] += d[VV + i];
        m->b[i] += d[BIAS + i];
        m->beta[i] += d[BETA + i];
        m->kappa[i] += d[KAPPA + i];
    }
    accelerate(m);
}

// ---- covariance and sensitivity ------------------------------------------------------------------------------------

/// rows of out = k [a]x A, rows at, columns from
static void put_cross(const double a[3], double k, double out[N][N], int row, int column)
{
    out[row][column + 1] = -k * a[2], out[row][column + 2] = k * a[1];
    out[row + 1][column] = k * a[2], out[row + 1][column + 2] = -k * a[0];
    out[row + 2][column] = -k * a[1], out[row + 2][column + 1] = k * a[0];
}

/// A state whose unit turns the attitude back by turn over the epoch, and the force f with it.
static void put_turn(const double turn[3], const double f[3], double T, int state, double Phi[N][N])
{
    double across[3];
    vec3_cross(f, turn, across);
    for (int i = 0; i < 3; ++i) {
        Phi[PHI + i][state] = -turn[i];
        Phi[VV + i][state] = 0.5 * across[i];
        Phi[PP + i][state] = T / 6.0 * across[i];
    }
}

/// Error over the epoch of T s: Phi [18][18], and G [18][3] of the accelerometer's bias.
static void transition(const ipe_motion_stage_t* m, double T, double Phi[N][N], double G[N][3])
{
    double f[3];
    memset(Phi, 0, sizeof(double) * N * N);
    memset(G, 0, sizeof(double) * N * 3);
    for (int i = 0; i < N; ++i) { Phi[i][i] = 1.0; }
    for (int i = 0; i < 3; ++i) {
        f[i] = m->sum_force[i][0] + m->sum_force[i][1] + m->sum_force[i][2];
        Phi[PP + i][VV + i] = T;
    }
    put_cross(f, -0.5 * T, Phi, PP, PHI);
    put_cross(f, -1.0, Phi, VV, PHI);
    for (int j = 0; j < 3; ++j) {
        const double column[3] = {m->sum_R[0][j], m->sum_R[1][j], m->sum_R[2][j]};
        const double turn[3] = {m->sum_turn[0][j], m->sum_turn[1][j], m->sum_turn[2][j]};
        put_turn(column, f, T, BIAS + j, Phi);
        put_turn(turn, f, T, KAPPA + j, Phi);
        for (int i = 0; i < 3; ++i) {
            Phi[VV + i][BETA + j] = -m->sum_force[i][j];
            Phi[PP + i][BETA + j] = -0.5 * T * m->sum_force[i][j];
            G[VV + i][j] = -column[i] * (1.0 - m->beta[j]);
            G[PP + i][j] = 0.5 * T * G[VV + i][j];
        }
    }
}

/// White noise that drives velocity and attitude, (m/s2)^2/Hz and (rad/s)^2/Hz: the floors and the sensors' own.
static void read_noise(ipe_motion_stage_t* m)
{
    double density[IPE_NOISE_DENSITY_CHANNELS];
    ipe_noise_density_density(&m->noise, 1e-9 * EPOCH_NS, density);
    m->acc_density = square(ACC_DENSITY) + (density[0] + density[1] + density[2]) / 3.0;
    m->gyro_density = square(GYRO_DENSITY) + (density[3] + density[4] + density[5]) / 3.0;
}

/// P <- Phi P Phi^T + Q,  S <- Phi S + G
static void predict(ipe_motion_stage_t* m, double T)
{
    double Phi[N][N], G[N][3], M[N][N], S[MOVING][NP];
    double (*P)[N] = m->spread.P;
    transition(m, T, Phi, G);
    if (m->epoch != NULL) { memcpy(m->epoch->Phi, Phi, sizeof Phi); }
    memcpy(M, P, sizeof M);
    for (int i = 0; i < MOVING; ++i) {
        memcpy(S[i], m->spread.S[i], sizeof S[i]);
        for (int k = VV; k < N; ++k) {
            const double share = Phi[i][k];
            if (share == 0.0 || k == i) { continue; }
            for (int j = 0; j < N; ++j) { M[i][j] += share * P[k][j]; }
            for (int j = 0; j < NP; ++j) { S[i][j] += share * m->spread.S[k][j]; }
        }
        for (int j = 0; j < 3; ++j) { S[i][IPE_MOTION_BY_ACC_BIAS + j] += G[i][j]; }
    }
    memcpy(m->spread.S, S, sizeof S);
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = M[i][j];
            if (j < MOVING) {
                for (int k = VV; k < N; ++k) { sum += k == j ? 0.0 : Phi[j][k] * M[i][k]; }
            }
            P[i][j] = P[j][i] = sum;
        }
    }
    for (int i = 0; i < 3; ++i) {
        const double acc = m->acc_density * T;
        P[PP + i][PP + i] += acc * T * T / 3.0;
        P[PP + i][VV + i] += 0.5 * acc * T;
        P[VV + i][PP + i] += 0.5 * acc * T;
        P[VV + i][VV + i] += acc;
        P[PHI + i][PHI + i] += m->gyro_density * T;
        P[BIAS + i][BIAS + i] += square(BIAS_DRIVE) * T;
        P[BETA + i][BETA + i] += square(SCALE_DRIVE) * T;
        P[KAPPA + i][KAPPA + i] += square(SCALE_DRIVE) * T;
    }
}

/// One scalar measurement, innovation = H error + H_c parameters + noise; its correction is added to d.
static void update(ipe_motion_stage_t* m, const double H[MOVING], const double H_c[NP], double innovation,
                   double variance, double d[N])
{
    double PH[N], HS[NP];
    double (*P)[N] = m->spread.P;
    double S = variance;
    memcpy(HS, H_c, sizeof HS);
    memset(PH, 0, sizeof PH);
    for (int k = 0; k < MOVING; ++k) {
        if (H[k] == 0.0) { continue; }
        for (int i = 0; i < N; ++i) { PH[i] += P[k][i] * H[k]; }
        for (int j = 0; j < NP; ++j) { HS[j] += H[k] * m->spread.S[k][j]; }
        innovation -= H[k] * d[k];
    }
    for (int k = 0; k < MOVING; ++k) { S += H[k] * PH[k]; }
    for (int i = 0; i < N; ++i) {
        const double gain = PH[i] / S;
        d[i] += gain * innovation;
        for (int j = 0; j < N; ++j) { P[i][j] -= gain * PH[j]; }
        for (int j = 0; j < NP; ++j) { m->spread.S[i][j] -= gain * HS[j]; }
    }
}

/// Variance of a tracker sample, from the innovations e [3] of a mean of n and the part of their square that the state's
/// covariance explains, once that is the smaller part.
static void learn_position_variance(ipe_motion_stage_t* m, const double e[3], double explained, double n)
{
    if (n * explained > 3.0 * m->position_variance) { return; }
    const double most = 25.0 * m->position_variance;
    const double sample = fmin(n * (vec3_dot(e, e) - explained) / 3.0, most);
    if (m->n_learnt < POSITION_MEMORY) { ++m->n_learnt; }
    m->position_variance += (sample - m->position_variance) / m->n_learnt;
    m->position_variance = fmin(fmax(m->position_variance, square(POSITION_STD_MIN)), square(POSITION_STD_MAX));
}

/// The mean of the epoch's positions: x = p - lag v + phi x (R l), lag: s from their mean instant to the epoch's end.
static void update_position(ipe_motion_stage_t* m, double T, double d[N])
{
    double e[3], R[3][3], arm[3], velocity[3], H[3][MOVING] = {{0.0}}, H_c[3][NP] = {{0.0}}, explained = 0.0;
    const double n = m->n_positions, lag = T - m->sum_since / n;
    for (int i = 0; i < 3; ++i) {
        e[i] = m->sum_e[i] / n;
        for (int j = 0; j < 3; ++j) { R[i][j] = m->sum_R_position[i][j] / n; }
        velocity[i] = m->sum_velocity[i] / n;
    }
    mat3_mul_vec(R, m->lever, arm);
    H[0][PHI + 1] = arm[2], H[0][PHI + 2] = -arm[1];
    H[1][PHI] = -arm[2], H[1][PHI + 2] = arm[0];
    H[2][PHI] = arm[1], H[2][PHI + 1] = -arm[0];
    for (int i = 0; i < 3; ++i) {
        H[i][PP + i] = 1.0;
        H[i][VV + i] = -lag;
        for (int j = 0; j < 3; ++j) { H_c[i][IPE_MOTION_BY_LEVER + j] = vec3_dot(R[i], m->R_PI[j]); }
        H_c[i][IPE_MOTION_BY_DELAY] = -velocity[i];
        double (*P)[N] = m->spread.P;
        explained += P[PP + i][PP + i] - 2.0 * lag * P[PP + i][VV + i] + lag * lag * P[VV + i][VV + i];
    }
    const double variance = m->position_variance / n;
    for (int i = 0; i < 3; ++i) { update(m, H[i], H_c[i], e[i], variance, d); }
    learn_position_variance(m, e, explained, n);
}

/// Yaw of the AHRS: a wander of IPE_WANDER_TIME as white noise, so that many epochs are worth one sample of it.
static void update_yaw(ipe_motion_stage_t* m, const double q[4], double T, double d[N])
{
    double R[3][3], H[MOVING] = {0.0}, H_c[NP] = {0.0};
    ahrs_attitude(m, q, (const double (*)[3])m->ahrs_to_imu, R);
    const double sine = vec3_dot(R[1], m->R[0]) - vec3_dot(R[0], m->R[1]);
    const double cosine = vec3_dot(R[0], m->R[0]) + vec3_dot(R[1], m->R[1]);
    H[PHI + 2] = 1.0;
    H_c[IPE_MOTION_BY_YAW] = -1.0;
    update(m, H, H_c, atan2(sine, cosine), 2.0 * square(m->std_yaw) * IPE_WANDER_TIME / T, d);
}

static void set_error(ipe_motion_stage_t* m)
{
    ipe_attitude_error_t* e = &m->error;
    memcpy(e->attitude, m->spread.S[PHI], sizeof e->attitude);
    memcpy(e->force_scale, m->spread.S[BETA], sizeof e->force_scale);
    memcpy(e->rate_scale, m->spread.S[KAPPA], sizeof e->rate_scale);
    for (int i = 0; i < 3; ++i) {
        e->attitude_std[i] = sqrt(m->spread.P[PHI + i][PHI + i]);
        e->attitude_time[i] = 1.0 / fmax(m->decay[i], SLOWEST_DECAY);
    }
}

/// The share of the attitude's error, of variance before [3], that measurements take away, per second.
static void learn_decay(ipe_motion_stage_t* m, double T, const double before[3])
{
    for (int i = 0; i < 3; ++i) {
        const double after = m->spread.P[PHI + i][PHI + i];
        m->decay[i] += fmin(T / DECAY_MEMORY, 1.0) * ((before[i] - after) / (before[i] * T) - m->decay[i]);
    }
}

static void end_epoch(ipe_motion_stage_t* m, const double q[4])
{
    const double T = 1e-9 * (double)(m->t_ns - m->epoch_ns);
    double d[N] = {0.0};
    read_noise(m);
    predict(m, T);
    const double before[3] = {m->spread.P[PHI][PHI], m->spread.P[PHI + 1][PHI + 1], m->spread.P[PHI + 2][PHI + 2]};
    if (m->epoch != NULL) { m->epoch->predicted = m->spread; }
    if (m->n_positions > 0) { update_position(m, T, d); }
    update_yaw(m, q, T, d);
    if (m->epoch != NULL) { memcpy(m->epoch->correction, d, sizeof d); }
    apply(m, d);
    learn_decay(m, T, before);
    set_error(m);
    const double* P = &m->spread.P[0][0];
    m->gate2 = square(GATE) * (P[0] + P[N + 1] + P[2 * (N + 1)] + 3.0 * m->position_variance) + square(JUMP);
    m->epoch_ns = m->t_ns;
    ++m->n_epochs;
    clear_sums(m);
}

// ---- start, gaps, positions -----------------------------------------------------------------------------------------

/// p, v anew at a position x of the tracked point; attitude and calibration stay.
static void start_position(ipe_motion_stage_t* m, const double x[3])
{
    double arm[3], velocity[3] = {0.0}, (*P)[N] = m->spread.P, (*S)[NP] = m->spread.S;
    mat3_mul_vec(m->R, m->lever, arm);
    vec3_axpy(x, -1.0, arm, m->p);
    memcpy(m->v, velocity, sizeof m->v);
    for (int i = 0; i < PHI; ++i) {
        for (int j = 0; j < N; ++j) { P[i][j] = P[j][i] = 0.0; }
        memset(S[i], 0, sizeof S[i]);
    }
    const double H[3][3] = {{0.0, arm[2], -arm[1]}, {-arm[2], 0.0, arm[0]}, {arm[1], -arm[0], 0.0}};
    for (int i = 0; i < 3; ++i) {  // p = x - R l - phi x R l - noise
        P[PP + i][PP + i] = m->position_variance;
        P[VV + i][VV + i] = square(START_VELOCITY_STD);
        for (int k = 0; k < 3; ++k) {
            for (int j = PHI; j < N; ++j) { P[PP + i][j] -= H[i][k] * P[PHI + k][j]; }
            for (int j = 0; j < NP; ++j) { S[PP + i][j] -= H[i][k] * S[PHI + k][j]; }
        }
        for (int j = 0; j < 3; ++j) { S[PP + i][IPE_MOTION_BY_LEVER + j] -= vec3_dot(m->R[i], m->R_PI[j]); }
        for (int j = PHI; j < N; ++j) { P[j][PP + i] = P[PP + i][j]; }
    }
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            for (int k = 0; k < 3; ++k) { P[PP + i][PP + j] -= P[PP + i][PHI + k] * H[j][k]; }
        }
    }
    ++m->n_starts;
    m->settled_ns = m->t_ns;
    m->gate2 = HUGE_VAL;
    m->epoch_ns = m->t_ns;
    m->step = 0.0;
    clear_sums(m);
    accelerate(m);
}

/// Everything anew at a row with a position; what is known of gyro bias and scales stays.
static void start(ipe_motion_stage_t* m, const ipe_row_t* row)
{
    double (*P)[N] = m->spread.P, (*S)[NP] = m->spread.S;
    const bool is_first = P[BIAS][BIAS] == 0.0;
    ahrs_attitude(m, row->q, (const double (*)[3])m->ahrs_to_imu, m->R);
    for (int i = PHI; i < (is_first ? N : BIAS); ++i) {
        for (int j = 0; j < N; ++j) { P[i][j] = P[j][i] = 0.0; }
        memset(S[i], 0, sizeof S[i]);
    }
    P[PHI][PHI] = P[PHI + 1][PHI + 1] = square(m->std_tilt);
    P[PHI + 2][PHI + 2] = square(m->std_yaw);
    S[PHI + 2][IPE_MOTION_BY_YAW] = 1.0;
    for (int i = 0; is_first && i < 3; ++i) {
        P[BIAS + i][BIAS + i] = square(m->std_gyro_bias);
        P[BETA + i][BETA + i] = square(m->std_acc_scale);
        P[KAPPA + i][KAPPA + i] = square(m->std_gyro_scale);
    }
    memcpy(m->acc, row->acc, sizeof m->acc);
    memcpy(m->gyro, row->gyro, sizeof m->gyro);
    m->t_ns = row->t_ns;
    start_position(m, row->position);
    read_noise(m);
    set_error(m);
    ipe_noise_density_restart(&m->noise);
    m->is_running = true;
    m->n_refused_row = 0;
}

/// A position that contradicts the motion. Those that contradict each other do not show where the target is now.
static void refuse_position(ipe_motion_stage_t* m, const ipe_row_t* row)
{
    double step[3];
    vec3_axpy(row->position, -1.0, m->refused, step);
    const double reach = JUMP + FASTEST * 1e-9 * (double)(row->t_ns - m->refused_at_ns);
    if (vec3_norm(step) > reach) { m->n_refused_row = 0; }
    if (m->n_refused_row++ == 0) { m->refused_ns = row->t_ns; }
    memcpy(m->refused, row->position, sizeof m->refused);
    m->refused_at_ns = row->t_ns;
    ++m->n_positions_refused;
}

/// A position into the epoch's sums. False: it contradicts the motion.
static bool take_position(ipe_motion_stage_t* m, const ipe_row_t* row)
{
    double arm[3], e[3], s[3], w[3], turn[3], turned[3];
    mat3_mul_vec(m->R, m->lever, arm);
    for (int i = 0; i < 3; ++i) { e[i] = row->position[i] - m->p[i] - arm[i]; }
    if (vec3_dot(e, e) > m->gate2) {
        refuse_position(m, row);
        return false;
    }
    m->n_refused_row = 0;
    if (!row->is_position_new) { return true; }
    calibrate(m, row->acc, row->gyro, s, w);
    vec3_cross(w, m->lever, turn);
    mat3_mul_vec(m->R, turn, turned);
    for (int i = 0; i < 3; ++i) {
        m->sum_e[i] += e[i];
        for (int j = 0; j < 3; ++j) { m->sum_R_position[i][j] += m->R[i][j]; }
        m->sum_velocity[i] += m->v[i] + turned[i];
    }
    m->sum_since += 1e-9 * (double)(m->t_ns - m->epoch_ns);
    ++m->n_positions;
    return true;
}

/// Over a gap between rows: the attitude turns as the AHRS did, position and velocity start anew.
static void bridge(ipe_motion_stage_t* m, const ipe_row_t* row)
{
    double before[3][3], back[3][3], after[3][3], turned[3][3], R[3][3];
    ahrs_attitude(m, m->q, (const double (*)[3])m->ahrs_to_imu, before);
    ahrs_attitude(m, row->q, (const double (*)[3])m->ahrs_to_imu, after);
    transpose(before, back);
    mat3_mul(back, after, turned);
    mat3_mul(m->R, turned, R);
    memcpy(m->R, R, sizeof m->R);
    for (int i = 0; i < 3; ++i) { m->spread.P[PHI + i][PHI + i] += square(BRIDGE_STD); }
    memcpy(m->acc, row->acc, sizeof m->acc);
    memcpy(m->gyro, row->gyro, sizeof m->gyro);
    m->t_ns = row->t_ns;
    ipe_noise_density_restart(&m->noise);
    start_position(m, row->position);
}

/// To the row's instant. IPE_NOT_READY: nothing is known there.
static ipe_status_t advance(ipe_motion_stage_t* m, const ipe_row_t* row)
{
    const int64_t gap_ns = row->t_ns - m->t_ns;
    if (m->is_running && gap_ns <= 0 && gap_ns > -STEP_BACK_NS) { return IPE_ERR_TIME; }
    if (m->is_running && gap_ns > 0 && gap_ns <= m->max_gap_ns) {
        advance_mean(m, 1e-9 * (double)gap_ns, row->acc, row->gyro);
        m->t_ns = row->t_ns;
        return IPE_OK;
    }
    if (!row->has_position) { return IPE_NOT_READY; }
    if (m->is_running && gap_ns > 0 && gap_ns <= BRIDGE_NS) {
        bridge(m, row);
    } else {
        start(m, row);
    }
    return IPE_OK;
}

/// Does the row have a position that can be believed? One that stays elsewhere starts position and velocity anew.
static bool follow_position(ipe_motion_stage_t* m, const ipe_row_t* row)
{
    if (!row->has_position) { return false; }
    bool is_taken = take_position(m, row);
    if (m->n_refused_row >= RESTART_POSITIONS && row->t_ns - m->refused_ns >= RESTART_NS) {
        start_position(m, row->position);
        is_taken = take_position(m, row);
    }
    if (is_taken) { m->seen_ns = row->t_ns; }
    return is_taken;
}

// ---- results --------------------------------------------------------------------------------------------------------

void ipe_motion_nominal_error(const ipe_config_t* config, const double R[3][3], ipe_attitude_error_t* error)
{
    if (!ipe_motion_is_fused(config)) {
        set_sensor_error(config->std_attitude_wander, error);
        return;
    }
    double R_PI[3][3], R_I[3][3];
    memset(error, 0, sizeof *error);
    for (int i = 0; i < 3; ++i) { error->attitude_std[i] = NOMINAL_STD, error->attitude_time[i] = NOMINAL_TIME; }
    mat3_from_quat(config->imu_orientation, R_PI);
    mat3_mul(R, R_PI, R_I);
    for (int k = 0; k < 3; ++k) {  // exp(phi) R (s - bias) = g z
        const int at = IPE_MOTION_BY_ACC_BIAS + k;
        error->attitude[0][at] = -R_I[1][k] / config->gravity;
        error->attitude[1][at] = R_I[0][k] / config->gravity;
        for (int i = 0; i < 3; ++i) { error->force_scale[i][at] = -R_I[2][k] / config->gravity; }
    }
}

/// R = R exp(w time).
static void turn_on(const double w[3], double time, double R[3][3])
{
    const double angle[3] = {w[0] * time, w[1] * time, w[2] * time};
    double turn[3][3], before[3][3];
    mat3_exp(angle, turn);
    memcpy(before, R, sizeof before);
    mat3_mul((const double (*)[3])before, (const double (*)[3])turn, R);
}

/// s, w, R by the sensors' own calibration, and the error of their attitude.
static void read_sensors(const ipe_motion_stage_t* m, const ipe_row_t* row, ipe_motion_t* motion)
{
    double s[3], w[3];
    vec3_axpy(row->acc, -1.0, m->acc_bias, s);
    vec3_axpy(row->gyro, -1.0, m->gyro_bias, w);
    mat3_mul_vec(m->R_PI, s, motion->s);
    mat3_mul_vec(m->R_PI, w, motion->w);
    ahrs_attitude(m, row->q, (const double (*)[3])m->ahrs_to_platform, motion->R);
    if (m->delay_attitude != 0.0) { turn_on(motion->w, m->delay_attitude, motion->R); }
    set_sensor_error(m->std_wander, &motion->error);
}

static void read_filter(const ipe_motion_stage_t* m, ipe_motion_t* motion)
{
    double s[3], w[3];
    calibrate(m, m->acc, m->gyro, s, w);
    mat3_mul_vec(m->R_PI, s, motion->s);
    mat3_mul_vec(m->R_PI, w, motion->w);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) { motion->R[i][j] = vec3_dot(m->R[i], m->R_PI[j]); }
    }
    motion->error = m->error;
}

/// Position and velocity of P.
static void read_position(const ipe_motion_stage_t* m, const double* x, ipe_motion_t* motion)
{
    double arm[3], turn[3];
    if (x != NULL) {
        mat3_mul_vec(motion->R, m->tracker_target, arm);
        vec3_axpy(x, -1.0, arm, motion->p);
    } else {
        mat3_mul_vec(motion->R, m->imu_position, arm);
        vec3_axpy(m->p, -1.0, arm, motion->p);
    }
    vec3_cross(motion->w, m->imu_position, turn);
    mat3_mul_vec(motion->R, turn, arm);
    vec3_axpy(m->v, -1.0, arm, motion->v);
}

void ipe_motion_target(const ipe_motion_stage_t* m, double x[3])
{
    double arm[3];
    mat3_mul_vec(m->R, m->lever, arm);
    vec3_axpy(m->p, 1.0, arm, x);
}

/// Are tilt, and the scale along the specific force, known to so many times what rows ask for?
static bool is_known(const ipe_motion_stage_t* m, double times)
{
    const double (*P)[N] = (const double (*)[N])m->spread.P;
    const double s2 = vec3_dot(m->s, m->s);
    double share[3], variance = 0.0;
    for (int i = 0; i < 3; ++i) { share[i] = m->s[i] * m->s[i] / fmax(s2, 1e-12); }
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) { variance += share[i] * share[j] * P[BETA + i][BETA + j]; }
    }
    return fmax(P[PHI][PHI], P[PHI + 1][PHI + 1]) < square(times * SETTLED_TILT) &&
           variance < square(times * SETTLED_SCALE);
}

/// May rows be used? After SETTLE_TIME with positions less and less is asked for, lest a platform that vibrates has no
/// estimate: the filter counts the error that is left.
static bool is_settled(const ipe_motion_stage_t* m)
{
    const double waited = 1e-9 * (double)(m->t_ns - m->settled_ns);
    return is_known(m, fmax(1.0, waited / SETTLE_TIME));
}

static bool is_carried(const ipe_motion_stage_t* m)
{
    const double (*P)[N] = (const double (*)[N])m->spread.P;
    return m->t_ns - m->seen_ns <= m->max_carry_ns && P[0][0] + P[1][1] + P[2][2] < 3.0 * square(CARRIED_STD_MAX);
}

ipe_status_t ipe_motion_push(ipe_motion_stage_t* m, const ipe_row_t* row, ipe_motion_t* motion)
{
    if (m->is_fixed) {
        read_sensors(m, row, motion);
        read_position(m, row->position, motion);
        ++m->n_rows;
        return IPE_OK;
    }
    const int64_t before_ns = m->t_ns;
    const ipe_status_t status = advance(m, row);
    if (status == IPE_ERR_TIME) { return status; }
    if (status == IPE_NOT_READY) {
        m->n_no_position += row->has_force;
        return IPE_IGNORED;
    }
    memcpy(m->q, row->q, sizeof m->q);
    const bool has_position = follow_position(m, row);
    const int64_t since_ns = m->t_ns - m->epoch_ns;
    m->is_epoch_new = since_ns > 0 && since_ns >= EPOCH_NS - (m->t_ns - before_ns) / 2;
    if (m->is_epoch_new) { end_epoch(m, row->q); }
    const bool is_lost = !has_position && !is_carried(m);
    if (is_lost || is_known(m, 1.0)) { m->settled_ns = m->t_ns; }  // an outage settles nothing, however long it is
    if (is_lost) {
        m->n_no_position += row->has_force;
        return IPE_IGNORED;
    }
    if (m->is_fused) {
        read_filter(m, motion);
    } else {
        read_sensors(m, row, motion);
    }
    read_position(m, has_position ? row->position : NULL, motion);
    if (m->is_fused && !is_settled(m)) {
        ++m->n_unsettled;
        return IPE_NOT_READY;
    }
    ++m->n_rows;
    m->n_carried += !has_position;
    return IPE_OK;
}
