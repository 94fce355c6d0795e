# SPDX-License-Identifier: Apache-2.0
"""The scenes: every mechanism by which a real set-up differs from a simulated one, with a size."""

from dataclasses import replace
from itertools import product

import numpy as np
from courses import HOSE_AT
from laboratory import Scene
from robots import ROBOTS
from sensors import Faults

DRIVEN = ("hall", "desk", "hexa", "frame", "facade")
"""six cables and more: the pose is commanded"""
HUNG = ("four", "lab")
"""four cables: the pose follows"""
DEG = np.pi / 180.0


def _hose(robot: str) -> dict[str, object]:
    return {"constant": True, "stiffness": True, "attachment": (HOSE_AT * ROBOTS[robot].size).tolist()}


def _declared() -> list[Scene]:
    """Declared errors only: every robot, every motion it can do."""
    scenes = [Scene("declared", DRIVEN + HUNG, "fourier", known="declared")]
    for motion, robots in (
        ("pick", ("hall", "frame", "four")),
        ("translate", ("desk", "hexa")),
        ("yaw", ("hall", "frame")),
        ("vertical", ("facade", "desk")),
        ("stops", ("hall", "desk")),
        ("gallery", ("hexa", "frame", "lab")),
        ("swing", ("hall", "four", "lab")),
    ):
        scenes.append(Scene(f"declared-{motion}", robots, motion, known="declared"))
    scenes.append(Scene("declared-60s", ("four", "hall", "hexa"), "fourier", duration=60.0, known="declared"))
    scenes.append(Scene("declared-pick-60s", ("hall", "hexa", "frame"), "pick", duration=60.0, known="declared"))
    ideal = Faults(perfect=True)
    scenes.append(Scene("perfect", (*DRIVEN, "four"), "fourier", ideal, known="declared"))
    long = Faults(without=("acc_bias", "attitude", "imu_alignment", "imu_position", "force_offset", "geometry"))
    scenes.append(Scene("gain-600s", ("hall", "hexa"), "fourier", long, 600.0, known="declared", rate=25.0))
    return scenes


def _attitude() -> list[Scene]:
    some = ("hall", "desk", "hexa", "frame")
    scenes = []
    for kind, (name, tilt) in product(("mahony", "madgwick", "kalman"), (("0.5deg", 0.5), ("4deg", 4.0))):
        robots = some if kind == "mahony" else some[:2] if kind == "madgwick" else some[2:]
        robots = (*robots, "four") if kind == "mahony" else robots
        scenes.append(Scene(f"ahrs-{name}-{kind}", robots, "fourier", Faults(ahrs=kind, ahrs_tilt=tilt * DEG)))
    scenes.append(Scene("attitude-late-20ms", some, "fourier", Faults(attitude_delay=0.020)))
    return scenes


def _forces() -> list[Scene]:
    some, turning = ("hall", "hexa", "frame"), ("hall", "hexa", "frame", "desk")
    winch = {"cables": {"force_at": "winch"}}
    drift, wander = Faults(offset_drift=1.0 / 60.0), {"std": {"force_offset_drift": 0.3}}
    hung = Scene("friction-lab-3%", ("lab",), "gallery", Faults(friction=0.03), 60.0)
    scenes = [
        Scene("forces-late-5ms", some, "fourier", Faults(force_delay=0.005)),
        Scene("forces-late-20ms", (*some, "desk"), "fourier", Faults(force_delay=0.020)),
        Scene("forces-bessel-10Hz", (*some, "desk"), "fourier", Faults(lowpass="bessel", lowpass_hz=10.0)),
        Scene("forces-butterworth-5Hz", ("hall",), "fourier", Faults(lowpass="butterworth", lowpass_hz=5.0)),
        hung,
        Scene("hysteresis-0.5%", some, "fourier", Faults(hysteresis=0.005)),
        Scene("offset-drift-1N/min", some, "fourier", drift, 300.0, rate=50.0),
        Scene("offset-drift-declared", some, "fourier", drift, 300.0, wander, rate=50.0),
        Scene("quantised-12bit", some, "fourier", Faults(quantum=1.2)),
        Scene("gain-common-2%", some, "fourier", Faults(common_gain=0.02), known="silent"),
    ]
    for name, size in (("1%", 0.01), ("3%", 0.03)):
        faults = Faults(friction=size, force_at="winch")
        scenes.append(Scene(f"friction-{name}", turning, "fourier", faults, declare=winch))
        scenes.append(Scene(f"friction-{name}-facade", ("facade",), "fourier", faults, declare=winch))
        scenes.append(Scene(f"friction-{name}-pick", ("hall", "frame"), "pick", faults, declare=winch))
    scenes.append(Scene("friction-3%-undeclared", turning, "fourier", Faults(friction=0.03, force_at="winch")))
    return scenes


