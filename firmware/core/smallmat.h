// SPDX-License-Identifier: Apache-2.0
/// Vectors of 3, 3x3 matrices, quaternions w x y z and a small Cholesky factor. Row-major, no aliasing of out with in.
#ifndef IPE_SMALLMAT_H
#define IPE_SMALLMAT_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>

static inline double vec3_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline double vec3_norm(const double a[3])
{
    return sqrt(vec3_dot(a, a));
}

static inline void vec3_cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/// out = a + k b
static inline void vec3_axpy(const double a[3], double k, const double b[3], double out[3])
{
    for (int i = 0; i < 3; ++i) { out[i] = a[i] + k * b[i]; }
}

/// out = R v
static inline void mat3_mul_vec(const double R[3][3], const double v[3], double out[3])
{
    for (int i = 0; i < 3; ++i) { out[i] = vec3_dot(R[i], v); }
}

/// out = R^T v
static inline void mat3_tmul_vec(const double R[3][3], const double v[3], double out[3])
{
    for (int i = 0; i < 3; ++i) { out[i] = R[0][i] * v[0] + R[1][i] * v[1] + R[2][i] * v[2]; }
}

/// out = A B
static inline void mat3_mul(const double A[3][3], const double B[3][3], double out[3][3])
{
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) { out[i][j] = A[i][0] * B[0][j] + A[i][1] * B[1][j] + A[i][2] * B[2][j]; }
    }
}

/// Rotation matrix of a unit quaternion w x y z.
static inline void mat3_from_quat(const double q[4], double R[3][3])
{
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    R[0][0] = 1.0 - 2.0 * (y * y + z * z), R[0][1] = 2.0 * (x * y - w * z), R[0][2] = 2.0 * (x * z + w * y);
    R[1][0] = 2.0 * (x * y + w * z), R[1][1] = 1.0 - 2.0 * (x * x + z * z), R[1][2] = 2.0 * (y * z - w * x);
    R[2][0] = 2.0 * (x * z - w * y), R[2][1] = 2.0 * (y * z + w * x), R[2][2] = 1.0 - 2.0 * (x * x + y * y);
}

/// Quaternion of R = Rz(yaw) Ry(pitch) Rx(roll).
static inline void quat_from_rpy(const double rpy[3], double q[4])
{
    const double cr = cos(0.5 * rpy[0]), sr = sin(0.5 * rpy[0]);
    const double cp = cos(0.5 * rpy[1]), sp = sin(0.5 * rpy[1]);
    const double cy = cos(0.5 * rpy[2]), sy = sin(0.5 * rpy[2]);
    q[0] = cr * cp * cy + sr * sp * sy;
    q[1] = sr * cp * cy - cr * sp * sy;
    q[2] = cr * sp * cy + sr * cp * sy;
    q[3] = cr * cp * sy - sr * sp * cy;
}

/// Rotation matrix of the rotation vector v (axis times angle, rad); Rodrigues' formula with its series near zero.
static inline void mat3_exp(const double v[3], double R[3][3])
{
    const double angle2 = vec3_dot(v, v);
    const double angle = sqrt(angle2);
    const double a = angle2 < 1e-8 ? 1.0 - angle2 / 6.0 : sin(angle) / angle;
    const double b = angle2 < 1e-8 ? 0.5 - angle2 / 24.0 : (1.0 - cos(angle)) / angle2;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) { R[i][j] = b * v[i] * v[j] + (i == j ? 1.0 - b * angle2 : 0.0); }
    }
    R[0][1] -= a * v[2], R[0][2] += a * v[1];
    R[1][0] += a * v[2], R[1][2] -= a * v[0];
    R[2][0] -= a * v[1], R[2][1] += a * v[0];
}

