# SPDX-License-Identifier: Apache-2.0
"""The data of a report: runs in, one Facts out. Nothing here knows of figures or pages."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base import body as estimate
from inertiad.base.body import Body
from inertiad.base.error import InputError
from inertiad.base.finding import Finding
from inertiad.base.table import Array
from inertiad.base.text_files import read_json
from inertiad.identify import block_statistics, diagnose, findings, fit, identification
from inertiad.identify.fisher_information import Model
from inertiad.identify.fit import Estimate, Validation
from inertiad.model.window_residual import Residual
from inertiad.report import cables
from inertiad.report.cables import ForceCheck
from inertiad.robot.configuration import prior
from inertiad.robot.description import Robot
from inertiad.robot.keys import Nominal
from inertiad.run import reader
from inertiad.run.platform_pose import platform_pose
from inertiad.run.reader import Recording

Progress = Callable[[str], None]
HELD_OUT_MAX: Final = 8
"""runs up to which each is predicted from the others"""
GAP: Final = 1.5
"""sample intervals, of the median"""


@dataclass(frozen=True)
class History:
    """The estimate of the platform's filter while it went."""

    t: Array
    """s since the first row [K]"""
    value: Array
    """[K, 10] in the order of body.NAMES"""
    std: Array
    n_changes: int
    """of payload, noticed"""
    changed_at: tuple[float, ...]
    """s"""


@dataclass(frozen=True)
class Run:
    """One run as far as it can be used."""

    path: Path
    name: str
    robot: Robot
    recording: Recording | None
    """None: nothing could be read"""
    problem: str = ""
    """why nothing can be identified from it; empty: it can"""
    remedy: str = ""
    alone: dict[str, Any] | None = None
    """inertiad_core.batch's result from this run alone"""
    history: History | None = None
    residual: Residual | None = None
    """under the estimate from all runs"""
    daemon: Body | None = None
    """estimate.json in its folder"""
    prediction: Validation | None = None
    """of it, from the other runs"""

    @property
    def is_usable(self) -> bool:
        return not self.problem

    @cached_property
    def estimate(self) -> Estimate | None:
        """From this run alone."""
        return None if self.alone is None else fit.of_batch("joint", self.alone)

    @property
    def has_rows(self) -> bool:
        return self.recording is not None and len(self.recording.rows) > 1

    @cached_property
    def t(self) -> Array:
        """s since the first row [N]"""
        t = np.asarray(self.recording.rows.t if self.recording else [])
        return t - t[0] if len(t) else t

    @cached_property
    def f(self) -> Array:
        """N [N, m]"""
        return np.asarray(self.recording.rows.f if self.recording else np.zeros((0, 0)))


@dataclass(frozen=True)
class Motion:
    """Motion of the platform, over all windows of a run."""

    t: Array
    """s since the first row [M]"""
    rpy: Array
    """rad [M, 3]"""
    omega: Array
    """rad/s, P axes [M, 3]"""
    alpha: Array
    """rad/s2, P axes [M, 3]"""
    position: Array
    """m, P in W [M, 3]"""
    R: Array
    """P to W [M, 3, 3]"""


@dataclass(frozen=True)
class Uncertainty:
    """Sources of the standard deviations of mass, CoG and inertia; [10] each."""

    prior: Array
    found: Array
    alone: Array
    """if everything else, other parameters and sensors, were known"""
    correlation: Array
    """[10, 10]"""
    share: dict[str, Array]
    """by kind of sensor error: part of the variance that would go if it were known"""


@dataclass(frozen=True)
class Facts:
    """All runs of one report."""

    robot: Robot
    runs: list[Run]
    joint: Estimate | None = None
    """from all usable runs together; None: there is none"""
    methods: dict[str, Estimate | str] = field(default_factory=dict)
    """or why a method has no answer"""
    uncertainty: Uncertainty | None = None
    force_check: ForceCheck | None = None
    motions: list[Motion] = field(default_factory=list)
    prior_xi: Array = field(default_factory=lambda: np.zeros(0))
    """sigma of each systematic parameter before"""
    truth: Body | None = None
    simulated: dict[str, Any] = field(default_factory=dict)
    """settings of a simulated run"""
    found: list[Finding] = field(default_factory=list)
    """by fit: mistakes, misfit, payload changes"""
    command: str = ""

    @property
    def usable(self) -> list[Run]:
        return [run for run in self.runs if run.is_usable]

    @property
    def nominal(self) -> Body | None:
        n = self.robot.nominal
        return None if n is None else Body((n.mass, *n.cog, *n.inertia_cog), (0.0,) * 10)


