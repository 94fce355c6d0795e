// SPDX-License-Identifier: Apache-2.0
// Sample-by-sample parts of the independent simulation: three attitude filters, friction, hysteresis.
// Loaded by native.py. Arrays are row-major; quaternions w x y z, body to world. Nothing of the product is used.

#include <math.h>
#include <stddef.h>
#include <string.h>

typedef enum { MAHONY, MADGWICK, KALMAN } filter_kind_t;

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[3], const double b[3], double c[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/// q := q exp(v), v [rad] in body axes.
static void turn(double q[4], const double v[3])
{
    double angle = sqrt(dot(v, v)), s = angle > 1e-9 ? sin(0.5 * angle) / angle : 0.5, w = cos(0.5 * angle);
    double d[4] = {w, s * v[0], s * v[1], s * v[2]};
    double r[4] = {
        q[0] * d[0] - q[1] * d[1] - q[2] * d[2] - q[3] * d[3],
        q[0] * d[1] + q[1] * d[0] + q[2] * d[3] - q[3] * d[2],
        q[0] * d[2] - q[1] * d[3] + q[2] * d[0] + q[3] * d[1],
        q[0] * d[3] + q[1] * d[2] - q[2] * d[1] + q[3] * d[0],
    };
    double norm = sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3]);
    for (int i = 0; i < 4; i++) { q[i] = r[i] / norm; }
}

/// The world's vertical in body axes, by the attitude q.
static void vertical(const double q[4], double up[3])
{
    up[0] = 2.0 * (q[1] * q[3] - q[0] * q[2]);
    up[1] = 2.0 * (q[0] * q[1] + q[2] * q[3]);
    up[2] = q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3];
}

static double heading(const double q[4])
{
    return atan2(2.0 * (q[1] * q[2] + q[0] * q[3]), q[0] * q[0] + q[1] * q[1] - q[2] * q[2] - q[3] * q[3]);
}

/// Rotation rate [rad/s] that Madgwick's gradient descent adds: -beta grad/|grad| as a quaternion rate, in body axes.
static void gradient(const double q[4], const double a[3], double beta, double rate[3])
{
    double f[3] = {
        2.0 * (q[1] * q[3] - q[0] * q[2]) - a[0],
        2.0 * (q[0] * q[1] + q[2] * q[3]) - a[1],
        2.0 * (0.5 - q[1] * q[1] - q[2] * q[2]) - a[2],
    };
    double g[4] = {
        -2.0 * q[2] * f[0] + 2.0 * q[1] * f[1],
        2.0 * q[3] * f[0] + 2.0 * q[0] * f[1] - 4.0 * q[1] * f[2],
        -2.0 * q[0] * f[0] + 2.0 * q[3] * f[1] - 4.0 * q[2] * f[2],
        2.0 * q[1] * f[0] + 2.0 * q[2] * f[1],
    };
    double norm = sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2] + g[3] * g[3]);
    double k = norm > 1e-12 ? -2.0 * beta / norm : 0.0;  // qdot = q * rate / 2, so rate = 2 conj(q) qdot
    rate[0] = k * (q[0] * g[1] - q[1] * g[0] - q[2] * g[3] + q[3] * g[2]);
    rate[1] = k * (q[0] * g[2] + q[1] * g[3] - q[2] * g[0] - q[3] * g[1]);
    rate[2] = k * (q[0] * g[3] - q[1] * g[2] + q[2] * g[1] - q[3] * g[0]);
}

/// Covariance of tilt error and gyro bias, one axis for all: the classic two-state attitude filter.
typedef struct {
    double p_tilt, p_cross, p_bias;
} variance_t;