def _cables() -> list[Scene]:
    moved = Faults(cable_inertia=True)
    own = Scene("cable-inertia-own", ("hall",), "fourier", moved)
    heavy = Scene(
        "cable-inertia-2.5N/m", ("hall", "hexa"), "fourier", replace(moved, cable_weight=2.5),
        declare={"cables": {"weight_per_length": 2.5}},
    )  # fmt: skip
    untold = Scene(
        "cable-weight-untold", ("facade", "hall"), "fourier", declare={"cables": {"weight_per_length": 0.0}},
        known="silent",
    )  # fmt: skip
    return [own, heavy, Scene("slack", ("hall", "frame"), "fourier", Faults(slack=0.12)), untold]


def _geometry() -> list[Scene]:
    return [
        Scene("imu-off-3cm", ("hall", "frame"), "fourier", Faults(imu_off=0.03)),
        Scene("target-off-2cm", ("desk", "hall"), "fourier", Faults(target_off=0.02)),
        Scene("geometry-5mm", ("frame", "hall"), "fourier", Faults(geometry_off=0.005)),
        Scene("scales-1%", ("hall", "desk", "hexa", "frame"), "fourier", Faults(acc_scale=0.01, gyro_scale=0.01)),
        Scene("acc-scale-1%", ("hall", "hexa"), "fourier", Faults(acc_scale=0.01)),
        Scene("gyro-scale-1%", ("hall", "hexa"), "fourier", Faults(gyro_scale=0.01)),
        Scene("tracker-late-30ms", ("hall",), "fourier", Faults(position_delay=0.030)),
    ]


def _disturbed() -> list[Scene]:
    some = ("hall", "hexa", "frame")
    scenes = [
        Scene("tracker-spikes-10", some, "fourier", Faults(tracker_spikes=10)),
        Scene("force-spikes-10", some, "fourier", Faults(force_spikes=10)),
        Scene("tracker-gaps", some, "fourier", Faults(tracker_gaps=8)),
        Scene("pushed-four", ("four",), "fourier", Faults(pushes=20.0), 60.0),
        Scene("pushed", ("hall", "hexa"), "fourier", Faults(pushes=60.0), 60.0),
    ]
    for robot in ("hall", "hexa"):
        hose = Faults(hose=30.0)
        scenes.append(Scene("hose-30N-declared", (robot,), "fourier", hose, declare={"external": _hose(robot)}))
        scenes.append(Scene("hose-30N-undeclared", (robot,), "fourier", hose))
    for name, size in (("20%", 0.20), ("2%", 0.02), ("1%", 0.01)):
        scenes.append(Scene(f"payload-{name}", some, "pick", Faults(payload=size), 60.0))
    for kind in ("frozen", "saturated", "dead"):
        scenes.append(Scene(f"sensor-{kind}", ("hall", "frame"), "fourier", Faults(broken=kind)))
    return scenes


def _all_at_once() -> list[Scene]:
    """AHRS 1.5 deg, yaw 1 deg, Bessel, hysteresis 0.2 %, friction 1 %, gain 1 %, scales 0.3 %, hose, geometry 3 mm."""
    scenes = []
    for robot in ("hall", "hexa", "frame"):
        faults = Faults(
            ahrs="mahony", ahrs_tilt=1.5 * DEG, yaw_wander=1.0 * DEG, lowpass="bessel", lowpass_hz=15.0,
            hysteresis=0.002, friction=0.01, force_at="winch", acc_scale=0.003, gyro_scale=0.003,
            hose=0.1 * ROBOTS[robot].mass,
        )  # fmt: skip
        declare = {
            "cables": {"force_at": "winch"},
            "external": _hose(robot),
            "std": {"geometry": 0.003, "force_gain": 0.01},
        }
        scenes.append(Scene("all-at-once", (robot,), "fourier", faults, 60.0, declare=declare))
    return scenes


SCENES = [*_declared(), *_attitude(), *_forces(), *_cables(), *_geometry(), *_disturbed(), *_all_at_once()]
