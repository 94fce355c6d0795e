# SPDX-License-Identifier: Apache-2.0
"""Offline identification of one body from any number of runs; every method ends in the same estimate.json.

joint   theta and the systematic errors of the sensors together, Gauss-Newton, priors from robot.toml: the optimum
wls     theta alone, weighted least squares, neither prior nor sensor errors
iv      theta alone, the regressor of a window later as instrument: differs from wls where noise in rate or force counts
paper   the two-step method of the source paper, medians over runs
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

import inertiad_core
from inertiad.base.body import NAMES, UNITS, Body, read_truth
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.identify import physical_consistency
from inertiad.identify import two_step as paper
from inertiad.robot import systematic
from inertiad.robot.configuration import prior, theta_of
from inertiad.robot.description import Nominal, Robot, inertia_matrix
from inertiad.run import reader
from inertiad.run.reader import Recording

METHODS: Final = ("joint", "wls", "iv", "paper")
WEAK_PRIOR: Final = 1e4
"""factor on the prior sigmas where there is to be no prior"""
LAG: Final = 4
"""windows to the instrument: the first that shares no sample"""


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
    """corrections [24 + 3m] to the calibration in robot.toml"""
    xi_std: Array | None = None
    n_windows: int = 0
    rms: Array = field(default_factory=lambda: np.zeros(6))
    """of the windows' residual wrench, N and N m [6]"""
    notes: tuple[str, ...] = ()


def _body(d: dict[str, Any]) -> Body:
    value = (d["mass"], *d["cog"], *d["inertia_cog"])
    return Body(tuple(value), (d["mass_std"], *d["cog_std"], *d["inertia_cog_std"]))


def batch(config: Any, recordings: list[Recording], **options: Any) -> dict[str, Any]:
    """The batch solver on runs of one body, or with options group and payload of several. InputError: no solution."""
    options = {"group": [0] * len(recordings), "payload": [0.0], **options}
    try:
        result: dict[str, Any] = inertiad_core.batch(config, [run.rows for run in recordings], **options)
    except ValueError as error:
        raise InputError(f"{recordings[0].path}: {error}") from None
    return result


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
        raise InputError(f"--method {method}: {error}") from None


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
    )


def joint(config: Any, recordings: list[Recording]) -> Estimate:
    """Theta and systematic parameters together."""
    return of_batch("joint", batch(config, recordings))


def wls(config: Any, recordings: list[Recording]) -> Estimate:
    """Weighted least squares of theta alone."""
    n_xi = len(inertiad_core.systematic_std(config))
    return of_batch("wls", batch(config, recordings, is_free=[False] * n_xi, theta_prior=WEAK_PRIOR))


def _weights(config: Any, recordings: list[Recording]) -> list[Array]:
    """Inverse standard deviations [6] of each run's windows, as wls takes them."""
    n_xi = len(inertiad_core.systematic_std(config))
    result = batch(config, recordings, is_free=[False] * n_xi, theta_prior=WEAK_PRIOR)
    return [1.0 / f["noise_std"] for f in result["fit"]]


def _published(method: str, robot: Robot, theta: Array, P: Array, **other: Any) -> Estimate:
    """An estimate from theta [10] about P and its covariance."""
    consistent = bool(inertiad_core.is_consistent(theta))
    found, theta, distance = _possible(method, theta, P)
    mean, cov = prior(robot)
    before = _body(inertiad_core.body(mean, cov)).std
    observable = tuple(2.0 * now <= then for now, then in zip(found.std, before, strict=True))
    return Estimate(method, found, consistent, observable, theta, distance, **other)


def iv(robot: Robot, config: Any, recordings: list[Recording]) -> Estimate:
    """Instrumental variables: the regressor one window later, whose noise is not this window's."""
    ZY, Zy, noise = np.zeros((10, 10)), np.zeros(10), np.zeros((10, 10))
    blocks = []
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
    if np.linalg.matrix_rank(ZY) < 10:
        raise InputError("--method iv: the motion does not excite all ten parameters")
    inverse = np.linalg.inv(ZY)
    theta_imu = inverse @ Zy
    P_imu = inverse @ noise @ inverse.T
    e = [(y - Y @ theta_imu) / weight for Y, y, weight in blocks]
    rms = np.sqrt(np.mean(np.concatenate(e) ** 2, axis=0))
    T = np.array([inertiad_core.shift(unit, np.array(robot.imu.position)) for unit in np.eye(10)]).T
    return _published("iv", robot, T @ theta_imu, T @ P_imu @ T.T, n_windows=sum(map(len, e)), rms=rms)


def two_step(robot: Robot, config: Any, recordings: list[Recording]) -> Estimate:
    """The paper's method: one estimate per run, medians over runs; std is the runs' scatter, 0 for a single run."""
    each = np.array([paper.estimate(robot, config, run.rows) for run in recordings])
    value = np.median(each, axis=0)
    if not np.isfinite(value).all():
        raise InputError("--method paper: mass is not positive")
    spread = 1.4826 * np.median(np.abs(each - value), axis=0)
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


