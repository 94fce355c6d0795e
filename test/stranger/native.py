# SPDX-License-Identifier: Apache-2.0
"""The C parts of the independent simulation, loaded from build/stranger (make stranger-native)."""

import ctypes
import subprocess
from functools import cache
from pathlib import Path

import numpy as np

TOP = Path(__file__).resolve().parents[2]
FILTERS = {"mahony": 0, "madgwick": 1, "kalman": 2}


@cache
def library() -> ctypes.CDLL:
    """Built on demand by the Makefile's rule."""
    subprocess.run(["make", "--no-print-directory", "-s", "build/stranger/native.so"], cwd=TOP, check=True)
    return ctypes.CDLL(str(TOP / "build/stranger/native.so"))


def _pointer(x: np.ndarray) -> ctypes.c_void_p:
    assert x.dtype == np.float64 and x.flags.c_contiguous
    return x.ctypes.data_as(ctypes.c_void_p)


def _size(n: int) -> ctypes.c_size_t:
    return ctypes.c_size_t(n)


def attitude_filter(
    kind: str, dt: float, gain: float, g: float, acc: np.ndarray, gyro: np.ndarray, yaw: np.ndarray, q0: np.ndarray
) -> np.ndarray:
    """Quaternions [N, 4], w x y z, body to world, of an attitude filter that starts at q0."""
    q = np.zeros((len(acc), 4))
    q[0] = q0
    acc, gyro, yaw = (np.ascontiguousarray(x, dtype=float) for x in (acc, gyro, yaw))
    library().attitude_filter(
        FILTERS[kind], _size(len(acc)), ctypes.c_double(dt), ctypes.c_double(gain), ctypes.c_double(g),
        _pointer(acc), _pointer(gyro), _pointer(yaw), _pointer(q),
    )  # fmt: skip
    return q


def friction_state(travel: np.ndarray, dt: float, reach: float, stribeck: float = 0.01) -> np.ndarray:
    """Presliding state [N] of a cable's friction from its travel [m]; near 1 while it is paid out."""
    travel, z = np.ascontiguousarray(travel, dtype=float), np.zeros(len(travel))
    library().friction_state(
        _size(len(z)), ctypes.c_double(dt), ctypes.c_double(reach), ctypes.c_double(stribeck), _pointer(travel),
        _pointer(z),
    )  # fmt: skip
    return z


def bouc_wen(x: np.ndarray, reach: float) -> np.ndarray:
    """Hysteresis state [N], -1..1, of a sensor loaded by x; reach: the change of x that turns it."""
    x, z = np.ascontiguousarray(x, dtype=float), np.zeros(len(x))
    library().bouc_wen(_size(len(z)), ctypes.c_double(reach), _pointer(x), _pointer(z))
    return z
