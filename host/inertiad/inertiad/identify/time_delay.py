# SPDX-License-Identifier: Apache-2.0
"""Delay of a tracker's stamps against the IMU's, from the motion alone: maximum likelihood over whole stretches.

    x_j = y(t_j - d) + noise,   y = p + A (l + dl),   p'' = A (s - b_a) - g z + e,   A = exp(theta) A_gyro(w - b_g)
s, w: specific force and rate as measured, I axes; A: I to W; l: from the IMU to the tracked point, I axes. Unknown
beside the delay d are start position and velocity, the biases b_a, b_g, the lever's error dl, and two random processes
in W, linear between knots: theta, a random walk (gyro noise, attitude error at the start), and e, white (accelerometer
noise). The levels of both and of the tracker's noise are learnt from the stretch itself (EM for the variance
components), so the error bar needs no data sheet. Solved by Gauss-Newton; the whole stretch is predicted anew in every
step.

The bar holds the model's variance plus what the residuals' correlation over time adds to it (Newey, West 1987).
Neither forces nor the body enter. Idea of estimating a fraction of a sample period in batch: Furgale, Rehder, Siegwart,
IROS 2013.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline, make_interp_spline
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtpqrt
from scipy.spatial.transform import Rotation

from inertiad.base.table import Array

STRETCH: Final = 30.0
"""s at most that are solved at once"""
SHORTEST: Final = 5.0
"""s below which a stretch is left out"""
IMU_GAP: Final = 0.2
"""s without an IMU sample: a new stretch begins"""
KNOT: Final = 0.25
"""s between the knots of the random processes. What these do between knots is in no bar: with good sensors at 1 kHz a
stretch's error is 1.3 to 1.5 times its sigma with knots every 1 s, 1.1 times with 0.25 s."""
GRID_HZ: Final = 200.0
"""least rate at which rate and force are integrated; slower samples are joined by a cubic spline first"""
JACOBIAN_STEP: Final = 0.01
"""s"""
BIN: Final = 0.025
"""s over which residuals are averaged: the derivatives hardly change in it"""
N_STEPS: Final = 12
N_LEARN: Final = 40
"""EM steps per Gauss-Newton step, at most"""
LEARNT: Final = 1e-3
"""relative change of the levels at which EM stops"""
N_FIRST: Final = 2
"""Gauss-Newton steps before the levels are learnt: far from the solution they would only hide it"""
NOISE_LEAST: Final = 1e-9
"""m, the last digit of tracker.csv: positions that do not change at all have no noise"""
QR_BLOCK: Final = 32
"""columns that the factorisation takes at once, LAPACK's usual block"""
CONVERGED: Final = 0.02
"""sigmas of the delay"""
DELAY_STD: Final = 0.3
"""s, prior"""
START_STD: Final = 10.0
"""m and m/s, prior of position, counted from the first, and velocity at the start: far more than any"""
TILT_STD: Final = 0.1
"""rad, prior of the attitude at the start, around the IMU's"""
ACC_NOISE: Final = 2e-3
"""m/s2 averaged over a knot's interval, where learning begins"""
WALK_NOISE: Final = 3e-4
"""rad per root second, where learning begins"""
CORRELATED: Final = 0.5
"""s over which the tracker's errors may be correlated"""


@dataclass(frozen=True)
class Imu:
    """Samples at times t [N] s, I axes."""

    t: Array
    acc: Array
    """specific force, m/s2 [N, 3]"""
    gyro: Array
    """rad/s [N, 3]"""
    q: Array
    """I to W, w x y z [N, 4]; only each stretch's first is used"""


@dataclass(frozen=True)
class Prior:
    """One sigma each, and known constants."""

    gravity: float
    """m/s2"""
    lever: Array
    """m, IMU to tracked point, I axes [3]"""
    acc_bias: float
    gyro_bias: float
    lever_std: float


@dataclass(frozen=True)
class Delay:
    """s from the measured instant to the tracker's stamp, on the IMU's clock."""

    value: float
    std: float
    tracker_noise: float
    """m, each axis, as the residuals have it"""
    n_samples: int
    n_stretches: int


