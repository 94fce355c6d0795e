# SPDX-License-Identifier: Apache-2.0
"""Calibration of the sensors from runs: observable errors, unobservable ones, and a file for compile.

Runs of one robot with one or more bodies on it. Where the difference of their masses is known (--payload), the force
gains are observable; without it their common part is not: all forces 1 % higher are all masses 1 % higher. A parameter
whose posterior sigma is above 0.9 of its prior's is refused: it keeps its value and is reported.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base import table
from inertiad.base.error import InputError
from inertiad.base.finding import Finding, ordered
from inertiad.base.quantity import forces
from inertiad.base.table import Array
from inertiad.base.text_files import to_toml
from inertiad.identify import diagnose, findings, fit, identification
from inertiad.robot import description, systematic
from inertiad.robot.description import Robot
from inertiad.robot.keys import LeftOver
from inertiad.robot.systematic import Group, names
from inertiad.run import reader
from inertiad.run.reader import Recording

Flags = NDArray[np.bool_]

NOT_TOLD: Final = 0.9
"""posterior sigma, of the prior's, above which a parameter counts as not observable"""
HARDLY: Final = 0.5
CORRELATED: Final = 0.9


@dataclass(frozen=True)
class Calibration:
    """Estimated sensor errors; all arrays in the order of systematic.h."""

    robot: Robot
    xi: Array
    """corrections [n]; 0 where refused"""
    std: Array
    """posterior sigma of each [n]"""
    prior_std: Array
    covariance: Array
    """[n, n] of the corrections"""
    refused: Flags
    """[n] bool"""
    estimates: list[fit.Estimate]
    """of the bodies, by payload"""
    payloads: list[float]
    directions: list[str]
    """unobservable combinations of parameters, as text"""
    findings: list[Finding]
    """the worst first"""

    @property
    def ratio(self) -> Array:
        """Sigma left over the prior's [n]."""
        return np.minimum(np.sqrt(np.diag(self.covariance)) / self.prior_std, 1.0)


def parse_payloads(options: list[str], paths: list[Path]) -> dict[Path, float]:
    """{run: kg} of "RUN=KG". InputError: not of this form, or not one of the runs."""
    result = {}
    for option in options:
        name, equals, value = option.rpartition("=")
        try:
            mass = float(value)
        except ValueError:
            mass = float("nan")
        if not equals or not np.isfinite(mass) or not 0.0 <= mass <= 1e6:
            raise InputError(f'--payload "{option}": allowed: RUN=KG, 0 to 1e6')
        if Path(name) not in paths:
            raise InputError(f'--payload "{option}": {name} is not one of the runs')
        result[Path(name)] = mass
    return result


def with_tare(robot: Robot, file: Path) -> Robot:
    """The robot with force offsets from a CSV recorded with no tension in any cable: t,f_1..f_m."""
    f = table.read(file, ["t", *forces(robot.n_cables)]).stack(*forces(robot.n_cables))
    scatter = f.std(axis=0)
    slack = max(20.0 * float(np.median(scatter)), 0.02 * robot.cable[0].tension_max)
    offset = f.mean(axis=0)
    if np.abs(offset).max() > slack:
        worst = int(np.abs(offset).argmax())
        raise InputError(
            f"{file}: f_{worst + 1} = {offset[worst]:.1f} N: allowed: no tension in any cable, within {slack:.0f} N"
        )
    left = float(max(scatter.max() / np.sqrt(len(f)), 0.01))
    calibration = robot.calibration.model_copy(
        update={"force_offset": offset.tolist(), "std": robot.calibration.std.model_copy(update={"force_offset": left})}
    )
    return robot.model_copy(update={"calibration": calibration})


