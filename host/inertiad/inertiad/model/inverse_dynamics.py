# SPDX-License-Identifier: Apache-2.0
"""Inverse dynamics: the wrench that a motion needs, and the tensions that give it.

    F   = m (f_P + alpha x rho + omega x (omega x rho))          f_P = R^T (a_P + g z)
    tau = m rho x f_P + J_P alpha + omega x J_P omega            platform axes, about P
    W f + sag + C = [F; tau],  tension_min <= f <= tension_max       W, sag from the C core; C: the cables' mass, in
                                                                    host/eigen/include/inertiad/cable_mass.hpp
Tensions come in closed form, closest to an even pull; samples that break a limit get the nearest ones that do not, by a
quadratic programme in the null space of W.
"""

from dataclasses import dataclass
from typing import Any

import daqp
import numpy as np

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.model.payload import Payload
from inertiad.model.trajectory import Motion
from inertiad.robot.description import Robot
from inertiad.robot.keys import Nominal, inertia_matrix


@dataclass(frozen=True)
class Swing:
    """Lateral oscillation of the cables, each in two directions."""

    amplitude: float
    """rad"""
    hz: Array
    """Hz [m, 2]"""
    phase: Array
    """rad [m, 2], at t = 0"""


@dataclass(frozen=True)
class Mechanics:
    """The true robot: the compiled description with its true geometry, and the body that hangs on it."""

    config: Any
    """inertiad_core.Config"""
    robot: Robot
    """with the true anchors and attachments"""
    body: Nominal
    swing: Swing | None = None
    """of the cables; None: they stay in the plane of their sag"""
    payloads: tuple[Payload, ...] = ()
    """taken up or set down while the body moves"""


def specific_force(motion: Motion, gravity: float, point: Array) -> Array:
    """Specific force at a platform point [3], P axes, m/s2 [N, 3]."""
    f_P = np.einsum("nji,nj->ni", motion.R, motion.a + np.array([0.0, 0.0, gravity]))
    w = motion.omega
    return f_P + np.cross(motion.alpha, point) + np.cross(w, np.cross(w, point))


def required_wrench(motion: Motion, body: Nominal, gravity: float) -> Array:
    """Force and moment about P the cables must give, P axes, N and N m [N, 6]: Newton and Euler."""
    rho = np.array(body.cog)
    J_C = inertia_matrix(body.inertia_cog)
    force = body.mass * specific_force(motion, gravity, rho)
    spin = motion.alpha @ J_C + np.cross(motion.omega, motion.omega @ J_C)
    return np.hstack([force, spin + np.cross(rho, force)])


def true_wrench(mechanics: Mechanics, t: Array, motion: Motion) -> Array:
    """required_wrench() of the body and its payloads at times t [N]."""
    gravity = mechanics.robot.gravity
    wrench = required_wrench(motion, mechanics.body, gravity)
    if mechanics.payloads:
        Y = inertiad_core.regressor(specific_force(motion, gravity, np.zeros(3)), motion.omega, motion.alpha)
        carried = sum(payload.share(t)[:, None] * payload.theta for payload in mechanics.payloads)
        wrench = wrench + np.einsum("nij,nj->ni", Y, carried)
    return wrench


def _swung(mechanics: Mechanics, swing: Swing, t: Array, motion: Motion) -> Array:
    """Change of the wrench matrix [N, 6, m] by the cables' lateral oscillation."""
    u = inertiad_core.cable_geometry(mechanics.config, motion.p, motion.R)[0]
    first = np.cross(u, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first, axis=2, keepdims=True)
    angle = swing.amplitude * np.sin(2.0 * np.pi * swing.hz * t[:, None, None] + swing.phase)
    tilt_W = angle[:, :, :1] * first + angle[:, :, 1:] * np.cross(u, first)
    tilt = np.einsum("nji,nkj->nki", motion.R, tilt_W)
    attachment = np.array([c.attachment for c in mechanics.robot.cable])
    return np.concatenate([tilt, np.cross(attachment, tilt)], axis=2).transpose(0, 2, 1)


def wrench_matrix(mechanics: Mechanics, t: Array, motion: Motion) -> tuple[Array, Array]:
    """W [N, 6, m] and sag [N, 6] about P at times t [N]. InputError where a cable has no direction."""
    try:
        W, sag = inertiad_core.wrench_matrix(mechanics.config, motion.p, motion.R, np.zeros(3))
    except ValueError as error:
        raise InputError(f"trajectory: {error}") from None
    if mechanics.swing is not None:
        W = W + _swung(mechanics, mechanics.swing, t, motion)
    return W, sag


