# SPDX-License-Identifier: Apache-2.0
"""Offline identification of one body from any number of runs; every method ends in the same estimate.json.

joint   theta and the systematic errors of the sensors together, Gauss-Newton, priors from robot.toml: the optimum
wls     theta alone, weighted least squares, neither prior nor sensor errors
iv      theta alone, the regressor of a window later as instrument: differs from wls where noise in rate or force counts
paper   the two-step method of the source paper, medians over runs
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import inertiad_core
from inertiad.base.body import NAMES, UNITS, Body, read_truth
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.identify import block_statistics, physical_consistency
from inertiad.identify import two_step as paper
from inertiad.robot import configuration, systematic
from inertiad.robot.configuration import prior, theta_of
from inertiad.robot.description import Robot
from inertiad.robot.keys import Nominal, inertia_matrix
from inertiad.run import reader
from inertiad.run.reader import Recording

METHODS: Final = ("joint", "wls", "iv", "paper")
AT_REST: Final = 0.9
"""of the windows: a run with more of them at rest shows no noise of motion"""
NORMAL_BY_MEDIAN: Final = 1.4826
"""standard deviation of normal errors over the median of their sizes"""
CORRELATED_LONG: Final = 8.0
"""correlation time of residuals over the window's length: healthy windows, which overlap, have about one"""
DRIFTS: Final = (30.0, 300.0)
"""times the stated drift of the force offsets: 30 times the default walks an offset's sigma in 12 s"""
DRIFT_FALLS: Final = 0.5
"""of the noise: what a larger drift must leave to be believed"""
WEAK_PRIOR: Final = 1e4
"""factor on the prior sigmas where there is to be no prior"""
LAG: Final = 4
"""windows to the instrument: the first that shares no sample"""


class NoBodyError(InputError):
    """The data have a solution, but no body is near it."""


@dataclass(frozen=True)
class Estimate:
    """A method's estimate of the body and, for the joint fit, of the sensors' errors."""

    method: str
    body: Body
    consistent: bool
    observable: tuple[bool, ...]
    theta: Array
    """[10] about P"""
    distance: float = 0.0
    """Mahalanobis distance squared from the data's optimum to the published body"""
    xi: Array | None = None
    """corrections [32 + 3m] to the calibration in robot.toml"""
    xi_std: Array | None = None
    n_windows: int = 0
    rms: Array = field(default_factory=lambda: np.zeros(6))
    """of the windows' residual wrench, N and N m [6]"""
    notes: tuple[str, ...] = ()
    is_converged: bool = True


def _body(d: dict[str, Any]) -> Body:
    value = (d["mass"], *d["cog"], *d["inertia_cog"])
    return Body(tuple(value), (d["mass_std"], *d["cog_std"], *d["inertia_cog_std"]))


def _solve(config: Any, recordings: list[Recording], **options: Any) -> dict[str, Any]:
    """The batch solver's result, sigma as the weights give it. Errors as of batch()."""
    options = {"group": [0] * len(recordings), "payload": [0.0], **options}
    try:
        result: dict[str, Any] = inertiad_core.batch(config, [run.rows for run in recordings], **options)
    except ValueError as error:
        raise InputError(f"{recordings[0].path}: {error}") from None
    except RuntimeError as error:
        raise NoBodyError(f"{recordings[0].path}: {error}") from None
    return result


def _is_at_rest(result: dict[str, Any]) -> bool:
    return all(fit["n_rest"] >= AT_REST * fit["n_windows"] for fit in result["fit"])


def batch(config: Any, recordings: list[Recording], **options: Any) -> dict[str, Any]:
    """The batch solver on runs of one body, or with options group and payload of several; sigma as it is published.

    Residuals of a platform at rest do not show the noise of one that moves: the configured noise counts then.
    InputError: nothing to solve. NoBodyError: a solution that no body is near.
    """
    result = _solve(config, recordings, **options)
    if not result["converged"] and _is_at_rest(result):
        result = _solve(config, recordings, **options | {"is_weight_learnt": False})
    return block_statistics.widened(recordings[0].robot, result)