def apart(a: Body, b: Body) -> Array:
    """|a - b| [10] in standard deviations of the difference."""
    std = np.hypot(a.std, b.std)
    return np.abs(np.subtract(a.value, b.value)) / np.maximum(std, 1e-12)


def _names(paths: list[Path]) -> list[str]:
    """Short, distinct names of the runs."""
    resolved = [path.resolve() for path in paths]
    for n in range(1, 6):
        names = ["/".join(path.parts[-n:]) for path in resolved]
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in paths]


# ---- one run ---------------------------------------------------------------------------------------------------------


def _why(path: Path, name: str, robot: Robot, error: InputError) -> Run:
    """A run that the reader refuses, with the reason and the remedy."""
    text = str(error)
    if not path.is_dir() or not (path / "can.log").exists():
        return Run(
            path, name, robot, None, text, "record the bus: candump -L can0 > can.log, or inertiad --record run.lcmlog"
        )
    if (path / "can.log").stat().st_size == 0:
        return Run(
            path, name, robot, None, f"{path / 'can.log'} is empty", "check bus, bitrate and power, then record again"
        )
    try:
        seen = reader.without_positions(path, robot)
    except InputError:
        return Run(path, name, robot, None, text, "")
    if len(seen.rows) > 1:
        missing = "no tracker.csv" if not (path / "tracker.csv").exists() else "the tracked positions do not overlap it"
        return Run(
            path,
            name,
            robot,
            seen,
            f"no positions: {missing}, so the cables' directions are unknown and nothing can be identified",
            "record the tracker beside the bus: inertiactl record; or set [position] source in robot.toml",
        )
    return Run(
        path, name, robot, seen, text, "check [[bus]], [signals] and the DBC against the log: inertiactl verify RUN"
    )


def history_of(config: Any, recording: Recording) -> History:
    """The estimate that the platform's filter has over a run."""
    h = inertiad_core.track(config, recording.rows)
    t = h["t"] - recording.rows.t[0]
    changes = np.asarray(h["n_changes"])
    at = t[1:][np.diff(changes) > 0] if len(changes) else np.zeros(0)
    n = int(changes[-1]) if len(changes) else 0
    return History(t, np.asarray(h["value"]), np.asarray(h["std"]), n, tuple(at.tolist()))


def _daemon(path: Path) -> Body | None:
    file = path / "estimate.json"
    try:
        return estimate.read(file) if path.is_dir() and file.exists() else None
    except InputError:
        return None


def _read(path: Path, name: str, robot_file: Path | None) -> Run:
    """A run with the result from it alone."""
    robot = reader.robot_of(path, robot_file)
    try:
        recording = reader.read_as(path, robot)
    except InputError as error:
        return _why(path, name, robot, error)
    config = reader.config_of(recording.robot, str(path))
    try:
        alone = fit.batch(config, [recording])
    except InputError as error:
        return Run(path, name, robot, recording, str(error), "record for longer: half a minute of motion or more")
    return Run(path, name, robot, recording, alone=alone, history=history_of(config, recording), daemon=_daemon(path))


def _motion(config: Any, recording: Recording) -> Motion:
    rows, robot = recording.rows, recording.robot
    R_PI = Rotation.from_quat(robot.imu.orientation, scalar_first=True)
    P, turn = platform_pose(rows.q, rows.position, robot.imu.orientation, robot.tracker.target)
    omega = np.ascontiguousarray(R_PI.apply(rows.gyro))
    t_ns = np.rint(1e9 * rows.t).astype(np.int64)
    means = inertiad_core.averages(config, t_ns, np.ascontiguousarray(rows.acc), omega, np.zeros((len(omega), 6)))
    at = np.clip(np.searchsorted(rows.t, means["t"]), 0, len(rows.t) - 1)
    rpy = turn[at].as_euler("ZYX")[:, ::-1]
    return Motion(means["t"] - rows.t[0], rpy, means["w"], means["alpha"], P[at], turn[at].as_matrix())


# ---- all runs together -----------------------------------------------------------------------------------------------