def cable_mass_wrench(mechanics: Mechanics, motion: Motion) -> Array:
    """Wrench [N, 6] of the mass of the cables that a motion moves, about P, P axes."""
    m = motion
    rows = (np.ascontiguousarray(x) for x in (m.p, m.v, m.a, m.R, m.omega, m.alpha))
    return np.asarray(inertiad_core.cable_mass_wrench(mechanics.config, *rows))


def even_pull(W: Array, wrench: Array, pull: Array) -> Array:
    """Tensions [N, m] with W f = wrench closest to pull [m]; least squares where the robot cannot give the wrench."""
    if W.shape[2] < 6:
        return np.einsum("nij,nj->ni", np.linalg.pinv(W), wrench)
    gap = wrench - W @ pull
    gram = W @ W.transpose(0, 2, 1)
    try:
        weight = np.linalg.solve(gram, gap[:, :, None])
    except np.linalg.LinAlgError:
        weight = np.linalg.pinv(gram) @ gap[:, :, None]
    return pull + (W.transpose(0, 2, 1) @ weight)[:, :, 0]


def _within_limits(W: Array, f: Array, low: Array, high: Array) -> Array | None:
    """The tensions closest to f [m] with the same wrench by W [6, m] and low <= f <= high, or None: there are none."""
    null = np.linalg.svd(W)[2][np.linalg.matrix_rank(W) :]
    if len(null) == 0:
        return None
    n = len(null)
    z, _, flag, _ = daqp.solve(
        np.eye(n),
        np.zeros(n),
        np.ascontiguousarray(null.T),
        high - f,
        low - f,
        np.zeros(len(f), dtype=np.int32),
    )
    return f + z @ null if flag == 1 else None


def tensions(mechanics: Mechanics, t: Array, motion: Motion) -> Array:
    """True cable tensions [N, m], N. InputError with time, cable and value where none are possible."""
    robot = mechanics.robot
    low = np.array([c.tension_min for c in robot.cable])
    high = np.array([c.tension_max for c in robot.cable])
    W, sag = wrench_matrix(mechanics, t, motion)
    wrench = true_wrench(mechanics, t, motion) - sag - cable_mass_wrench(mechanics, motion)
    share = 2.0 * mechanics.body.mass * robot.gravity / robot.n_cables
    f = even_pull(W, wrench, np.clip(np.full(robot.n_cables, share), low, high))
    missing = np.abs((W @ f[:, :, None])[:, :, 0] - wrench).max(axis=1)
    if missing.max() > 1e-6 * np.abs(wrench).max():
        at = int(np.argmax(missing))
        raise InputError(
            f"trajectory: t = {t[at]:.3f} s: {robot.n_cables} cables cannot hold the platform in this pose and motion: "
            f"{missing[at]:.3g} N or N m is missing{free_hint(robot)}"
        )
    for k in np.flatnonzero(((f < low) | (f > high)).any(axis=1)):
        found = _within_limits(W[k], f[k], low, high)
        if found is None:
            raise InputError(_slack_message(robot, float(t[k]), motion.p[k], f[k], low, high))
        f[k] = found
    return f


def free_hint(robot: Robot) -> str:
    """ "; pass --plant elastic ...", where cables leave degrees of freedom free, else nothing."""
    if robot.n_cables >= 6:
        return ""
    return f"; {robot.n_cables} cables leave {6 - robot.n_cables} degrees of freedom free: pass --plant elastic"


def below_hint(robot: Robot, height: float) -> str:
    """ "; every anchor is below ...", where P at a height [m] hangs from nothing, else nothing."""
    is_below = max(cable.anchor[2] for cable in robot.cable) < height
    return "; every anchor is below the platform, cables only pull" if is_below else ""


def _slack_message(robot: Robot, t: float, p: Array, f: Array, low: Array, high: Array) -> str:
    worst = int(np.argmax(np.maximum(low - f, f - high)))
    cable, hint = robot.cable[worst], below_hint(robot, float(p[2]))
    return (
        f"trajectory: t = {t:.3f} s: no tensions within the limits hold the platform: "
        f"cable {worst + 1} = {f[worst]:.4g} N: allowed: {cable.tension_min:g} to {cable.tension_max:g} N{hint}"
    )
