// SPDX-License-Identifier: Apache-2.0
// A platform on elastic cables of lumped masses that are paid out over pulleys. World axes throughout: the body by its
// momentum and angular momentum about the CoG, the cables by Newton's law for each mass. Nothing of the product is used.
//
// A cable is material: node k sits k * spacing of unstretched cable away from the platform. Where cable is paid out, a
// node comes out of the pulley with the cable's own speed; the piece between pulley and first node is 0.5 to 1.6
// spacings long. With spacing 0 the cable is a straight spring without mass.

#include <math.h>
#include <stddef.h>
#include <string.h>

enum { CABLES = 8, NODES = 48 };

typedef struct {
    double mass, cog[3], inertia[9], inertia_inverse[9];  ///< P axes; inertia about the CoG
} plant_body_t;

typedef struct {
    double gravity, dt, settle, radius, density, stiffness, damping_time, drag, spacing;
    double anchor[CABLES][3], attachment[CABLES][3], axis[CABLES][3];
    double hose_pull[3], hose_rate, hose_at[3], hose_home[3], lean_at[3], kick[6], start[3];
    double change;
    plant_body_t body[2];
    int n_cables, n_fine, length_steps;
    double fine_dt, length_dt;
} plant_t;

/// One instant as the sensors could see it.
typedef struct {
    double p[3], R[9], v[3], a[3], omega[3], alpha[3];
    double tension[CABLES], top[CABLES], wrap[CABLES], energy;
} plant_row_t;

typedef struct {
    int n;
    double x[NODES][3], v[NODES][3];  ///< node 0 is next to the platform
} cable_t;

typedef struct {
    double c[3], v[3], q[4], L[3], R[9], omega[3];  ///< CoG, its velocity, attitude, angular momentum
    double a[3], alpha[3];
    cable_t cable[CABLES];
    double tension[CABLES], top[CABLES], wrap[CABLES], elastic;
} plant_state_t;