@dataclass
class Levels:
    """Variances, learnt."""

    noise: float = 1e-6
    """m2"""
    walk: float = WALK_NOISE**2
    white: float = ACC_NOISE**2


def _integral(t: Array, x: Array) -> Array:
    """Of x [N, ...] from t[0], trapezoids."""
    dt = np.diff(t).reshape(-1, *[1] * (x.ndim - 1))
    return np.concatenate([np.zeros_like(x[:1]), np.cumsum(0.5 * dt * (x[1:] + x[:-1]), axis=0)])


def _attitude(t: Array, w: Array, start: Rotation) -> Rotation:
    """Rates [N, 3] in body axes integrated from start; second order in the rate's change."""
    dt = np.diff(t)[:, None]
    turn = Rotation.from_rotvec(0.5 * dt * (w[1:] + w[:-1]) + dt**2 / 12.0 * np.cross(w[:-1], w[1:]))
    found, reach = Rotation.concatenate([start, turn]), 1
    while reach < len(t):  # products of ever more neighbours
        found = Rotation.concatenate([found[:reach], found[:-reach] * found[reach:]])
        reach *= 2
    return found


def _resampled(imu: Imu) -> Imu:
    """At least GRID_HZ."""
    step = float(np.median(np.diff(imu.t)))
    if step * GRID_HZ <= 1.0:
        return imu
    n = int(np.ceil(step * GRID_HZ))
    t = np.concatenate([(imu.t[:-1, None] + np.diff(imu.t)[:, None] * np.arange(n) / n).ravel(), imu.t[-1:]])
    both = make_interp_spline(imu.t, np.hstack([imu.acc, imu.gyro]), k=3)(t)
    return Imu(t, both[:, :3], both[:, 3:], imu.q)


def _hats(t: Array, knots: Array) -> Array:
    """Piecewise linear functions, 1 at one knot, [N, K]."""
    return np.stack([np.interp(t, knots, row) for row in np.eye(len(knots))], axis=1)