def _methods(robot: Robot, config: Any, recordings: list[Recording], joint: Estimate) -> dict[str, Estimate | str]:
    found: dict[str, Estimate | str] = {"joint": joint}
    for method in fit.METHODS:
        if method not in found:
            try:
                found[method] = fit.fit(method, robot, config, recordings)
            except InputError as error:
                found[method] = str(error)
    return found


def _uncertainty(robot: Robot, result: dict[str, Any]) -> Uncertainty:
    body, P = result["body"][0], np.array(result["covariance"])
    E = block_statistics.by_body(robot, np.array(body["theta_possible"]))
    S = E @ P[:10, :10] @ E.T
    std = np.sqrt(np.diag(S))
    inverse = np.linalg.inv(E)
    information = inverse.T @ np.linalg.inv(P)[:10, :10] @ inverse
    before = inertiad_core.body(*prior(robot))
    prior_std = np.array([before["mass_std"], *before["cog_std"], *before["inertia_cog_std"]])
    return Uncertainty(
        prior_std, std, 1.0 / np.sqrt(np.diag(information)), S / np.outer(std, std), findings.shares(robot, result)
    )


def _predictions(config: Any, usable: list[Run]) -> list[Validation | None]:
    """Each run's wrench as the other runs predict it."""
    if not 2 <= len(usable) <= HELD_OUT_MAX:
        return [None] * len(usable)
    found: list[Validation | None] = []
    recordings = [run.recording for run in usable if run.recording is not None]
    for i, left_out in enumerate(recordings):
        others = fit.joint(config, [run for j, run in enumerate(recordings) if j != i])
        found.append(fit.validate(config, others, left_out))
    return found


def _nearest_model(robot: Robot, joint: Estimate) -> Model:
    value = joint.body.value
    body = Nominal.model_construct(mass=value[0], cog=list(value[1:4]), inertia_cog=list(value[4:]))
    return Model(robot, robot.name, body)


def _simulated(paths: list[Path]) -> dict[str, Any]:
    keys = ("trajectory", "rate", "duration_s", "seed", "faults_name")
    file = paths[0] / "truth.json"
    return {k: v for k, v in read_json(file).items() if k in keys} if file.exists() else {}


def _together(found: list[Run], command: str, progress: Progress) -> Facts:
    usable = [run for run in found if run.is_usable]
    recordings = [run.recording for run in usable if run.recording is not None]
    robot = recordings[0].robot
    config = reader.config_of(robot, robot.name)
    progress("fit all runs together")
    done = identification.joint(robot, config, recordings, diagnose.of_signals(robot, recordings), progress)
    if done.result is None:
        return Facts(robot, found, found=done.findings, command=command)
    result = fit.batch(config, recordings) if done.segments else done.result
    joint = fit.of_batch("joint", result)
    residuals = [cables.residual(config, joint, recording) for recording in recordings]
    progress("compare methods")
    methods = _methods(robot, config, recordings, joint)
    progress("compare force sensors")
    noise = np.sqrt(np.mean([np.square(f["noise_std"]) for f in result["fit"]], axis=0))
    tension = np.concatenate([r.tension for r in residuals])
    force_check = cables.check(_nearest_model(robot, joint), joint, noise, recordings, tension)
    parts = zip(usable, residuals, _predictions(config, usable), strict=True)
    complete = {id(run): replace(run, residual=residual, prediction=prediction) for run, residual, prediction in parts}
    paths = [run.path for run in usable]
    return Facts(
        robot,
        [complete.get(id(run), run) for run in found],
        joint,
        methods,
        _uncertainty(robot, result),
        force_check,
        [_motion(config, recording) for recording in recordings],
        np.maximum(np.array(inertiad_core.systematic_std(config)), 1e-12),
        fit.truth_of(paths),
        _simulated(paths),
        done.findings,
        command,
    )


def gather(paths: list[Path], robot_file: Path | None, command: str, progress: Progress) -> Facts:
    """Read and compute. InputError: a path is not there, has no robot description, or is of another robot."""
    found = []
    for path, name in zip(paths, _names(paths), strict=True):
        if not path.exists():
            raise InputError(f"{path}: No such file or directory")
        progress(f"read {name}")
        found.append(_read(path, name, robot_file))
    robot = found[0].robot
    for run in found:
        if run.robot.n_cables != robot.n_cables:
            raise InputError(f"{run.path}: {run.robot.n_cables} cables: allowed: {robot.n_cables}, as in {paths[0]}")
    if not any(run.is_usable for run in found):
        return Facts(robot, found, command=command)
    return _together(found, command, progress)
