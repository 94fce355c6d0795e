# SPDX-License-Identifier: Apache-2.0
"""Random errors over time: independent streams by name, white noise, Gauss-Markov processes."""

import zlib

import numpy as np

from inertiad.base.table import Array


class Dice:
    """Independent random streams by name, so that a change to one sensor leaves the others' noise alone."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def __getitem__(self, name: str) -> np.random.Generator:
        """The stream of that name, from its beginning."""
        return np.random.default_rng([self._seed, zlib.crc32(name.encode())])


def white(density: float, rate: float, shape: tuple[int, ...], dice: np.random.Generator) -> Array:
    """White noise of a density [unit/rtHz] sampled at rate [Hz] behind its anti-aliasing filter."""
    return density * np.sqrt(0.5 * rate) * dice.standard_normal(shape)


def wander(sigma: float, time_constant: float, rate: float, n: int, dice: np.random.Generator) -> Array:
    """First-order Gauss-Markov process of standard deviation sigma, [n, 3], stationary from the start."""
    from scipy.signal import lfilter  # half a second that only a simulation should wait for

    keep = float(np.exp(-1.0 / (rate * time_constant)))
    drive = sigma * np.sqrt(1.0 - keep**2) * dice.standard_normal((n, 3))
    drive[0] /= np.sqrt(1.0 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], drive, axis=0))
