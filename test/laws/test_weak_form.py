# SPDX-License-Identifier: Apache-2.0
"""The weak form gives the same inertia at any sample rate; differentiating the rate does not."""

from functools import cache

import numpy as np
import pytest
from motion import NOMINAL, Motion, theta_of
from robots import checked, cogiro

import inertiad_core as core

THETA = theta_of(**NOMINAL)
RATES = [25, 100, 250, 1000]  # Hz
GYRO_NOISE = np.deg2rad(0.008)  # rad/s per root hertz
SECONDS = 15.0


@cache
def moved(seed, rate):
    """Times [s], specific force, rate and wrench at P."""
    motion = Motion.random(np.random.default_rng(seed))
    t = np.arange(int(SECONDS * rate)) / rate
    s, w = motion.specific_force(t), motion.rate(t)
    return t, s, w, core.regressor(s, w, motion.angular_acceleration(t)) @ THETA


def recorded(seed, rate, noise):
    """The same with white noise on the rate, per root hertz."""
    t, s, w, y = moved(seed, rate)
    white = np.random.default_rng(seed + 1000).normal(size=w.shape)
    return t, s, w + noise * np.sqrt(rate / 2) * white, y


def inertia_error(Y, y):
    """Of J [6], kg m2, by least squares."""
    return (np.linalg.lstsq(Y.reshape(-1, 10), y.ravel(), rcond=None)[0] - THETA)[4:]


def rms(errors):
    return np.sqrt(np.mean(np.square(list(errors))))


def weak_error(t, s, w, y):
    config = cogiro()
    config.sample_rate = 0.0
    windows = core.averages(checked(config), np.rint(1e9 * t).astype(np.int64), s, w, y)
    # Y is linear in s, alpha and w w^T: the averages of w w^T stand in for those of a single rate.
    Y = core.regressor(windows["s"], np.zeros_like(windows["w"]), windows["alpha"])
    Y += products(windows["ww"])
    return inertia_error(Y, windows["y"])


def products(ww):
    """The part of Y that w w^T makes, from its six entries, by Y's linearity in them."""
    unit = np.zeros((1, 3))
    parts = np.zeros((6, 6, 10))
    e = np.eye(3)
    for i in range(3):
        parts[i] = core.regressor(unit, e[i : i + 1], unit)[0]
    for k, (i, j) in zip((3, 4, 5), ((1, 2), (0, 2), (0, 1)), strict=True):
        both = core.regressor(unit, (e[i] + e[j])[None], unit)[0]
        parts[k] = both - parts[i] - parts[j]
    return np.einsum("nk,kij->nij", ww, parts)


def difference_error(t, s, w, y):
    """The same with the angular acceleration by central differences of the rate."""
    alpha = np.gradient(w, t, axis=0)
    return inertia_error(core.regressor(s, w, alpha), y)


def test_ideal_data_give_the_inertia_at_any_rate(measured):
    error = {rate: np.abs(weak_error(*recorded(1, rate, 0.0))).max() for rate in RATES}
    measured("weak form, ideal data: largest error of J " + ", ".join(f"{e:.0e} at {r} Hz" for r, e in error.items()))
    assert max(error.values()) < 1e-3


@pytest.mark.slow
def test_noisy_data_give_the_inertia_as_well_at_any_rate(measured):
    error = {rate: rms(weak_error(*recorded(k, rate, GYRO_NOISE)) for k in range(8)) for rate in RATES}
    measured("weak form, gyro noise: rms error of J " + ", ".join(f"{e:.4f} at {r} Hz" for r, e in error.items()))
    assert max(error.values()) < 2 * min(error.values())


def test_central_differences_fail_at_1_kHz(measured):
    plain = rms(difference_error(*recorded(k, 1000, GYRO_NOISE)) for k in range(4))
    weak = rms(weak_error(*recorded(k, 1000, GYRO_NOISE)) for k in range(4))
    measured(f"central differences, gyro noise, 1 kHz: rms error of J {plain:.0f} kg m2, weak form {weak:.4f}")
    assert plain > 20.0
    assert plain > 50 * weak
