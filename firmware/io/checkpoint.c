// SPDX-License-Identifier: Apache-2.0
#include "checkpoint.h"

#include "atomic_file.h"
#include "config_file.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

enum { COUNT_MAX = 1 << 30 };  // chosen over all counts of windows, and so that one that begins there stays an int
enum { VERSION = 10, CRC_BYTES = 4, FILE_BYTES = sizeof(ipe_checkpoint_state_t) + CRC_BYTES };
static const char MAGIC[8] = "ipe-chk";
static const double PERIOD_MIN = 1e-9, PERIOD_MAX = (double)IPE_SECONDS_MAX;  // s: stamps are whole ns
static const double GYRO_BIAS_MAX = 1.0;                                      // rad/s, as in a configuration

// ---- state ----------------------------------------------------------------------------------------------------------

static void take_state(const ipe_checkpoint_t* c, const ipe_pipeline_t* p, ipe_checkpoint_state_t* s)
{
    memset(s, 0, sizeof *s);
    memcpy(s->magic, MAGIC, sizeof s->magic);
    s->version = VERSION;
    s->size = sizeof *s;
    s->fingerprint = c->fingerprint;
    s->estimator = p->estimator;
    memcpy(s->gyro_bias, p->config.gyro_bias, sizeof s->gyro_bias);
    s->period = p->window.period;
}

/// Time went by meanwhile: no window follows one from before.
static void give_state(const ipe_checkpoint_state_t* s, ipe_pipeline_t* p)
{
    ipe_pipeline_continue(p, &s->estimator, s->gyro_bias);
    ipe_window_set_period(&p->window, s->period);
}

/// What is read as a bool must be one.
static bool are_bools(const bool* values, size_t n)
{
    uint8_t byte;
    for (size_t i = 0; i < n; ++i) {
        memcpy(&byte, values + i, sizeof byte);
        if (byte > 1) { return false; }
    }
    return true;
}

static bool are_counts(const int* values, size_t n)
{
    for (size_t i = 0; i < n; ++i) {
        if (values[i] < 0 || values[i] > COUNT_MAX) { return false; }
    }
    return true;
}

static bool are_times(const int64_t* values, size_t n)
{
    for (size_t i = 0; i < n; ++i) {
        if (values[i] < 0 || values[i] > IPE_TIME_MAX_NS) { return false; }
    }
    return true;
}

/// Counts, times and flags are such as the estimator makes.
static bool has_plausible_counts(const ipe_estimator_t* e)
{
    const ipe_change_detector_t* d = &e->change_detector;
    const int counts[] = {d->n_level,        d->n_contest,      d->n_restless,        d->n_calm,  d->n_steps,
                          d->n_since_change, d->step.n_windows, e->pose_dwell.n_slow, e->n_delays};
    const int64_t times[] = {e->filter_states.t_ns, e->filter_states.drifted_ns, e->estimate.t_ns};
    return are_counts(counts, sizeof counts / sizeof counts[0]) &&
           are_counts(e->misfit_score.n_blocks, IPE_MISFIT_SCALES) &&
           are_times(times, sizeof times / sizeof times[0]) && are_times(e->misfit_score.begin_ns, IPE_MISFIT_SCALES) &&
           are_times(e->restored_ns, IPE_CABLES_MAX) && are_bools(&e->filter_states.has_patterns, 1) &&
           are_bools(e->estimate.observable, IPE_NP) && are_bools(&e->estimate.consistent, 1) &&
           are_bools(&e->estimate.is_misfit, 1) && are_bools(&e->estimate.is_provisional, 1);
}

static bool is_plausible(const ipe_checkpoint_state_t* s, const ipe_pipeline_t* p)
{
    const ipe_estimator_t *e = &s->estimator, *like = &p->estimator;
    bool good = e->rls.n == like->rls.n && ipe_rls_invariants_hold(&e->rls) && e->estimate.n_windows > 0 &&
                memcmp(&e->filter_states.layout, &like->filter_states.layout, sizeof like->filter_states.layout) == 0 &&
                e->estimate.n_systematic == ipe_systematic_count(p->config.n_cables) &&
                isfinite(e->change_detector.cusum) && isfinite(e->change_detector.level);
    for (int i = 0; i < IPE_NY; ++i) { good = good && e->noise.L[i][i] > 0.0 && isfinite(e->noise.L[i][i]); }
    for (int i = 0; i < 3; ++i) { good = good && fabs(s->gyro_bias[i]) <= GYRO_BIAS_MAX; }
    return good && has_plausible_counts(e) && s->period >= PERIOD_MIN && s->period <= PERIOD_MAX;
}

// ---- file -----------------------------------------------------------------------------------------------------------

static void write_file(ipe_checkpoint_t* c)
{
    char reason[256];
    uint8_t bytes[FILE_BYTES];
    memcpy(bytes, &c->state, sizeof c->state);
    const uint32_t crc = ipe_config_crc(bytes, sizeof c->state);
    memcpy(bytes + sizeof c->state, &crc, sizeof crc);
    if (ipe_atomic_file_write(c->path, bytes, sizeof bytes, reason, sizeof reason) == 0) {
        atomic_fetch_add(&c->n_written, 1);
        return;
    }
    atomic_fetch_add(&c->n_errors, 1);
    if (ipe_message_allowed(&c->limit, "--checkpoint")) { ipe_message("--checkpoint: %s", reason); }
}