/// One step of the Kalman filter; r [rad^2] grows with the square of | |f| - g | / g. Returns the two gains.
static void kalman_gains(variance_t* p, double dt, double gyro_noise, double r, double* k_tilt, double* k_bias)
{
    p->p_tilt += dt * (gyro_noise * gyro_noise - 2.0 * p->p_cross + dt * p->p_bias);
    p->p_cross -= dt * p->p_bias;
    p->p_bias += dt * 1e-10;
    *k_tilt = p->p_tilt / (p->p_tilt + r);
    *k_bias = p->p_cross / (p->p_tilt + r);
    p->p_bias -= *k_bias * p->p_cross;
    p->p_cross *= 1.0 - *k_tilt;
    p->p_tilt *= 1.0 - *k_tilt;
}

/// Run an attitude filter over n samples of specific force [m/s2] and rate [rad/s], dt [s] apart, with a heading
/// reference [rad]. gain: Mahony kp [1/s], Madgwick beta [rad/s], Kalman sigma of the accelerometer's tilt [rad] at
/// 1 sample. q holds the first attitude and receives all [n, 4].
void attitude_filter(int kind, size_t n, double dt, double gain, double g, const double* acc, const double* gyro,
                     const double* yaw, double* q_out)
{
    double q[4], bias[3] = {0}, yaw_gain = 0.5;
    variance_t p = {1e-4, 0.0, 1e-8};
    memcpy(q, q_out, sizeof q);
    for (size_t k = 0; k < n; k++) {
        const double *f = acc + 3 * k, *w = gyro + 3 * k;
        double norm = sqrt(dot(f, f)), a[3] = {f[0] / norm, f[1] / norm, f[2] / norm}, up[3], e[3], rate[3];
        vertical(q, up);
        cross(a, up, e);
        for (int i = 0; i < 3; i++) { rate[i] = w[i] - bias[i]; }
        if (kind == MAHONY) {
            for (int i = 0; i < 3; i++) {
                bias[i] -= 0.02 * gain * gain * e[i] * dt;
                rate[i] += gain * e[i];
            }
        } else if (kind == MADGWICK) {
            double add[3];
            gradient(q, a, gain, add);
            for (int i = 0; i < 3; i++) { rate[i] += add[i]; }
        } else {
            double odd = (norm - g) / g, r = gain * gain * (1.0 + 1e4 * odd * odd), k_tilt, k_bias;
            kalman_gains(&p, dt, 2e-3, r, &k_tilt, &k_bias);
            for (int i = 0; i < 3; i++) {
                rate[i] += k_tilt / dt * e[i];
                bias[i] += k_bias * e[i];
            }
        }
        double off = remainder(yaw[k] - heading(q), 2.0 * M_PI), step[3];
        for (int i = 0; i < 3; i++) { step[i] = dt * (rate[i] + yaw_gain * off * up[i]); }
        turn(q, step);
        memcpy(q_out + 4 * k, q, sizeof q);
    }
}

/// Presliding friction (LuGre's bristle without its viscous part): state z [n], -1..1.2 and back, from the cable's
/// travel s [n, m]. reach [m]: sliding distance that turns the bristle; stribeck [m/s]: below it z rises to 1.2.
void friction_state(size_t n, double dt, double reach, double stribeck, const double* s, double* z)
{
    double state = 0.0;
    for (size_t k = 0; k < n; k++) {
        double step = k > 0 ? s[k] - s[k - 1] : 0.0, speed = step / dt;
        double most = 1.0 + 0.2 * exp(-(speed / stribeck) * (speed / stribeck));
        double share = 1.0 - exp(-fabs(step) / reach);
        state += share * ((step > 0.0 ? most : -most) - state) * (step != 0.0);
        z[k] = state;
    }
}

/// Bouc-Wen hysteresis of order 1: z [n] within -1..1, driven by x [n]; reach: change of x that turns it.
void bouc_wen(size_t n, double reach, const double* x, double* z)
{
    double state = 0.0;
    for (size_t k = 0; k < n; k++) {
        double d = k > 0 ? (x[k] - x[k - 1]) / reach : 0.0;
        int parts = 1 + (int)(fabs(d) * 20.0);
        for (int i = 0; i < parts; i++) {
            double dx = d / parts;
            state += dx - 0.6 * fabs(dx) * state - 0.4 * dx * fabs(state);
        }
        z[k] = state;
    }
}
