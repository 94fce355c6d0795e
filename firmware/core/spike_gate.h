// SPDX-License-Identifier: Apache-2.0
/// A spike: one sample far off the line through those before it, while the next one is back on that line.
///
///   e = x_k - (x_b + r (x_b - x_a)),  r = (t_k - t_b)/(t_b - t_a)     a, b: the two samples before
///   n = mean |e| of recent samples, each channel its own; e scaled to even spacing, |e| counted up to 3 n
///   suspect  |e| > max(12 n, least) in some channel
///   spike    the next sample's |e'| < |e|/4 there, from the same a, b: no step, no ramp, no oscillation below the sample rate
/// least lies over what quantisation and one hard sample of a real motion make. Learns for 32 samples before it suspects any.
/// 0.1 KB of state, 10 ns per sample of 8 channels, one thread.
#ifndef IPE_SPIKE_GATE_H
#define IPE_SPIKE_GATE_H

#include "types.h"

typedef struct {
    int n_channels;
    double least[IPE_CABLES_MAX];  ///< of |e|, each channel, in its unit
    double least_share;            ///< and of the channels' mean size
    float noise[IPE_CABLES_MAX];   ///< n
    int n_learnt;
} ipe_spike_gate_t;

/// Nothing learnt. n_channels 1 .. IPE_CABLES_MAX; least [n_channels] >= 0, least_share >= 0.
void ipe_spike_gate_init(ipe_spike_gate_t* g, int n_channels, const double* least, double least_share);

/// Look at the newest sample x, which came r times the spacing of a and b after b; a, b, x [n_channels]. Learns from it.
///
/// True: suspect, only the next sample can say. False also while learning and for r over 3, which no line reaches over.
bool ipe_spike_gate_is_suspect(ipe_spike_gate_t* g, const double* a, const double* b, const double* x, double r);

/// Judge the suspect x, r after b, by the next sample, r_next after b. No state changes.
///
/// Channels that stepped instead, bit i for channel i: far off the line in x and still in next. 0: a spike.
uint32_t ipe_spike_gate_stepped(const ipe_spike_gate_t* g, const double* a, const double* b, const double* x, double r,
                                const double* next, double r_next);

#endif