static void* run(void* argument)
{
    ipe_checkpoint_t* c = argument;
    bool is_last = false;
    while (!is_last) {
        while (sem_wait(&c->wake) != 0) {}
        is_last = atomic_load(&c->is_closing);
        if (!atomic_load(&c->is_busy)) { continue; }
        write_file(c);
        atomic_store(&c->is_busy, false);
    }
    return NULL;
}

/// Bytes read, at most n; -1 with errno set.
static ssize_t read_file(const char* path, uint8_t* bytes, size_t n)
{
    const int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0) { return -1; }
    size_t done = 0;
    ssize_t got = 1;
    while (got > 0 && done < n) {
        got = read(fd, bytes + done, n - done);
        if (got > 0) { done += (size_t)got; }
    }
    const int cause = errno;
    (void)close(fd);
    errno = cause;
    return got < 0 ? -1 : (ssize_t)done;
}

static int refuse(const ipe_checkpoint_t* c, const char* reason, char* message, size_t size)
{
    (void)snprintf(message, size, "%s: %s; starting without it", c->path, reason);
    return -1;
}

int ipe_checkpoint_load(const ipe_checkpoint_t* c, ipe_pipeline_t* p, char* message, size_t size)
{
    ipe_checkpoint_state_t s;
    uint8_t bytes[FILE_BYTES + 1] = {0};
    uint32_t crc;
    const ssize_t n = read_file(c->path, bytes, sizeof bytes);
    if (n < 0 && errno == ENOENT) { return 0; }
    if (n < 0) { return refuse(c, strerror(errno), message, size); }
    if ((size_t)n < offsetof(ipe_checkpoint_state_t, fingerprint)) { return refuse(c, "torn", message, size); }
    memcpy(&s, bytes, sizeof s);
    if (memcmp(s.magic, MAGIC, sizeof s.magic) != 0) { return refuse(c, "not a checkpoint", message, size); }
    if (s.version != VERSION || s.size != sizeof s) { return refuse(c, "of another version", message, size); }
    memcpy(&crc, bytes + sizeof s, sizeof crc);
    if (n != FILE_BYTES || crc != ipe_config_crc(bytes, sizeof s)) {
        return refuse(c, "torn or damaged (CRC differs)", message, size);
    }
    if (s.fingerprint != c->fingerprint) { return refuse(c, "of another configuration", message, size); }
    if (!is_plausible(&s, p)) { return refuse(c, "holds values that cannot be", message, size); }
    give_state(&s, p);
    return 1;
}

// ---- open, save, close ----------------------------------------------------------------------------------------------

int ipe_checkpoint_open(ipe_checkpoint_t* c, const char* path, const uint8_t* config, size_t n, char* message,
                        size_t size)
{
    memset(c, 0, sizeof *c);
    c->path = path;
    ipe_checkpoint_configure(c, config, n);
    if (!ipe_atomic_file_check(path, message, size)) { return -1; }
    (void)sem_init(&c->wake, 0, 0);
    const int cause = pthread_create(&c->thread, NULL, run, c);
    if (cause == 0) { return 0; }
    (void)snprintf(message, size, "%s: cannot start the writer: %s", path, strerror(cause));
    return -1;
}

void ipe_checkpoint_configure(ipe_checkpoint_t* c, const uint8_t* config, size_t n)
{
    c->fingerprint = ((uint64_t)n << 32) | ipe_config_crc(config, n);
}

void ipe_checkpoint_save(ipe_checkpoint_t* c, const ipe_pipeline_t* p)
{
    if (p->estimator.estimate.n_windows == 0 || atomic_load(&c->is_busy) || !ipe_pipeline_invariants_hold(p)) {
        return;
    }
    take_state(c, p, &c->state);
    atomic_store(&c->is_busy, true);
    (void)sem_post(&c->wake);
}

int ipe_checkpoint_close(ipe_checkpoint_t* c, const ipe_pipeline_t* p)
{
    atomic_store(&c->is_closing, true);
    (void)sem_post(&c->wake);
    (void)pthread_join(c->thread, NULL);  // what it was writing is written
    (void)sem_destroy(&c->wake);
    if (p->estimator.estimate.n_windows == 0 || !ipe_pipeline_invariants_hold(p)) { return 0; }
    const uint64_t n_errors = atomic_load(&c->n_errors);
    take_state(c, p, &c->state);
    write_file(c);
    return atomic_load(&c->n_errors) == n_errors ? 0 : -1;
}

const char* ipe_checkpoint_counter(const ipe_checkpoint_t* c, unsigned index, uint64_t* value)
{
    const struct {
        const char* cause;
        uint64_t value;
    } counter[] = {
        {"written", atomic_load(&c->n_written)},
        {"errors", atomic_load(&c->n_errors)},
    };
    if (index >= sizeof counter / sizeof counter[0]) { return NULL; }
    *value = counter[index].value;
    return counter[index].cause;
}