class Stretch:
    """One stretch of data: parameters in, predicted positions and their derivatives out.

    Parameters: delay; start position 3, velocity 3; acc bias 3, gyro bias 3, lever 3; theta at the first knot and its
    steps [K, 3]; e at the knots [K, 3].
    """

    N_FIXED: Final = 16

    def __init__(self, imu: Imu, t: Array, x: Array, prior: Prior) -> None:
        self.imu, self.t, self.x, self.prior = _resampled(imu), t, x - x[0], prior
        n = max(2, round((imu.t[-1] - imu.t[0]) / KNOT) + 1)
        self.knots = np.linspace(imu.t[0], imu.t[-1], n)
        self.spacing = float(self.knots[1] - self.knots[0])
        self.start = Rotation.from_quat(imu.q[0], scalar_first=True)
        self.coarse = np.linspace(imu.t[0], imu.t[-1], int((imu.t[-1] - imu.t[0]) / JACOBIAN_STEP) + 1)
        self.hats = _hats(self.coarse, self.knots)
        self.theta = np.zeros(self.N_FIXED + 6 * n)
        self.levels = Levels()
        number = np.floor((t - t[0]) / BIN).astype(np.int64)
        self.first = np.flatnonzero(np.diff(number, prepend=-1))
        self.count = np.diff(self.first, append=len(t)).astype(float)
        self.t_bin = np.add.reduceat(t, self.first) / self.count
        turned = Rotation.from_quat(imu.q[:-1], scalar_first=True).inv() * Rotation.from_quat(
            imu.q[1:], scalar_first=True
        )
        self.theta[10:13] = imu.gyro.mean(axis=0) - turned.as_rotvec().sum(axis=0) / (imu.t[-1] - imu.t[0])

    @property
    def n_knots(self) -> int:
        return len(self.knots)

    def _processes(self, theta: Array) -> tuple[Array, Array]:
        """Attitude error and acceleration error at the knots, [K, 3] each."""
        steps, e = theta[self.N_FIXED :].reshape(2, self.n_knots, 3)
        return np.cumsum(steps, axis=0), e

    def _path(self) -> tuple[Rotation, Array, CubicHermiteSpline]:
        """Attitude and force in W at the IMU's samples, and the tracked point's place over time."""
        imu, theta = self.imu, self.theta
        tilt, e = self._processes(theta)
        tilted = Rotation.from_rotvec(np.stack([np.interp(imu.t, self.knots, c) for c in tilt.T], axis=1))
        A = tilted * _attitude(imu.t, imu.gyro - theta[10:13], self.start)
        force = A.apply(imu.acc - theta[7:10])
        a = force + np.stack([np.interp(imu.t, self.knots, c) for c in e.T], axis=1)
        a[:, 2] -= self.prior.gravity
        v = theta[4:7] + _integral(imu.t, a)
        dt = np.diff(imu.t)[:, None]
        p = theta[1:4] + _integral(imu.t, v)
        p[1:] -= np.cumsum(dt**2 / 12.0 * np.diff(a, axis=0), axis=0)
        lever = self.prior.lever + theta[13:16]
        path = CubicHermiteSpline(imu.t, p + A.apply(lever), v + A.apply(np.cross(imu.gyro - theta[10:13], lever)))
        return A, force, path

    def _binned(self, e: Array) -> tuple[Array, float]:
        """Residuals [3 B] of the bins, in units of a sample's noise, of residuals e [N, 3]; squares within the bins."""
        binned = np.add.reduceat(e, self.first, axis=0) / np.sqrt(self.count)[:, None]
        return binned.ravel(), float((e**2).sum() - (binned**2).sum())

    def predict(self) -> tuple[Array, Array, float]:
        """Residuals [3 B] and Jacobian [3 B, n] of the bins, in units of a sample's noise; squares within the bins."""
        A, force, path = self._path()
        binned, within = self._binned(self.x - path(self.t - self.theta[0]))
        return binned, self._jacobian(self.t_bin - self.theta[0], A, force, path), within

    def residual(self, delay: float) -> Array:
        """m [N, 3] of the positions, with another delay [s] and everything else as found."""
        return np.asarray(self.x - self._path()[2](self.t - delay))

    def squares(self, delays: Array) -> Array:
        """m2 [K]: sum over the positions' residuals, for delays [K] s, everything else fitted anew to each."""
        A, force, path = self._path()
        J = self._jacobian(self.t_bin - self.theta[0], A, force, path)[:, 1:]
        held = np.sqrt(self.levels.noise / self.prior_variance(self.levels.walk, self.levels.white)[1:])
        binned, within = zip(*(self._binned(self.x - path(self.t - delay)) for delay in delays), strict=True)
        beside = np.tile(-held * self.theta[1:], (len(delays), 1))
        whole = np.block([[J, np.array(binned).T], [np.diag(held), beside.T]])
        left = np.asarray(np.linalg.qr(whole, mode="r"))[J.shape[1] :, J.shape[1] :]
        return np.array(within) + np.sum(left**2, axis=0)

    def _jacobian(self, at: Array, A: Rotation, force: Array, path: CubicHermiteSpline) -> Array:
        s, fine, lever = self.coarse, self.imu.t, self.prior.lever + self.theta[13:16]
        arm = A.apply(lever)
        R = np.stack([np.interp(s, fine, c) for c in A.as_matrix().reshape(-1, 9).T], axis=1).reshape(-1, 3, 3)
        f, arm = (np.stack([np.interp(s, fine, c) for c in x.T], axis=1) for x in (force, arm))
        unit = np.eye(3)
        turned_f, turned_arm = (np.cross(unit, x[:, None, :]) for x in (f, arm))  # [N, axis of the turn, 3]
        spun = np.cross(-_integral(s, R).transpose(0, 2, 1), f[:, None, :])
        hats = self.hats[:, :, None, None]
        walk = np.cumsum((hats * turned_f[:, None])[:, ::-1], axis=1)[:, ::-1].reshape(len(s), -1, 3)
        walk_arm = np.cumsum((hats * turned_arm[:, None])[:, ::-1], axis=1)[:, ::-1].reshape(len(s), -1, 3)
        white = (hats * unit).reshape(len(s), -1, 3)
        a = np.concatenate([-R.transpose(0, 2, 1), spun, walk, white], axis=1)
        moved = _integral(s, _integral(s, a))
        moved[:, 6 : 6 + walk.shape[1]] += walk_arm
        since = np.broadcast_to(unit, (len(s), 3, 3))
        columns = np.concatenate(
            [since, since * (s - s[0])[:, None, None], moved[:, :6], R.transpose(0, 2, 1), moved[:, 6:]], axis=1
        )
        k = np.clip(np.searchsorted(s, at) - 1, 0, len(s) - 2)
        share = ((at - s[k]) / (s[1] - s[0]))[:, None, None]
        there = (1.0 - share) * columns[k] + share * columns[k + 1]  # [N, n - 1, 3]
        whole = np.concatenate([-path(at, 1)[:, None, :], there], axis=1).transpose(0, 2, 1).reshape(3 * len(at), -1)
        return np.asarray(whole * np.repeat(np.sqrt(self.count), 3)[:, None])

    def prior_variance(self, walk: float, white: float) -> Array:
        """Of every parameter. walk: rad2 per s, white: (m/s2)2 of a knot."""
        p, K = self.prior, self.n_knots
        fixed = [DELAY_STD**2] + [START_STD**2] * 6 + [p.acc_bias**2] * 3 + [p.gyro_bias**2] * 3 + [p.lever_std**2] * 3
        return np.r_[fixed, [TILT_STD**2] * 3, [walk * self.spacing] * (3 * (K - 1)), [white] * (3 * K)]


