# SPDX-License-Identifier: Apache-2.0
"""Courses of events by forces: winches pay out elastic lumped-mass cables, and the platform goes where they pull.

The only way for fewer than six cables; with more, the way to cables that have inertia or go slack.
"""

import ctypes

import numpy as np
from courses import COARSE, FINE, HOSE_AT, CannotMove, pushes_of
from mechanics import Track, catenary, needed_wrench, run_of, tensions, track_of
from motions import Motion
from native import library
from robots import Body, G, Robot
from scipy.interpolate import make_interp_spline
from sensors import Course, Draws, Faults

CABLES = 8
MASSES = 8
"""per cable, at home; half as many where the cable is light"""
LIGHT = 0.2
"""N/m"""
LENGTH_DT = 1e-3
SETTLE = 6.0
"""s to come to rest before the recording begins"""
_d = ctypes.c_double


class _Body(ctypes.Structure):
    _fields_ = (("mass", _d), ("cog", _d * 3), ("inertia", _d * 9), ("inertia_inverse", _d * 9))


class Plant(ctypes.Structure):
    """plant_t of plant.c."""

    _fields_ = (
        *((name, _d) for name in ("gravity", "dt", "settle", "radius", "density", "stiffness")),
        *((name, _d) for name in ("damping_time", "drag", "spacing")),
        *((name, _d * 3 * CABLES) for name in ("anchor", "attachment", "axis")),
        *(("hose_pull", _d * 3), ("hose_rate", _d), ("hose_at", _d * 3), ("hose_home", _d * 3)),
        *(("lean_at", _d * 3), ("kick", _d * 6), ("start", _d * 3), ("change", _d), ("body", _Body * 2)),
        *((name, ctypes.c_int) for name in ("n_cables", "n_fine", "length_steps")),
        *(("fine_dt", _d), ("length_dt", _d)),
    )


ROW = [("p", 3), ("R", 9), ("v", 3), ("a", 3), ("omega", 3), ("alpha", 3)]
ROW += [("tension", CABLES), ("top", CABLES), ("wrap", CABLES), ("energy", 1)]


def _body_struct(body: Body) -> _Body:
    m = float(body.mass.sum())
    cog = body.mass @ body.point / m
    d = body.point - cog
    J = np.einsum("k,kij->ij", body.mass, (d**2).sum(1)[:, None, None] * np.eye(3) - d[:, :, None] * d[:, None, :])
    return _Body(m, tuple(cog), tuple(J.ravel()), tuple(np.linalg.inv(J).ravel()))


def _rows(values: np.ndarray) -> ctypes.Array:  # type: ignore[type-arg]
    filled = np.zeros((CABLES, 3))
    filled[: len(values)] = values
    return (_d * 3 * CABLES)(*[(_d * 3)(*row) for row in filled])


def time_step(robot: Robot, density: float, spacing: float) -> tuple[float, float]:
    """Step [s] and the cables' damping time [s] at which explicit steps are stable with room to spare."""
    if spacing == 0.0:
        return 1e-4, 2e-3
    omega = 2.0 * np.sqrt(robot.stiffness / density) / spacing
    damping = min(1e-3, 2.0 / omega)
    dt = min(0.4 / omega, 0.4 / (omega**2 * damping))
    return FINE**-1 / np.ceil(FINE**-1 / dt), damping


def run_plant(plant: Plant, length: np.ndarray, push: np.ndarray) -> dict[str, np.ndarray]:
    """What happens: columns of ROW, each [n_fine, ...]."""
    native = library()
    native.plant_size.restype = ctypes.c_size_t
    assert native.plant_size(0) == ctypes.sizeof(Plant)
    width = sum(n for _, n in ROW)
    assert native.plant_size(1) == 8 * width
    rows = np.zeros((plant.n_fine, width))
    length, push = np.ascontiguousarray(length), np.ascontiguousarray(push)
    pointers = (x.ctypes.data_as(ctypes.c_void_p) for x in (length, push, rows))
    native.plant_run(ctypes.byref(plant), *pointers)
    ends = np.cumsum([n for _, n in ROW])
    return {name: rows[:, end - n : end] for (name, n), end in zip(ROW, ends, strict=True)}


def track_from(t: np.ndarray, seen: dict[str, np.ndarray]) -> Track:
    """Positions and derivatives from the plant's rows."""
    R = seen["R"].reshape(-1, 3, 3)

    def world_skew(w: np.ndarray) -> np.ndarray:
        zero = np.zeros(len(w))
        x, y, z = w.T
        return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), 2, 0)

    W = world_skew(seen["omega"])
    return Track(t, seen["p"], R, seen["v"], seen["a"], W @ R, (world_skew(seen["alpha"]) + W @ W) @ R)