static double dot3(const double* a, const double* b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross3(const double* a, const double* b, double* c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static void times(const double* R, const double* x, double* y)
{
    for (int i = 0; i < 3; i++) { y[i] = dot3(R + 3 * i, x); }
}

static void times_transposed(const double* R, const double* x, double* y)
{
    for (int i = 0; i < 3; i++) { y[i] = R[i] * x[0] + R[3 + i] * x[1] + R[6 + i] * x[2]; }
}

static void rotation_of(const double* q, double* R)
{
    double w = q[0], x = q[1], y = q[2], z = q[3];
    double rows[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                      2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                      2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    memcpy(R, rows, sizeof rows);
}

/// omega from the angular momentum, world axes.
static void spin(plant_state_t* s, const plant_body_t* body)
{
    double local[3], w[3];
    times_transposed(s->R, s->L, local);
    times(body->inertia_inverse, local, w);
    times(s->R, w, s->omega);
}

/// Where the cable to X leaves the pulley, and the arc [rad] it covers.
static double leave(const plant_t* k, int i, const double* X, double* T)
{
    const double *A = k->anchor[i], *up = k->axis[i];
    double d[3] = {X[0] - A[0], X[1] - A[1], X[2] - A[2]}, h = dot3(d, up), e[3], across;
    for (int j = 0; j < 3; j++) { e[j] = d[j] - h * up[j]; }
    across = sqrt(dot3(e, e));
    double r = k->radius, far = hypot(across - r, h), at = atan2(h, across - r) + acos(fmin(r / far, 1.0));
    for (int j = 0; j < 3; j++) { T[j] = A[j] + e[j] / across * (r + r * cos(at)) + up[j] * r * sin(at); }
    return M_PI - at;
}

/// Tension of a piece of cable between two ends, with its damping; unit vector from a to b. 0: slack.
static double pull(const plant_t* k, const double* a, const double* va, const double* b, const double* vb, double rest,
                   double* u, double* elastic)
{
    double d[3], rate[3];
    for (int j = 0; j < 3; j++) {
        d[j] = b[j] - a[j];
        rate[j] = vb[j] - va[j];
    }
    double length = sqrt(dot3(d, d));
    for (int j = 0; j < 3; j++) { u[j] = d[j] / length; }
    double strain = length / rest - 1.0;
    if (strain <= 0.0) { return 0.0; }
    *elastic += 0.5 * k->stiffness * strain * strain * rest;
    return fmax(k->stiffness * (strain + k->damping_time * dot3(rate, u) / rest), 0.0);
}

/// Nodes come out of the pulley and go back into it as the free length asks.
static void renew(const plant_t* k, int i, cable_t* c, double free_length, double speed)
{
    double first = free_length - c->n * k->spacing, T[3];
    if (first > 1.6 * k->spacing && c->n + 1 < NODES) {
        const double* x = c->x[c->n - 1];
        leave(k, i, x, T);
        double share = k->spacing / first, u[3], length;
        for (int j = 0; j < 3; j++) { u[j] = x[j] - T[j]; }
        length = sqrt(dot3(u, u));
        for (int j = 0; j < 3; j++) {
            c->x[c->n][j] = x[j] + share * (T[j] - x[j]);
            c->v[c->n][j] = (1.0 - share) * c->v[c->n - 1][j] + share * speed * u[j] / length;
        }
        c->n++;
    } else if (first < 0.5 * k->spacing && c->n > 1) {
        c->n--;
    }
}

/// One cable: moves its nodes by dt and gives the force on the platform.
static void step_cable(const plant_t* k, plant_state_t* s, int i, const double* B, const double* vB, const double* aB,
                       double length, double speed, double drag, double* force)
{
    cable_t* c = &s->cable[i];
    double T[3], still[3] = {0}, u[3], zero_g[3] = {0.0, 0.0, -k->gravity};
    int n = c->n;
    s->wrap[i] = leave(k, i, n ? c->x[n - 1] : B, T);
    double free_length = length - k->radius * s->wrap[i], first = free_length - n * k->spacing;
    if (k->spacing == 0.0) {
        // The straight spring's rest length changes with the winch: its damping acts on the strain.
        double into[3], d[3] = {B[0] - T[0], B[1] - T[1], B[2] - T[2]}, far = sqrt(dot3(d, d));
        for (int j = 0; j < 3; j++) { into[j] = speed * d[j] / far; }
        double f = pull(k, B, vB, T, into, free_length, u, &s->elastic);
        // into points along the paid-out cable: the pulley's end of the material moves towards the platform
        for (int j = 0; j < 3; j++) { force[j] = f * u[j]; }
        s->tension[i] = s->top[i] = f;
        return;
    }
    double f[NODES + 1],
        along[NODES + 1][3];  // piece j: from end j (0: platform) to the next node, the last to the pulley
    for (int j = 0; j <= n; j++) {
        const double *a = j ? c->x[j - 1] : B, *va = j ? c->v[j - 1] : vB;
        const double* b = j < n ? c->x[j] : T;
        double rest = j < n ? k->spacing : first, out[3];
        memcpy(out, j < n ? c->v[j] : still, sizeof out);
        if (j == n) {
            double d[3] = {a[0] - T[0], a[1] - T[1], a[2] - T[2]}, far = sqrt(dot3(d, d));
            for (int l = 0; l < 3; l++) { out[l] = speed * d[l] / far; }
        }
        f[j] = pull(k, a, va, b, out, rest, along[j], &s->elastic);
    }
    double end = 0.5 * k->density * k->spacing;
    for (int j = 0; j < 3; j++) { force[j] = f[0] * along[0][j] + end * (zero_g[j] - aB[j]); }
    s->tension[i] = sqrt(dot3(force, force));
    s->top[i] = f[n] + 0.5 * k->density * first * k->gravity * along[n][2];
    for (int j = 0; j < n; j++) {
        double m = k->density * 0.5 * (k->spacing + (j + 1 < n ? k->spacing : first));
        for (int l = 0; l < 3; l++) {
            double a = (f[j + 1] * along[j + 1][l] - f[j] * along[j][l]) / m + zero_g[l] - drag * c->v[j][l];
            c->v[j][l] += k->dt * a;
            c->x[j][l] += k->dt * c->v[j][l];
        }
    }
    renew(k, i, c, free_length, speed);
}

/// World position, velocity and acceleration of a point [P] of the body.
static void point_of(const plant_state_t* s, const plant_body_t* body, const double* point, double* x, double* v,
                     double* a)
{
    double local[3], r[3], w[3], ww[3], t[3];
    for (int j = 0; j < 3; j++) { local[j] = point[j] - body->cog[j]; }
    times(s->R, local, r);
    cross3(s->omega, r, w);
    cross3(s->omega, w, ww);
    cross3(s->alpha, r, t);
    for (int j = 0; j < 3; j++) {
        x[j] = s->c[j] + r[j];
        v[j] = s->v[j] + w[j];
        a[j] = s->a[j] + t[j] + ww[j];
    }
}

/// Kinetic, elastic and potential energy of body and cables.
static double energy_of(const plant_t* k, const plant_state_t* s, const plant_body_t* body, const double* length)
{
    double e = 0.5 * body->mass * dot3(s->v, s->v) + 0.5 * dot3(s->L, s->omega) + s->elastic;
    e += body->mass * k->gravity * s->c[2];
    for (int i = 0; i < k->n_cables && k->spacing > 0.0; i++) {
        const cable_t* c = &s->cable[i];
        double first = length[i] - k->radius * s->wrap[i] - c->n * k->spacing, x[3], v[3], a[3];
        point_of(s, body, k->attachment[i], x, v, a);
        e += 0.5 * k->density * k->spacing * (0.5 * dot3(v, v) + k->gravity * x[2]);
        e += 0.5 * k->density * first * k->gravity * k->anchor[i][2];
        for (int j = 0; j < c->n; j++) {
            double m = k->density * 0.5 * (k->spacing + (j + 1 < c->n ? k->spacing : first));
            e += m * (0.5 * dot3(c->v[j], c->v[j]) + k->gravity * c->x[j][2]);
        }
    }
    return e;
}

/// One step; push: N, at the lean point. resist [1/s] brakes the body while it settles.
static void step(const plant_t* k, plant_state_t* s, const plant_body_t* body, const double* length,
                 const double* speed, const double* push, double resist)
{
    double F[3] = {push[0], push[1], push[2] - body->mass * k->gravity}, M[3] = {0}, x[3], v[3], a[3], arm[3], m[3];
    point_of(s, body, k->lean_at, x, v, a);
    for (int j = 0; j < 3; j++) { arm[j] = x[j] - s->c[j]; }
    cross3(arm, push, M);
    point_of(s, body, k->hose_at, x, v, a);
    double hose[3];
    for (int j = 0; j < 3; j++) {
        hose[j] = k->hose_pull[j] - k->hose_rate * (x[j] - k->hose_home[j]);
        arm[j] = x[j] - s->c[j];
        F[j] += hose[j];
    }
    cross3(arm, hose, m);
    for (int j = 0; j < 3; j++) { M[j] += m[j]; }
    s->elastic = 0.0;
    for (int i = 0; i < k->n_cables; i++) {
        double force[3];
        point_of(s, body, k->attachment[i], x, v, a);
        step_cable(k, s, i, x, v, a, length[i], speed[i], k->drag + resist, force);
        for (int j = 0; j < 3; j++) {
            arm[j] = x[j] - s->c[j];
            F[j] += force[j];
        }
        cross3(arm, force, m);
        for (int j = 0; j < 3; j++) { M[j] += m[j]; }
    }
    // alpha = J^-1 (M - omega x L), world axes
    double gyro[3], local[3], w[3];
    cross3(s->omega, s->L, gyro);
    for (int j = 0; j < 3; j++) {
        s->a[j] = F[j] / body->mass - resist * s->v[j];
        gyro[j] = M[j] - gyro[j];
    }
    times_transposed(s->R, gyro, local);
    times(body->inertia_inverse, local, w);
    times(s->R, w, s->alpha);
    for (int j = 0; j < 3; j++) {
        s->v[j] += k->dt * s->a[j];
        s->c[j] += k->dt * s->v[j];
        s->L[j] += k->dt * (M[j] - resist * s->L[j]);
    }
    spin(s, body);
    double *q = s->q, *o = s->omega, h = 0.5 * k->dt, d[4];
    d[0] = -h * (o[0] * q[1] + o[1] * q[2] + o[2] * q[3]);
    d[1] = h * (o[0] * q[0] + o[1] * q[3] - o[2] * q[2]);
    d[2] = h * (o[1] * q[0] + o[2] * q[1] - o[0] * q[3]);
    d[3] = h * (o[2] * q[0] + o[0] * q[2] - o[1] * q[1]);
    double norm = 0.0;
    for (int j = 0; j < 4; j++) {
        q[j] += d[j];
        norm += q[j] * q[j];
    }
    for (int j = 0; j < 4; j++) { q[j] /= sqrt(norm); }
    rotation_of(q, s->R);
    spin(s, body);
}

static void place(const plant_t* k, plant_state_t* s, const double* length)
{
    const plant_body_t* body = &k->body[0];
    memset(s, 0, sizeof *s);
    s->q[0] = 1.0;
    rotation_of(s->q, s->R);
    for (int j = 0; j < 3; j++) { s->c[j] = k->start[j] + body->cog[j]; }
    for (int i = 0; i < k->n_cables && k->spacing > 0.0; i++) {
        cable_t* c = &s->cable[i];
        double B[3], v[3], a[3], T[3];
        point_of(s, body, k->attachment[i], B, v, a);
        double free_length = length[i] - k->radius * leave(k, i, B, T);
        c->n = (int)(free_length / k->spacing - 0.5);
        c->n = c->n < 1 ? 1 : c->n >= NODES ? NODES - 1 : c->n;
        for (int j = 0; j < c->n; j++) {
            double share = (j + 1) * k->spacing / free_length;
            for (int l = 0; l < 3; l++) { c->x[j][l] = B[l] + share * (T[l] - B[l]); }
        }
    }
}

/// The body changes while it moves: its material points keep their velocities.
static void change_body(plant_state_t* s, const plant_body_t* was, const plant_body_t* now)
{
    double x[3], v[3], a[3], local[3], turned[3];
    point_of(s, was, now->cog, x, v, a);
    memcpy(s->c, x, sizeof x);
    memcpy(s->v, v, sizeof v);
    times_transposed(s->R, s->omega, local);
    times(now->inertia, local, turned);
    times(s->R, turned, s->L);
}

/// Settle, then run: lengths [length_steps, n_cables] are unstretched cable from anchor to platform, length_dt apart;
/// push [n_fine, 3]; rows [n_fine], fine_dt apart.
void plant_run(const plant_t* k, const double* lengths, const double* push, plant_row_t* rows)
{
    static _Thread_local plant_state_t state;
    plant_state_t* s = &state;
    const plant_body_t* body = &k->body[0];
    double none[3] = {0}, zero[CABLES] = {0}, origin[3] = {0}, v[3];
    int m = k->n_cables, now = 0, n_settle = (int)(k->settle / k->dt);
    place(k, s, lengths);
    for (int i = 0; i < n_settle; i++) {
        step(k, s, body, lengths, zero, none, 6.0 * (1.0 - (double)i / n_settle) + 0.5);
    }
    double local[3], turned[3], w[3] = {k->kick[3], k->kick[4], k->kick[5]};
    for (int j = 0; j < 3; j++) { s->v[j] += k->kick[j]; }
    times_transposed(s->R, w, local);
    times(body->inertia, local, turned);
    times(s->R, turned, w);
    for (int j = 0; j < 3; j++) { s->L[j] += w[j]; }
    spin(s, body);
    int per_row = (int)lround(k->fine_dt / k->dt);
    for (int row = 0; row < k->n_fine; row++) {
        for (int sub = 0; sub < per_row; sub++) {
            double t = row * k->fine_dt + sub * k->dt, at = t / k->length_dt, length[CABLES], speed[CABLES];
            int i0 = (int)at < k->length_steps - 2 ? (int)at : k->length_steps - 2;
            double share = fmin(at - i0, 1.0);
            for (int i = 0; i < m; i++) {
                double l0 = lengths[i0 * m + i], l1 = lengths[(i0 + 1) * m + i];
                length[i] = l0 + share * (l1 - l0);
                speed[i] = (l1 - l0) / k->length_dt;
            }
            if (now == 0 && t >= k->change) {
                now = 1;
                change_body(s, body, &k->body[1]);
                body = &k->body[1];
                spin(s, body);
            }
            step(k, s, body, length, speed, push + 3 * row, 0.0);
            if (sub > 0) { continue; }
            plant_row_t* r = &rows[row];
            point_of(s, body, origin, r->p, v, r->a);
            memcpy(r->v, v, sizeof v);
            memcpy(r->R, s->R, sizeof s->R);
            memcpy(r->omega, s->omega, sizeof s->omega);
            memcpy(r->alpha, s->alpha, sizeof s->alpha);
            memcpy(r->tension, s->tension, sizeof s->tension);
            memcpy(r->top, s->top, sizeof s->top);
            memcpy(r->wrap, s->wrap, sizeof s->wrap);
            r->energy = energy_of(k, s, body, length);
        }
    }
}

size_t plant_size(int what)
{
    return what == 0 ? sizeof(plant_t) : sizeof(plant_row_t);
}
