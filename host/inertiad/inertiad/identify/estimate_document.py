# SPDX-License-Identifier: Apache-2.0
"""Contents of the estimate.json that `inertiactl fit` writes."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from inertiad.base.finding import Finding, ordered, verdict
from inertiad.identify.fit import Estimate, Segment, Validation
from inertiad.robot import systematic
from inertiad.robot.description import Robot
from inertiad.run.reader import Recording


def _quantity(value: Any, std: Any) -> dict[str, Any]:
    """A method without a sigma has null."""
    has_std = bool(np.all(np.isfinite(std)))
    return {"value": value, "std": std if has_std else None if np.ndim(std) == 0 else [None] * len(std)}


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


def _body_json(estimate: Estimate) -> dict[str, Any]:
    value, std = estimate.body.value, estimate.body.std
    return {
        "mass": _quantity(value[0], std[0]),
        "cog": _quantity(list(value[1:4]), list(std[1:4])),
        "inertia_cog": _quantity(list(value[4:]), list(std[4:])),
    }


def _segment_json(segment: Segment) -> dict[str, Any]:
    return {
        "run": str(segment.path),
        "begin": segment.begin,
        "end": segment.end,
        **_body_json(segment.estimate),
        "observable": _observable_json(segment.estimate),
    }


def _observable_json(estimate: Estimate) -> dict[str, Any]:
    seen = list(estimate.observable)
    return {"mass": seen[0], "cog": seen[1:4], "inertia_cog": seen[4:]}


def document(
    robot: Robot,
    estimate: Estimate | None,
    recordings: list[Recording],
    held_out: list[Validation],
    findings: list[Finding],
    segments: list[Segment],
) -> dict[str, Any]:
    """Contents of estimate.json. estimate None: no body is near what the data say, and the file has none."""
    counters: dict[str, int] = {}
    for run in recordings:
        for name, count in run.counters.items():
            counters[name] = counters.get(name, 0) + count
    judged = {
        "converged": estimate is not None and estimate.is_converged,
        "verdict": verdict(findings),
        "findings": [finding.document() for finding in ordered(findings)],
    }
    found: dict[str, Any] = {}
    if estimate is not None:
        found = {
            "method": estimate.method,
            **_body_json(estimate),
            **_sensors(robot, estimate),
            "consistent": estimate.consistent,
            "distance": estimate.distance,
            "observable": _observable_json(estimate),
            "residual_rms": estimate.rms.tolist(),
            "notes": [*estimate.notes, *(note for run in recordings for note in run.notes)],
        }
    return {
        **found,
        **judged,
        "segments": [_segment_json(segment) for segment in segments],
        "validation": [_validation_json(v) for v in held_out],
        "samples": {
            "frames": sum(run.n_frames for run in recordings),
            "used": sum(len(run.rows) for run in recordings),
            "rejected": sum(run.n_rejected for run in recordings),
            "windows": 0 if estimate is None else estimate.n_windows,
        },
        "duration_s": sum(run.duration for run in recordings),
        "counters": counters,
    }


def write(path: Path, data: dict[str, Any]) -> None:
    """Write estimate.json."""
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