/// Lower Cholesky factor in place of the symmetric n x n matrix A (row-major, only the lower triangle is read).
/// The strict upper triangle is left as it was. False, with A spoiled, if A is not positive definite.
static inline bool cholesky(double* A, size_t n)
{
    for (size_t j = 0; j < n; ++j) {
        for (size_t i = j; i < n; ++i) {
            double sum = A[i * n + j];
            for (size_t k = 0; k < j; ++k) { sum -= A[i * n + k] * A[j * n + k]; }
            if (i == j) {
                if (!(sum > 0.0)) { return false; }
                A[j * n + j] = sqrt(sum);
            } else {
                A[i * n + j] = sum / A[j * n + j];
            }
        }
    }
    return true;
}

/// Lower Cholesky factor A of S + L L^T (n x n, row-major; of S and of the lower triangular L only the lower triangles are
/// read). The strict upper triangle of A is left as it was. False, with A spoiled, if the sum is not positive definite.
static inline bool cholesky_of_sum(const double* S, const double* L, size_t n, double* A)
{
    for (size_t i = 0; i < n; ++i) {
        for (size_t j = 0; j <= i; ++j) {
            A[i * n + j] = S[i * n + j];
            for (size_t k = 0; k <= j; ++k) { A[i * n + j] += L[i * n + k] * L[j * n + k]; }
        }
    }
    return cholesky(A, n);
}

/// v = L^-1 v of a lower triangular L (n x n, row-major).
static inline void substitute_forward(const double* L, size_t n, double* v)
{
    for (size_t i = 0; i < n; ++i) {
        for (size_t k = 0; k < i; ++k) { v[i] -= L[i * n + k] * v[k]; }
        v[i] /= L[i * n + i];
    }
}

/// x = A^-1 b, given A's lower Cholesky factor L (n x n, row-major). x may be b.
static inline void cholesky_solve(const double* L, size_t n, const double* b, double* x)
{
    for (size_t i = 0; i < n; ++i) {
        double sum = b[i];
        for (size_t k = 0; k < i; ++k) { sum -= L[i * n + k] * x[k]; }
        x[i] = sum / L[i * n + i];
    }
    for (size_t i = n; i-- > 0;) {
        for (size_t k = i + 1; k < n; ++k) { x[i] -= L[k * n + i] * x[k]; }
        x[i] /= L[i * n + i];
    }
}

/// Eigenvalues, on A's diagonal, and eigenvectors, V's columns, of the symmetric n x n matrix A (row-major), by cyclic
/// Jacobi rotations until nothing is left beside the diagonal. A is spoiled.
static inline void symmetric_eigen(double* A, double* V, size_t n)
{
    double scale = 0.0, off = 1.0;
    for (size_t i = 0; i < n * n; ++i) {
        V[i] = i % (n + 1) == 0 ? 1.0 : 0.0;
        scale += A[i] * A[i];
    }
    for (int sweep = 0; sweep < 12 && off > 1e-32 * scale; ++sweep) {
        off = 0.0;
        for (size_t p = 0; p + 1 < n; ++p) {
            for (size_t q = p + 1; q < n; ++q) {
                const double beside = A[p * n + q];
                if (fabs(beside) < 1e-300) { continue; }
                off += beside * beside;
                const double ratio = (A[q * n + q] - A[p * n + p]) / (2.0 * beside);
                const double t = copysign(1.0, ratio) / (fabs(ratio) + sqrt(1.0 + ratio * ratio));
                const double c = 1.0 / sqrt(1.0 + t * t), s = t * c;
                for (size_t k = 0; k < n; ++k) {
                    const double kp = A[k * n + p], kq = A[k * n + q];
                    A[k * n + p] = c * kp - s * kq, A[k * n + q] = s * kp + c * kq;
                }
                for (size_t k = 0; k < n; ++k) {
                    const double pk = A[p * n + k], qk = A[q * n + k], vp = V[k * n + p], vq = V[k * n + q];
                    A[p * n + k] = c * pk - s * qk, A[q * n + k] = s * pk + c * qk;
                    V[k * n + p] = c * vp - s * vq, V[k * n + q] = s * vp + c * vq;
                }
            }
        }
    }
}

/// True when all n values are finite.
static inline bool all_finite(const double* v, size_t n)
{
    for (size_t i = 0; i < n; ++i) {
        if (!isfinite(v[i])) { return false; }
    }
    return true;
}

#endif