def commanded(
    robot: Robot, body: Body, motion: Motion, geometry: tuple[np.ndarray, np.ndarray], w: float
) -> np.ndarray:
    """Unstretched lengths [K, m] that would lead the platform along the motion, every LENGTH_DT."""
    coarse = track_of(motion, np.arange(0.0, motion.duration, 1.0 / COARSE))
    cables = run_of(robot, coarse.p, coarse.R, *geometry)
    if robot.is_elastic:
        f = np.full(cables.wrap.shape, 1.5 * robot.mass * G / robot.n_cables)
    else:
        wrench = needed_wrench(coarse, body)
        f, _ = tensions(robot, cables, coarse.p, wrench, w)
        if f.min() < robot.tension[0]:
            raise CannotMove(f"{robot.name}: tensions {f.min():.1f} to {f.max():.1f} N")
    _, hanging = catenary(cables.leave, cables.attachment, f, w)
    middle = f + 0.5 * w * (cables.leave - cables.attachment)[..., 2]
    length = robot.pulley_radius * cables.wrap + hanging / (1.0 + middle / robot.stiffness)
    t = np.arange(0.0, coarse.t[-1], LENGTH_DT)
    return make_interp_spline(coarse.t, length, k=5)(t)


def _slack_windows(length: np.ndarray, faults: Faults, draws: Draws) -> np.ndarray:
    """Cable that a winch pays out too much: three times, a cable each, for a quarter of a minute or less."""
    t = LENGTH_DT * np.arange(len(length))
    more = np.zeros_like(length)
    for k in range(3):
        cable, start = draws.dice.integers(length.shape[1]), (0.2 + 0.25 * k) * t[-1]
        s = np.clip((t - start) / 1.0, 0.0, 1.0) - np.clip((t - start - 4.0) / 1.0, 0.0, 1.0)
        more[:, cable] += faults.slack * s**2 * (3.0 - 2.0 * s)
    return more


def plant_of(
    robot: Robot, bodies: list[Body], geometry: tuple[np.ndarray, np.ndarray], start: np.ndarray, w: float
) -> Plant:
    """The plant at rest, nothing pulling but its cables."""
    density = w / G
    mean = float(np.linalg.norm(geometry[0] - start, axis=1).mean())
    spacing = mean / (MASSES if w > LIGHT else MASSES // 2) if density > 0.0 else 0.0
    dt, damping = time_step(robot, density, spacing)
    plant = Plant(gravity=G, dt=dt, settle=SETTLE, radius=robot.pulley_radius, density=density)
    plant.stiffness, plant.damping_time, plant.drag, plant.spacing = robot.stiffness, damping, 0.4, spacing
    plant.anchor, plant.attachment, plant.axis = (_rows(x) for x in (*geometry, robot.axis))
    plant.start, plant.change = (_d * 3)(*start), 1e9
    plant.body = (_Body * 2)(_body_struct(bodies[0]), _body_struct(bodies[-1]))
    plant.n_cables, plant.fine_dt, plant.length_dt = robot.n_cables, 1.0 / FINE, LENGTH_DT
    return plant


def release(
    robot: Robot, bodies: list[Body], change: float, motion: Motion, geometry: tuple[np.ndarray, np.ndarray],
    faults: Faults, draws: Draws,
) -> Course:  # fmt: skip
    """The motion as the cables make it. CannotMove: no sensible tensions for it."""
    w = robot.weight_per_length if faults.cable_weight is None else faults.cable_weight
    length = commanded(robot, bodies[0], motion, geometry, w)
    t = np.arange(0.0, LENGTH_DT * (len(length) - 1) - 1.0 / COARSE, 1.0 / FINE)
    if faults.slack:
        length += _slack_windows(length, faults, draws)
    plant = plant_of(robot, bodies, geometry, motion.pose(np.zeros(1))[0][0], w)
    if len(bodies) > 1:
        plant.change = change
    if motion.is_released:
        kick = np.r_[draws.dice.uniform(0.2, 0.4, 3) * [1, 1, 0.1], draws.dice.uniform(0.1, 0.3, 3)]
        plant.kick = (_d * 6)(*(kick * draws.dice.choice([-1.0, 1.0], 6)))
    if faults.hose:
        pull = faults.hose * draws.direction() * [0.6, 0.6, 1.0]
        plant.hose_pull, plant.hose_rate = (_d * 3)(*pull), 0.2 * faults.hose
        plant.hose_at, plant.hose_home = (_d * 3)(*(HOSE_AT * robot.size)), (_d * 3)(*robot.home)
        draws.drawn["hose"] = pull.tolist()
    plant.lean_at = (_d * 3)(*(np.array([0.5, 0.3, 0.2]) * robot.size))
    plant.n_fine, plant.length_steps = len(t), len(length)
    seen = run_plant(plant, length, pushes_of(robot, faults, draws, t))
    if not np.isfinite(seen["p"]).all() or np.abs(seen["p"] - robot.home).max() > 20.0:
        raise CannotMove(f"{robot.name}: the elastic plant flew apart")
    m = robot.n_cables
    paid = make_interp_spline(LENGTH_DT * np.arange(len(length)), length, k=1)(t)
    return Course(track_from(t, seen), seen["tension"][:, :m], seen["top"][:, :m], seen["wrap"][:, :m], paid)