def validate(config: Any, estimate: Estimate, run: Recording) -> Validation:
    """Predict a run's measured wrench with the estimate's body and calibration."""
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
    tension = np.einsum("kij,kj->ki", np.linalg.pinv(W), e)
    return Validation(run.path, np.sqrt((e**2).mean(0)), windows.y.std(axis=0), np.sqrt((tension**2).mean(0)))


def _quantity(value: Any, std: Any) -> dict[str, Any]:
    return {"value": value, "std": std}


def _configured(robot: Robot, name: str) -> Any:
    """The value that robot_config_t has for a kind of systematic parameter; None where xi is a correction to others."""
    place = {"imu_position": robot.imu.position, "tracker_target": robot.tracker.target}
    delays = ("position_delay", "force_delay", "attitude_delay")
    return place.get(name) if name in place or name in delays else getattr(robot.calibration, name, None)


def _sensors(robot: Robot, estimate: Estimate) -> dict[str, Any]:
    """Sensor errors as robot_config_t has them: configured plus estimated; alignment and delays are corrections."""
    if estimate.xi is None or estimate.xi_std is None:
        return {}
    result = {}
    for group in systematic.groups(robot.n_cables):
        configured = _configured(robot, group.name)
        if not np.any(estimate.xi_std[group.part]):
            continue
        value = estimate.xi[group.part] + (np.zeros(group.n) if configured is None else np.atleast_1d(configured))
        std = estimate.xi_std[group.part]
        if group.n == 1:
            result[group.name] = _quantity(float(value[0]), float(std[0]))
        else:
            result[group.name] = _quantity(value.tolist(), std.tolist())
    return result


def _validation_json(validation: Validation) -> dict[str, Any]:
    return {
        "run": str(validation.path),
        "wrench_rms": validation.rms.tolist(),
        "wrench_std": validation.signal.tolist(),
        "tension_rms": validation.tension_rms.tolist(),
    }


def document(
    robot: Robot, estimate: Estimate, recordings: list[Recording], held_out: list[Validation]
) -> dict[str, Any]:
    """Contents of estimate.json."""
    value, std, seen = estimate.body.value, estimate.body.std, list(estimate.observable)
    counters: dict[str, int] = {}
    for run in recordings:
        for name, count in run.counters.items():
            counters[name] = counters.get(name, 0) + count
    return {
        "method": estimate.method,
        "mass": _quantity(value[0], std[0]),
        "cog": _quantity(list(value[1:4]), list(std[1:4])),
        "inertia_cog": _quantity(list(value[4:]), list(std[4:])),
        **_sensors(robot, estimate),
        "consistent": estimate.consistent,
        "distance": estimate.distance,
        "observable": {"mass": seen[0], "cog": seen[1:4], "inertia_cog": seen[4:]},
        "residual_rms": estimate.rms.tolist(),
        "validation": [_validation_json(v) for v in held_out],
        "notes": [*estimate.notes, *(note for run in recordings for note in run.notes)],
        "samples": {
            "frames": sum(run.n_frames for run in recordings),
            "used": sum(len(run.rows) for run in recordings),
            "rejected": sum(run.n_rejected for run in recordings),
            "windows": estimate.n_windows,
        },
        "duration_s": sum(run.duration for run in recordings),
        "counters": counters,
    }


def write(path: Path, data: dict[str, Any]) -> None:
    """Write estimate.json."""
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def text(estimate: Estimate, truth: Body | None) -> str:
    """The estimate as a table for people, with the truth beside it where there is one."""
    head = f"{'':8} {'value':>11} {'± std':>10}  {'unit':6}" + (f" {'truth':>11} {'error':>10}" if truth else "")
    lines = [head.rstrip()]
    for i, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        digits = 4 if unit == "m" else 3
        line = f"{name:8} {estimate.body.value[i]:11.{digits}f} {estimate.body.std[i]:10.{digits}f}  {unit:6}"
        if truth:
            line += f" {truth.value[i]:11.{digits}f} {estimate.body.value[i] - truth.value[i]:10.{digits}f}"
        lines.append(line if estimate.observable[i] else line + "  not observable")
    return "\n".join(lines)


def remarks(estimate: Estimate, recordings: list[Recording], held_out: list[Validation]) -> list[str]:
    """Notes on the result, a line each."""
    lines = [f"{run.path}: {note}" for run in recordings for note in run.notes]
    lines += list(estimate.notes)
    if not estimate.consistent and estimate.method != "paper":
        lines.append(
            "the estimate is not physically consistent; showing the nearest consistent body "
            f"(squared Mahalanobis distance {estimate.distance:.1f})"
        )
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


def main(
    method: str, robot: Robot, recordings: list[Recording], held_out: list[Path], robot_file: Path | None
) -> tuple[Estimate, list[Validation]]:
    """Fit, validate."""
    config = reader.config_of(robot, str(recordings[0].path))
    estimate = fit(method, robot, config, recordings)
    return estimate, [validate(config, estimate, run) for run in reader.read_all(held_out, robot_file)]