def _posterior(R: Array, z: Array, std: Array) -> tuple[Array, Array]:
    """Parameters and covariance from rows R theta = z of unit noise and parameters of sigma std about 0; R is upper
    triangular.

    By a QR of rows and prior. Normal equations lose all digits where a tilt of 0.1 rad, integrated for 30 s, meets
    positions good to 0.3 mm at 120 Hz.
    """
    n = len(std)
    prior, rows = np.eye(n + 1, order="F"), np.zeros((n + 1, n + 1), order="F")
    rows[: len(R), :n], rows[: len(R), n] = R * std, z
    T, *_ = dtpqrt(n + 1, min(QR_BLOCK, n + 1), prior, rows, overwrite_a=1, overwrite_b=1)
    inverse = std[:, None] * solve_triangular(T[:n, :n], np.eye(n))
    return inverse @ T[:n, n], inverse @ inverse.T


def _learn(
    stretch: Stretch, R: Array, z: Array, rest: float, n: int, levels: Levels, n_steps: int
) -> tuple[Array, Array]:
    """Parameters and covariance from rows R theta = z (unit weight, rest: their residual), learning the levels."""
    first = stretch.N_FIXED + 3
    walk = slice(first, stretch.N_FIXED + 3 * stretch.n_knots)
    white = slice(walk.stop, None)
    for _ in range(n_steps):
        std = np.sqrt(stretch.prior_variance(levels.walk, levels.white))
        theta, P = _posterior(R / np.sqrt(levels.noise), z / np.sqrt(levels.noise), std)
        if n_steps == 1:
            break
        second = theta**2 + np.diag(P)
        gap = z - R @ theta
        before = levels.walk, levels.white
        levels.noise = max(float((gap @ gap + rest + np.sum((R @ P) * R)) / n), NOISE_LEAST**2)
        levels.walk = max(second[walk].mean() / stretch.spacing, 1e-14)
        levels.white = max(second[white].mean(), 1e-12)
        if np.allclose(before, (levels.walk, levels.white), rtol=LEARNT, atol=0.0):
            break
    return theta, P


def _long_run(s: Array, lags: int) -> float:
    """Variance of a sum of correlated numbers, Bartlett weights."""
    total = s @ s
    for k in range(1, min(lags, len(s) - 1) + 1):
        total += 2.0 * (1.0 - k / (lags + 1)) * (s[k:] @ s[:-k])
    return float(total)


