// SPDX-License-Identifier: Apache-2.0
/// White noise of the IMU's signals, estimated from the signals.
///
/// Means of short blocks, an eighth of a quarter window, are differenced four times: motion slower than a window is
/// gone from them by the fourth power of its frequency, white noise comes through with 70 times its variance. A mean of
/// T s of white noise with density q has variance q/T, so q = T mean(d^2) / 70; the mean reaches back over 250 blocks.
/// Noise that the sensor itself has filtered is seen by its density around an eighth of a window's bandwidth.
/// 160 B of state, 6 ns per sample, one thread.
#ifndef IPE_NOISE_DENSITY_H
#define IPE_NOISE_DENSITY_H

enum { IPE_NOISE_DENSITY_CHANNELS = 6, IPE_NOISE_DENSITY_PAST = 4 };  ///< specific force and rate, P axes

typedef struct {
    float block[IPE_NOISE_DENSITY_CHANNELS];                         ///< sum of the open block's samples
    float past[IPE_NOISE_DENSITY_PAST][IPE_NOISE_DENSITY_CHANNELS];  ///< means of the blocks before, the last first
    float square[IPE_NOISE_DENSITY_CHANNELS];                        ///< mean of d^2
    int n_samples;                                                   ///< in the open block
    int n_past;
    int n_squares;                                                   ///< that square is the mean of, at most 250
} ipe_noise_density_t;

/// Take in one sample [6]; block_length is in samples, the same from call to call.
void ipe_noise_density_push(ipe_noise_density_t* x, const double value[IPE_NOISE_DENSITY_CHANNELS], int block_length);

/// A gap: the next sample does not follow the last. What is known of the noise stays.
void ipe_noise_density_restart(ipe_noise_density_t* x);

/// Noise density [6] of blocks of T s, (m/s2)^2/Hz and (rad/s)^2/Hz, two-sided; 0 until something is known.
void ipe_noise_density_density(const ipe_noise_density_t* x, double T, double density[IPE_NOISE_DENSITY_CHANNELS]);

#endif