def _unit_directions(covariance: Array, prior_std: Array, labels: list[str]) -> list[str]:
    """Combinations of parameters, in prior sigmas, whose variance the data do not reduce; single ones left out."""
    scaled = covariance / np.outer(prior_std, prior_std)
    value, vector = np.linalg.eigh(scaled)
    found = []
    for ratio, v in zip(np.sqrt(np.maximum(value, 0.0)), vector.T, strict=True):  # rounding leaves some below 0
        order = np.argsort(-np.abs(v))
        if ratio < NOT_TOLD or abs(v[order[0]]) > 0.95:
            continue
        share = [i for i in order[:4] if abs(v[i]) > 0.3]
        if len(share) > 1:
            sign = np.sign(v[share[0]])
            found.append(" ".join(f"{sign * v[i]:+.2f} {labels[i]}" for i in share))
    return found


def _common_gain(covariance: Array, prior_std: Array, group: Group) -> bool:
    """True if the mean of all force gains is not observable."""
    part = group.part
    mean = max(covariance[part, part].sum(), 0.0) / group.n**2
    return bool(np.sqrt(mean) > NOT_TOLD * prior_std[part].mean() / np.sqrt(group.n))


def _solve(
    config: Any, recordings: list[Recording], payload: list[float], is_known: bool, free: Flags
) -> dict[str, Any]:
    levels = sorted(set(payload))
    return fit.batch(
        config,
        recordings,
        group=[levels.index(p) for p in payload],
        payload=levels,
        is_payload_known=is_known,
        is_free=free.tolist(),
    )


def calibrate(robot: Robot, config: Any, recordings: list[Recording], payloads: dict[Path, float]) -> Calibration:
    """Joint estimate of all sensors' errors. Solved twice where something is refused, the second time without it."""
    payload = [payloads.get(run.path, 0.0) for run in recordings]
    is_known = len(set(payload)) > 1
    n = len(names(robot.n_cables))
    free = np.ones(n, dtype=bool)
    result = _solve(config, recordings, payload, is_known, free)
    told = np.array(result["free"], dtype=int)
    part = slice(10 * len(set(payload)), 10 * len(set(payload)) + len(told))
    covariance, prior_std = np.zeros((n, n)), np.maximum(inertiad_core.systematic_std(config), 1e-12)
    untold = np.setdiff1d(np.flatnonzero(prior_std > 1e-12), told)  # a low-pass that is not there
    covariance[untold, untold] = prior_std[untold] ** 2
    covariance[np.ix_(told, told)] = np.array(result["covariance"])[part, part]
    refused = np.sqrt(np.diag(covariance)) >= NOT_TOLD * prior_std
    directions = _unit_directions(covariance, prior_std, names(robot.n_cables))
    gains = systematic.group("force_gain", robot.n_cables)
    if _common_gain(covariance, prior_std, gains):
        directions = [d for d in directions if "force_gain" not in d]
        directions.insert(0, "common force gain; add a run with a known added weight: --payload RUN=KG")
    if refused.any() and not refused.all():
        result = _solve(config, recordings, payload, is_known, ~refused)
    estimates = [fit.of_batch("joint", result, g) for g in range(len(set(payload)))]
    levels = sorted(set(payload))
    found = identification.mistakes(robot, recordings, result, diagnose.of_signals(robot, recordings))
    found += findings.of_result(robot, config, result, recordings, [levels.index(p) for p in payload])
    xi = np.where(refused, 0.0, np.array(result["xi"]))
    std = np.maximum(np.where(refused, prior_std, np.sqrt(np.diag(covariance))), 1e-12)
    return Calibration(
        robot, xi, std, prior_std, covariance, refused, estimates, sorted(set(payload)), directions, ordered(found)
    )


def _turned(first: list[float], then: Array) -> list[float]:
    return (Rotation.from_rotvec(first) * Rotation.from_rotvec(then)).as_rotvec().tolist()


def _left_over(calibration: Calibration) -> dict[str, float]:
    """One sigma for all parameters of a kind, as the daemon takes it: the largest in any direction."""
    result = {}
    for group in systematic.groups(calibration.robot.n_cables):
        if group.std_key not in LeftOver.model_fields:
            continue
        largest = max(float(np.linalg.eigvalsh(calibration.covariance[group.part, group.part])[-1]), 0.0)
        result[group.std_key] = float(min(np.sqrt(largest), calibration.prior_std[group.part].max()))
    return result