def correlation_time(result: dict[str, Any]) -> float:
    """Of the residuals of the worst run, s."""
    return float(max(f["correlation_time"] for f in result["fit"]))


def is_correlated(robot: Robot, result: dict[str, Any]) -> bool:
    """Residuals last longer than windows overlap."""
    return correlation_time(result) > CORRELATED_LONG * robot.estimator.window_length


def _noise(result: dict[str, Any]) -> float:
    """Geometric mean of what residuals weigh in all channels of all runs."""
    return float(np.exp(np.mean([np.log(f["noise_std"]) for f in result["fit"]])))


def with_drift(recordings: list[Recording], result: dict[str, Any], **options: Any) -> dict[str, Any]:
    """batch()'s result with a larger drift of the force offsets, in result["offset_drift"] [N/sqrt(s)], where what is
    left are residuals that do not last. Other causes of such residuals leave some in spite of it."""
    robot = recordings[0].robot
    if not result["converged"] or not is_correlated(robot, result):
        return result
    stated = configuration.std(robot)["force_offset_drift"]
    for factor in DRIFTS:
        std = robot.std.model_copy(update={"force_offset_drift": factor * stated})
        try:
            tried = _solve(reader.config_of(robot.model_copy(update={"std": std}), robot.name), recordings, **options)
        except InputError:
            continue
        falls = _noise(tried) < DRIFT_FALLS * _noise(result)
        if tried["converged"] and falls and not is_correlated(robot, tried):
            return {**block_statistics.widened(robot, tried), "offset_drift": factor * stated}
    return result


def _plain(config: Any, recordings: list[Recording]) -> dict[str, Any]:
    """The batch solver's result for theta alone, without prior.

    Its residuals contain the sensors' constant errors and stay correlated for long. The stated errors cover these, so
    sigma is widened by the spread between blocks only where there are enough blocks to show it.
    """
    robot, n_xi = recordings[0].robot, len(inertiad_core.systematic_std(config))
    result = _solve(config, recordings, is_free=[False] * n_xi, theta_prior=WEAK_PRIOR)
    wide = block_statistics.widened(robot, result)
    return wide if wide["spread"].n_blocks >= block_statistics.BLOCKS_MIN else result


def _rms(result: dict[str, Any]) -> tuple[int, Array]:
    """Windows of all runs and the root mean square of their residuals [6]."""
    n = np.array([f["n_windows"] for f in result["fit"]], dtype=float)
    square = np.array([f["rms"] ** 2 for f in result["fit"]])
    return int(n.sum()), np.sqrt(n @ square / max(n.sum(), 1.0))


def _possible(method: str, theta: Array, P: Array) -> tuple[Body, Array, float]:
    """The nearest body that can exist, its theta [10], and the distance squared to it. InputError: there is none."""
    try:
        theta, distance = physical_consistency.nearest(theta, P)
        return _body(inertiad_core.body(theta, P)), theta, distance
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        raise NoBodyError(f"--method {method}: {error}") from None


def of_batch(method: str, result: dict[str, Any], group: int = 0) -> Estimate:
    """One body of inertiad_core.batch's result."""
    solved = result["body"][group]
    body, theta, distance = _possible(method, np.array(solved["theta"]), np.array(solved["covariance"]))
    n_windows, rms = _rms(result)
    has_xi = len(result["free"]) > 0
    return Estimate(
        method,
        body,
        bool(solved["consistent"]),
        tuple(solved["observable"]),
        theta,
        distance,
        np.array(result["xi"]) if has_xi else None,
        np.array(result["xi_std"]) if has_xi else None,
        n_windows,
        rms,
        is_converged=bool(result["converged"]),
    )


def joint(config: Any, recordings: list[Recording]) -> Estimate:
    """Theta and systematic parameters together."""
    return of_batch("joint", batch(config, recordings))


