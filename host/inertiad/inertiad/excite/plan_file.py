# SPDX-License-Identifier: Apache-2.0
"""Files of a plan: pose CSV, JSON with predicted sigmas, a picture; and its summary as text."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from inertiad.base import quantity
from inertiad.base.body import NAMES, UNITS
from inertiad.base.table import Array
from inertiad.excite.planner import FINE_RATE, Plan, Request, sampled
from inertiad.excite.underactuated import elastic
from inertiad.identify import fisher_information
from inertiad.model import forward_dynamics
from inertiad.model.trajectory import DERIVATIVE_NAMES, POSE_NAMES, Rotation


def write_csv(path: Path, request: Request, plan: Plan, rate: float = fisher_information.REHEARSAL_RATE) -> None:
    """t, pose and derivatives, see trajectory.DERIVATIVE_NAMES.

    Fewer than six cables: of the level poses that are commanded, with the unstrained lengths l_1 .. l_m [m] they mean.
    """
    t, motion = sampled(plan.path, rate)
    rpy = np.unwrap(Rotation.from_matrix(motion.R).as_euler("ZYX")[:, ::-1], axis=0)
    data = np.column_stack([t, motion.p, rpy, motion.v, motion.a, motion.omega, motion.alpha])
    names, checker = ("t", *POSE_NAMES, *DERIVATIVE_NAMES), request.checker
    n_cables = checker.model.robot.n_cables
    if n_cables < 6:
        lengths = forward_dynamics.lengths_at_rest(checker.mechanics, motion, elastic(checker))
        names, data = (*names, *quantity.lengths(n_cables)), np.hstack([data, lengths])
    np.savetxt(path, data, delimiter=",", header=",".join(names), comments="", fmt="%.9g")


def document(request: Request, plan: Plan) -> dict[str, Any]:
    """Contents of the plan's JSON file; sigma as in estimate.json."""
    body, sigma, limits = request.checker.model.body, plan.sigma.tolist(), request.checker.limits
    keys = {"mass": sigma[0], "cog": sigma[1:4], "inertia_cog": sigma[4:]}
    values = {"mass": body.mass, "cog": body.cog, "inertia_cog": body.inertia_cog}
    return {
        "method": plan.method,
        "criterion": request.criterion,
        "seed": request.seed,
        "duration_s": plan.path.duration,
        "predicted": {key: {"value": values[key], "std": keys[key]} for key in keys},
        "covariance": plan.covariance.tolist(),
        "tension_N": {"min": plan.tension[0], "max": plan.tension[1]},
        "limits": {
            "box_m": [*limits.low.tolist(), *limits.high.tolist()],
            "tilt_deg": float(np.rad2deg(limits.tilt)),
            "yaw_deg": float(np.rad2deg(limits.yaw)),
            "speed": limits.speed,
            "acceleration": limits.acceleration,
            "clearance": limits.clearance,
        },
        "binding": plan.binding,
        "remarks": plan.remarks,
        **_driven(plan),
    }


def _driven(plan: Plan) -> dict[str, Any]:
    moved = plan.driven
    tension = {"min": float(moved.f.min()), "max": float(moved.f.max())}
    return {"driven": {"plant": "elastic", "tension_N": tension, "strays_m": moved.strays}}


def write_json(path: Path, request: Request, plan: Plan) -> None:
    path.write_text(json.dumps(document(request, plan), indent=1) + "\n")


def draw(path: Path, request: Request, plan: Plan) -> None:
    """A PNG of the motion on elastic cables, its tensions against their limits and predicted sigma ellipses."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    t, motion = sampled(plan.driven, FINE_RATE)
    rpy = np.rad2deg(Rotation.from_matrix(motion.R).as_euler("ZYX")[:, ::-1])
    figure, axes = plt.subplots(2, 3, figsize=(15, 8), layout="constrained")
    axes[0, 0].plot(motion.p[:, 0], motion.p[:, 1], lw=1)
    axes[0, 0].set(xlabel="x [m]", ylabel="y [m]", title="path of P from above", aspect="equal")
    axes[0, 1].plot(t, motion.p, label=POSE_NAMES[:3], lw=1)
    axes[0, 1].set(xlabel="t [s]", ylabel="m", title="position")
    axes[0, 2].plot(t, rpy, label=POSE_NAMES[3:], lw=1)
    axes[0, 2].set(xlabel="t [s]", ylabel="deg", title="attitude")
    f = plan.driven.tensions(t)
    axes[1, 0].plot(t, f, lw=1, label=[f"cable {i + 1}" for i in range(f.shape[1])])
    low = max(c.tension_min for c in request.checker.model.robot.cable)
    high = min(c.tension_max for c in request.checker.model.robot.cable)
    axes[1, 0].axhline(low, color="red", lw=1, ls="--")
    axes[1, 0].axhline(high, color="red", lw=1, ls="--")
    axes[1, 0].set(
        xlabel="t [s]",
        ylabel="N",
        title="tensions on elastic cables, limits dashed",
        ylim=(0.0, min(1.1 * high, 2 * f.max())),
    )
    _ellipses(axes[1, 1], plan.covariance, ((1, 2, "x, y"), (1, 3, "x, z"), (2, 3, "y, z")), 1e3)
    axes[1, 1].set(xlabel="mm", ylabel="mm", title="centre of gravity: one sigma", aspect="equal")
    _ellipses(axes[1, 2], plan.covariance, ((4, 5, "xx, yy"), (4, 6, "xx, zz"), (5, 6, "yy, zz")), 1.0)
    axes[1, 2].set(xlabel="kg m2", ylabel="kg m2", title="inertia about it: one sigma", aspect="equal")
    for axis in axes[1, 1:]:
        axis.set_adjustable("datalim")
    for axis in axes.flat[1:]:
        axis.legend(fontsize=8, ncols=2)
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def _ellipses(axis: Any, covariance: Array, pairs: tuple[tuple[int, int, str], ...], scale: float) -> None:
    """One-sigma ellipses of pairs (i, j, label) of the covariance, times scale."""
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    for i, j, label in pairs:
        L = np.linalg.cholesky(covariance[np.ix_([i, j], [i, j])])
        x, y = scale * L @ np.array([np.cos(angle), np.sin(angle)])
        axis.plot(x, y, lw=1, label=label)


def summary(plan: Plan) -> list[str]:
    """The plan in a few lines."""
    units = {"kg": (1.0, "kg"), "m": (1e3, "mm"), "kg m2": (1.0, "kg m2")}
    sigma = [f"{n} {s * units[u][0]:.2g} {units[u][1]}" for n, s, u in zip(NAMES, plan.sigma, UNITS, strict=True)]
    return [
        f"{plan.method}: {plan.path.duration:.1f} s, tensions {plan.tension[0]:.0f} to {plan.tension[1]:.0f} N",
        f"predicted sigma: {', '.join(sigma)}",
        f"limits it touches: {', '.join(plan.binding) or 'none'}",
        *_driven_lines(plan),
        *plan.remarks,
    ]


def _driven_lines(plan: Plan) -> list[str]:
    moved = plan.driven
    tensions = f"tensions {moved.f.min():.0f} to {moved.f.max():.0f} N"
    how = "driven by a controller" if moved.f.shape[1] >= 6 else "let swing"
    return [f"{how} on elastic cables: {tensions}, P within {1e3 * moved.strays:.1f} mm"]