def document(calibration: Calibration) -> dict[str, Any]:
    """Contents of calibration.toml: robot.toml's [calibration] with the corrections in it."""
    old, xi, m = calibration.robot.calibration, calibration.xi, calibration.robot.n_cables
    part = {g.name: xi[g.part] for g in systematic.groups(m)}
    labels = names(m)
    return {
        "acc_bias": (np.array(old.acc_bias) + part["acc_bias"]).tolist(),
        "gyro_bias": (np.array(old.gyro_bias) + part["gyro_bias"]).tolist(),
        "attitude_bias": _turned(old.attitude_bias, part["attitude_bias"]),
        "world_yaw": float(old.world_yaw + part["world_yaw"][0]),
        "imu_alignment": (Rotation.from_rotvec(part["imu_alignment"]) * Rotation.from_rotvec(old.imu_alignment))
        .as_rotvec()
        .tolist(),
        "position_delay": float(old.position_delay + part["position_delay"][0]),
        "force_delay": float(old.force_delay + part["force_delay"][0]),
        "attitude_delay": float(old.attitude_delay + part["attitude_delay"][0]),
        "force_offset": (np.array(old.force_offset or np.zeros(m)) + part["force_offset"]).tolist(),
        "force_gain": (np.array(old.force_gain or np.zeros(m)) + part["force_gain"]).tolist(),
        "not_told": [labels[i] for i in np.flatnonzero(calibration.refused)] + calibration.directions,
        "names": labels,
        "covariance": calibration.covariance.tolist(),
        "std": _left_over(calibration),
    }


def write(path: Path, calibration: Calibration) -> None:
    """Write calibration.toml, for `file = ...` in robot.toml's [calibration]."""
    head = "# Written by inertiactl calibrate. rad, s, m/s2, N, P and I axes; as in robot.toml's [calibration].\n"
    path.write_text(head + to_toml(document(calibration)), encoding="utf-8")


def text(calibration: Calibration) -> str:
    """Every parameter with its posterior sigma, as a table for people."""
    lines = [f"{'':18} {'correction':>11} {'± std':>9} {'prior':>9}  {'unit':6}"]
    labels, ratio = names(calibration.robot.n_cables), calibration.ratio
    for group in systematic.groups(calibration.robot.n_cables):
        for i in range(group.first, group.first + group.n):
            k = group.factor
            numbers = f"{k * calibration.xi[i]:11.4f} {k * calibration.std[i]:9.4f} {k * calibration.prior_std[i]:9.4f}"
            line = f"{labels[i]:18} {numbers}  {group.unit:6}"
            word = (
                "  not observable in these runs: unchanged"
                if calibration.refused[i]
                else "  poorly observable"
                if ratio[i] > HARDLY
                else ""
            )
            lines.append((line + word).rstrip())
    return "\n".join(lines)


def correlations(calibration: Calibration) -> list[str]:
    """Highly correlated pairs of parameters, the worst first."""
    std = np.sqrt(np.diag(calibration.covariance))
    std[std == 0.0] = 1.0  # fixed, so correlated with nothing
    r = np.triu(calibration.covariance / np.outer(std, std), 1)
    labels = names(calibration.robot.n_cables)
    pairs = sorted(zip(*np.nonzero(np.abs(r) > CORRELATED), strict=True), key=lambda ij: -abs(r[ij]))
    return [f"{labels[i]} and {labels[j]}: correlation {r[i, j]:+.2f}" for i, j in pairs]


def main(
    robot_file: Path, paths: list[Path], payload: list[str], tare: Path | None
) -> tuple[Calibration, list[Recording]]:
    """Read runs and calibrate the robot of robot_file with them."""
    payloads = parse_payloads(payload, paths)
    robot = description.load(robot_file)
    recordings = reader.read_all(paths, robot_file)
    if recordings[0].robot.n_cables != robot.n_cables:
        raise InputError(
            f"{paths[0]}: {recordings[0].robot.n_cables} cables: allowed: {robot.n_cables}, as in {robot_file}"
        )
    if tare is not None:
        robot = with_tare(robot, tare)
    return calibrate(robot, reader.config_of(robot, str(robot_file)), recordings, payloads), recordings