def _with_sensor_errors(config: Any, recordings: list[Recording], theta: Array, P: Array, map_y: list[Array]) -> Array:
    """P [10, 10] with what the sensors' stated errors, which the method leaves out, do to theta (about the IMU).

    map_y: of each run, d(theta)/d(y) [10, 6 N].
    """
    n_xi = len(inertiad_core.systematic_std(config))
    by_xi = np.zeros((10, n_xi))
    for run, by_y in zip(recordings, map_y, strict=True):
        by_xi += by_y @ inertiad_core.Windows(config, run.rows).X(theta).reshape(-1, n_xi)
    by_xi *= np.asarray(inertiad_core.systematic_std(config))
    return np.asarray(P + by_xi @ by_xi.T)


def wls(config: Any, recordings: list[Recording]) -> Estimate:
    """Weighted least squares of theta alone; sigma with the sensors' errors in [std], none of which is fitted."""
    robot, result = recordings[0].robot, _plain(config, recordings)
    weights = [1.0 / f["noise_std"] for f in result["fit"]]
    T = _from_imu(robot)
    weak = np.linalg.inv(WEAK_PRIOR**2 * prior(robot)[1])
    Y = [
        (inertiad_core.Windows(config, run.rows).Y * w[:, None]).reshape(-1, 10)
        for run, w in zip(recordings, weights, strict=True)
    ]
    inverse = np.linalg.inv(sum((y.T @ y for y in Y), T.T @ weak @ T))
    to_theta = [
        inverse @ (y.reshape(-1, 6, 10) * w[:, None]).reshape(-1, 10).T for y, w in zip(Y, weights, strict=True)
    ]
    body = result["body"][0]
    theta_imu = np.linalg.solve(T, np.array(body["theta"]))
    errors = _with_sensor_errors(config, recordings, theta_imu, np.zeros((10, 10)), to_theta)
    P = np.array(body["covariance"]) + T @ errors @ T.T
    n_windows, rms = _rms(result)
    converged = bool(result["converged"])
    return _published("wls", robot, np.array(body["theta"]), P, n_windows=n_windows, rms=rms, is_converged=converged)


def _from_imu(robot: Robot) -> Array:
    """Theta about P [10, 10] from theta about the IMU."""
    return np.array([inertiad_core.shift(unit, np.array(robot.imu.position)) for unit in np.eye(10)]).T


def _weights(config: Any, recordings: list[Recording]) -> list[Array]:
    """Inverse standard deviations [6] of each run's windows, as wls takes them."""
    return [1.0 / f["noise_std"] for f in _plain(config, recordings)["fit"]]


def _published(method: str, robot: Robot, theta: Array, P: Array, **other: Any) -> Estimate:
    """An estimate from theta [10] about P and its covariance."""
    consistent = bool(inertiad_core.is_consistent(theta))
    found, theta, distance = _possible(method, theta, P)
    mean, cov = prior(robot)
    before = _body(inertiad_core.body(mean, cov)).std
    observable = tuple(bool(2.0 * now <= then) for now, then in zip(found.std, before, strict=True))
    return Estimate(method, found, consistent, observable, theta, distance, **other)