def _solve(stretch: Stretch) -> tuple[float, float, float]:
    """Delay, its variance and the tracker's noise [m] of one stretch."""
    levels, n_data = stretch.levels, stretch.x.size
    for k in range(N_STEPS):
        e, J, within = stretch.predict()
        Rz = np.asarray(np.linalg.qr(np.column_stack([J, e + J @ stretch.theta]), mode="r"))
        n = J.shape[1]
        n_learn = 1 if k < N_FIRST else N_LEARN
        theta, P = _learn(stretch, Rz[:n, :n], Rz[:n, n], within + float(Rz[n, n] ** 2), n_data, levels, n_learn)
        step, stretch.theta = theta[0] - stretch.theta[0], theta
        if k > N_FIRST and abs(step) < CONVERGED * np.sqrt(P[0, 0]):
            break
    e, J, _ = stretch.predict()
    share = J @ P[:, 0] / levels.noise
    score = (share * e).reshape(-1, 3).sum(axis=1)
    white = levels.noise * float(share @ share)
    variance = float(P[0, 0]) + max(0.0, _long_run(score, int(CORRELATED / BIN)) - white)
    return float(theta[0]), variance, float(np.sqrt(levels.noise))


def _stretches(imu: Imu, t: Array, margin: float) -> list[tuple[slice, slice]]:
    """Indices of IMU and tracker samples; the tracker's lie within the IMU's by margin [s] at both ends."""
    breaks = np.flatnonzero(np.diff(imu.t) > IMU_GAP) + 1
    found = []
    for part in np.split(np.arange(len(imu.t)), breaks):
        duration = imu.t[part[-1]] - imu.t[part[0]]
        pieces = max(1, int(np.ceil(duration / STRETCH)))
        for piece in np.array_split(part, pieces):
            a, b = imu.t[piece[0]], imu.t[piece[-1]]
            inside = slice(int(np.searchsorted(t, a + margin)), int(np.searchsorted(t, b - margin)))
            if b - a >= SHORTEST and inside.stop - inside.start > 50:
                found.append((slice(piece[0], piece[-1] + 1), inside))
    return found


@dataclass(frozen=True)
class Solution:
    """The delay, and the stretches that it comes from."""

    delay: Delay
    stretches: list[Stretch]

    def rms(self, delays: Array) -> Array:
        """m [K], each axis: residual of the positions for delays [K] s, everything else fitted anew to each."""
        squares = np.sum([stretch.squares(delays) for stretch in self.stretches], axis=0)
        return np.sqrt(squares / sum(stretch.x.size for stretch in self.stretches))


def estimate(imu: Imu, t: Array, x: Array, prior: Prior, margin: float) -> Delay | None:
    """The delay alone; see solve()."""
    found = solve(imu, t, x, prior, margin)
    return None if found is None else found.delay


def solve(imu: Imu, t: Array, x: Array, prior: Prior, margin: float) -> Solution | None:
    """The delay of positions x [N, 3] m of the tracked point in W, stamped t [N] s. None: no stretch is long enough.

    margin: s, the largest delay, either way, for which both ends hold. Cost: about 5 s per 30 s of data.
    """
    each, solved = [], []
    parts = _stretches(imu, t, margin)
    for samples, positions in parts:
        part = Imu(imu.t[samples], imu.acc[samples], imu.gyro[samples], imu.q[samples])
        solved.append(Stretch(part, t[positions], x[positions], prior))
        each.append(_solve(solved[-1]))
    if not each:
        return None
    value, variance, noise = np.array(each).T
    weight = 1.0 / variance
    mean = float(weight @ value / weight.sum())
    scatter = float(weight @ (value - mean) ** 2) / max(1, len(each) - 1)
    std = float(np.sqrt(max(1.0, scatter) / weight.sum()))
    n = sum(s.stop - s.start for _, s in parts)
    return Solution(Delay(mean, std, float(np.sqrt(np.mean(noise**2))), n, len(each)), solved)
