// SPDX-License-Identifier: Apache-2.0
/// The estimator's state, kept in a file, so that a restart continues from it.
///
/// Kept: states and covariance of the filter, what is known of the noise, the change detector's sum, the gyro's bias as
/// tared, the measured sample period, the last estimate, the counters that belong to them. Not kept: samples, open windows, clock maps; they are
/// full again within seconds. The file is replaced atomically (atomic_file.h) by a thread of its own, so the estimator
/// waits for the disk only at the end. It fits one configuration, one version of this program and one kind of machine.
/// 25 KB of state, caller-allocated, no heap after open.
#ifndef IPE_CHECKPOINT_H
#define IPE_CHECKPOINT_H

#include "message.h"
#include "pipeline.h"

#include <pthread.h>
#include <semaphore.h>
#include <stdatomic.h>
#include <stddef.h>

/// The file: this, then the CRC-32 of these bytes, both in the machine's own byte order.
typedef struct {
    char magic[8];
    uint32_t version;      ///< raised with every change of what follows
    uint32_t size;         ///< of this
    uint64_t fingerprint;  ///< of the configuration
    ipe_estimator_t estimator;
    double gyro_bias[3];   ///< as configured or tared, I axes, rad/s
    double period;         ///< of the samples, s
} ipe_checkpoint_state_t;

typedef struct {
    const char* path;  ///< kept by pointer
    uint64_t fingerprint;
    pthread_t thread;
    sem_t wake;
    atomic_bool is_closing;
    atomic_bool is_busy;         ///< state belongs to the writer
    ipe_checkpoint_state_t state;
    _Atomic uint64_t n_written;  ///< times the file was replaced
    _Atomic uint64_t n_errors;   ///< times the file could not be written
    ipe_message_limit_t limit;
} ipe_checkpoint_t;

/// Check that path can be written and start the writer. Signals should be blocked: the thread inherits that.
///
///   config   in   the compiled configuration, n bytes: the file fits no other
///   message  out  one line on failure; size bytes, always terminated
///
/// 0 or -1.
int ipe_checkpoint_open(ipe_checkpoint_t* c, const char* path, const uint8_t* config, size_t n, char* message,
                        size_t size);

/// Continue from the file: p, just initialised from the same configuration, gets its state.
///
/// 1   p continues
/// 0   there is no file; p as it was
/// -1  the file is torn, damaged, of another configuration or version; p as it was, message says which
int ipe_checkpoint_load(const ipe_checkpoint_t* c, ipe_pipeline_t* p, char* message, size_t size);

/// From now on the file belongs to another configuration, n bytes.
void ipe_checkpoint_configure(ipe_checkpoint_t* c, const uint8_t* config, size_t n);

/// Hand p's state to the writer. Does nothing while that is still busy, before the first window, and when p is damaged.
void ipe_checkpoint_save(ipe_checkpoint_t* c, const ipe_pipeline_t* p);

/// Save p a last time, wait until it is on the disk, end the thread. 0, or -1: the last save failed.
int ipe_checkpoint_close(ipe_checkpoint_t* c, const ipe_pipeline_t* p);

/// A counter by index: its cause, and its value. NULL past the last. The names are stable.
const char* ipe_checkpoint_counter(const ipe_checkpoint_t* c, unsigned index, uint64_t* value);

#endif