def iv(robot: Robot, config: Any, recordings: list[Recording]) -> Estimate:
    """Instrumental variables: the regressor one window later, whose noise is not this window's."""
    ZY, Zy, noise = np.zeros((10, 10)), np.zeros(10), np.zeros((10, 10))
    blocks, instruments, used = [], [], []
    for run, weight in zip(recordings, _weights(config, recordings), strict=True):
        windows = inertiad_core.Windows(config, run.rows)
        Y, y = windows.Y * weight[:, None], windows.y * weight
        if len(Y) <= LAG:
            continue
        Z, Y, y = Y[LAG:], Y[:-LAG], y[:-LAG]
        ZY += np.einsum("kij,kil->jl", Z, Y)
        Zy += np.einsum("kij,ki->j", Z, y)
        noise += np.einsum("kij,kil->jl", Z, Z)
        blocks.append((Y, y, weight))
        used.append(run)
        instruments.append(np.concatenate([Z * weight[:, None], np.zeros((LAG, 6, 10))]).reshape(-1, 10))
    if np.linalg.matrix_rank(ZY) < 10:
        raise InputError("--method iv: the motion does not excite all ten parameters")
    inverse = np.linalg.inv(ZY)
    theta_imu = inverse @ Zy
    P_imu = inverse @ noise @ inverse.T
    P_imu = _with_sensor_errors(config, used, theta_imu, P_imu, [inverse @ Z.T for Z in instruments])
    e = [(y - Y @ theta_imu) / weight for Y, y, weight in blocks]
    rms = np.sqrt(np.mean(np.concatenate(e) ** 2, axis=0))
    T = _from_imu(robot)
    return _published("iv", robot, T @ theta_imu, T @ P_imu @ T.T, n_windows=sum(map(len, e)), rms=rms)


def two_step(robot: Robot, config: Any, recordings: list[Recording]) -> Estimate:
    """The paper's method: one estimate per run, medians over runs; std is the runs' scatter, NaN for a single run."""
    each = np.array([paper.estimate(robot, config, run.rows) for run in recordings])
    value = np.median(each, axis=0)
    if not np.isfinite(value).all():
        raise InputError("--method paper: mass is not positive")
    spread = 1.4826 * np.median(np.abs(each - value), axis=0) if len(each) > 1 else np.full(10, np.nan)
    J = inertia_matrix(value[4:])
    theta = theta_of(Nominal.model_construct(mass=value[0], cog=value[1:4].tolist(), inertia_cog=value[4:].tolist()))
    possible = bool(inertiad_core.is_consistent(theta))
    least = float(np.linalg.eigvalsh(0.5 * np.trace(J) * np.eye(3) - J)[0])
    note = (
        ()
        if possible
        else (f"inertia not physically consistent: one moment is {-2.0 * least:.1f} kg m2 above the sum of the others",)
    )
    body = Body(tuple(value), tuple(spread))
    return Estimate("paper", body, possible, (True,) * 10, theta, notes=note)


def fit(method: str, robot: Robot, config: Any, recordings: list[Recording]) -> Estimate:
    """One estimate by one of METHODS. InputError: unknown method, or nothing to solve."""
    if method == "joint":
        return joint(config, recordings)
    if method == "wls":
        return wls(config, recordings)
    if method == "iv":
        return iv(robot, config, recordings)
    if method == "paper":
        return two_step(robot, config, recordings)
    raise InputError(f'--method "{method}": allowed: {", ".join(METHODS)}')


@dataclass(frozen=True)
class Validation:
    """Prediction error of an estimate on a run that was not used."""

    path: Path
    rms: Array
    """of the wrench [6], N and N m"""
    signal: Array
    """of the measured wrench about its mean [6]"""
    tension_rms: Array
    """N [m]: of the smallest change of tensions that would explain the residual"""
    tension_typical: Array
    """N [m]: the same by the median, as rms of normal errors: near a singular pose that change has no bound"""


def _without_failed(e: Array, W: Array, has_failed: NDArray[np.bool_]) -> Array:
    """Residual wrenches [M, 6] without what the cables with failed sensors [M, m] may pull; W [M, 6, m]."""
    left = e.copy()
    for failed in np.unique(has_failed[has_failed.any(axis=1)], axis=0):
        at = (has_failed == failed).all(axis=1)
        pulled = W[at][:, :, failed]
        left[at] -= np.einsum("kij,kjl,kl->ki", pulled, np.linalg.pinv(pulled), e[at])
    return left


def validate(config: Any, estimate: Estimate, run: Recording) -> Validation:
    """Predict a run's measured wrench with the estimate's body and calibration. Failed force sensors are unknowns."""
    rows = run.rows
    if estimate.xi is not None:
        rows = inertiad_core.corrected_rows(config, rows, estimate.xi)
        config = inertiad_core.calibrated(config, estimate.xi)
    windows = inertiad_core.Windows(config, rows)
    if len(windows.y) == 0:
        raise InputError(f"{run.path}: no whole window in the data")
    theta = inertiad_core.shift(estimate.theta, -np.array(run.robot.imu.position))
    e = windows.y - windows.Y @ theta
    if estimate.xi is not None:
        linear = inertiad_core.linear_parameters(run.robot.n_cables)
        e = e + windows.X(theta)[:, :, linear] @ estimate.xi[linear]
    offsets = systematic.group("force_offset", run.robot.n_cables).part
    W = -windows.X(np.zeros(10))[:, :, offsets]
    e = _without_failed(e, W, windows.has_failed)
    tension = np.einsum("kij,kj->ki", np.linalg.pinv(W), e)
    typical = NORMAL_BY_MEDIAN * np.median(np.abs(tension), axis=0)
    return Validation(run.path, np.sqrt((e**2).mean(0)), windows.y.std(axis=0), np.sqrt((tension**2).mean(0)), typical)


@dataclass(frozen=True)
class Segment:
    """A stretch of a run with a body of its own."""

    path: Path
    begin: float
    end: float
    """s since the run's first row"""
    estimate: Estimate


def text(estimate: Estimate, truth: Body | None) -> str:
    """The estimate as a table for people, with the truth beside it where there is one."""
    head = f"{'':8} {'value':>11} {'± std':>10}  {'unit':6}" + (f" {'truth':>11} {'error':>10}" if truth else "")
    lines = [head.rstrip()]
    for i, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        digits = 4 if unit == "m" else 3
        std = estimate.body.std[i]
        sigma = f"{std:.{digits}f}" if np.isfinite(std) else "none"
        line = f"{name:8} {estimate.body.value[i]:11.{digits}f} {sigma:>10}  {unit:6}"
        if truth:
            line += f" {truth.value[i]:11.{digits}f} {estimate.body.value[i] - truth.value[i]:10.{digits}f}"
        lines.append(line if estimate.observable[i] else line + "  not observable")
    return "\n".join(lines)


def remarks(estimate: Estimate, recordings: list[Recording], held_out: list[Validation]) -> list[str]:
    """Notes on the result, a line each."""
    lines = [f"{run.path}: {note}" for run in recordings for note in run.notes]
    lines += list(estimate.notes)
    if estimate.n_windows:
        f, t = np.sqrt((estimate.rms[:3] ** 2).sum()), np.sqrt((estimate.rms[3:] ** 2).sum())
        lines.append(f"residual {f:.2f} N, {t:.2f} N m over {estimate.n_windows} windows")
    for v in held_out:
        share = 100.0 * v.rms / np.maximum(v.signal, 1e-12)
        channels = ", ".join(f"{r:.2f} ({s:.1f} %)" for r, s in zip(v.rms, share, strict=True))
        lines.append(
            f"{v.path}, not used: wrench x y z N, N m predicted to {channels}; tensions to {v.tension_rms.max():.2f} N"
        )
    return lines


def truth_of(paths: list[Path]) -> Body | None:
    """The truth of simulated runs of one body."""
    files = [path / "truth.json" for path in paths if (path / "truth.json").exists()]
    found = {read_truth(file) for file in files}
    return found.pop() if len(found) == 1 and len(files) == len(paths) else None


def read(paths: list[Path], robot_file: Path | None, method: str) -> tuple[Robot, list[Recording]]:
    """The runs, and the first one's robot. InputError: a run is unusable, or the method unknown."""
    if method not in METHODS:
        raise InputError(f'--method "{method}": allowed: {", ".join(METHODS)}')
    recordings = reader.read_all(paths, robot_file)
    return recordings[0].robot, recordings
