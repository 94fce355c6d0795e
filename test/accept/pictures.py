# SPDX-License-Identifier: Apache-2.0
"""Pictures of the acceptance runs, PNG in build/accept/."""

from typing import Any

import numpy as np
from scenes import COGIRO
from verdict import scratch

from inertiad.base.body import NAMES
from inertiad.robot import description

OURS, THEIRS, TRUTH, ALARM = "tab:blue", "tab:orange", "black", "tab:red"
TABLE_III = np.array([9.68, 0.113, -0.057, -0.007, 8.03, -36.11, 14.95])
"""estimated - nominal in the paper's Table III: m [kg], rho [m], J xx yy zz [kg m2]"""


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"axes.grid": True, "grid.alpha": 0.3, "axes.spines.top": False, "axes.spines.right": False})
    return plt


def _save(plt: Any, figure: Any, name: str) -> None:
    figure.savefig(scratch(name), dpi=130)
    plt.close(figure)


def coverage(z: dict[str, np.ndarray]) -> None:
    """Claimed against observed coverage; z: |error| / sigma [runs, 10] by method."""
    from scipy.stats import beta, norm

    plt = _pyplot()
    claimed = np.linspace(0.01, 0.99, 99)
    quantile = norm.ppf(0.5 + claimed / 2.0)
    figure, panels = plt.subplots(1, len(z), figsize=(5.2 * len(z) + 1.8, 5.2), sharey=True, layout="constrained")
    for axes, (name, values) in zip(np.atleast_1d(panels), z.items(), strict=True):
        n = len(values)
        observed = (values[:, :, None] < quantile).mean(axis=0)
        low, high = (beta.ppf(p, n * claimed + 0.5, n * (1.0 - claimed) + 0.5) for p in (0.025, 0.975))
        axes.fill_between(claimed, low, high, color="0.88", label=f"95 % of chance in {n} runs")
        for label, line in zip(NAMES, observed, strict=True):
            axes.plot(claimed, line, lw=1, alpha=0.8, label=label)
        axes.plot(claimed, observed.mean(axis=0), color=TRUTH, lw=2.5, label="mean of the ten")
        axes.plot([0, 1], [0, 1], color=TRUTH, ls="--", lw=1)
        axes.set(xlabel="claimed", title=name, aspect="equal", xlim=(0, 1), ylim=(0, 1))
        axes.axvline(0.95, color=TRUTH, ls=":", lw=1)
    figure.supylabel("observed: share of runs whose interval holds the truth")
    figure.suptitle("How often the published interval holds the truth (above the diagonal: cautious)")
    np.atleast_1d(panels)[-1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.02, 0.5))
    _save(plt, figure, "coverage.png")


def pick_up(history: np.ndarray, delay: float, mass: float) -> None:
    """Convergence of a pick-up; history: time from its start [s], mass, its std [kg], alarms so far [N, 4]."""
    plt = _pyplot()
    nominal = description.load(COGIRO).nominal
    assert nominal is not None
    t, m, std, alarms = history[(history[:, 0] > -3.0) & (history[:, 0] < 9.5)].T
    true = nominal.mass + mass * np.clip(t / 0.5, 0.0, 1.0)
    figure, (above, below) = plt.subplots(2, 1, figsize=(8, 6), sharex=True, height_ratios=(2, 1), layout="constrained")
    above.fill_between(t, m - 2.0 * std, m + 2.0 * std, color=OURS, alpha=0.25, label="± 2 sigma")
    above.plot(t, m, color=OURS, label="estimate")
    above.plot(t, true, color=TRUTH, ls="--", lw=1, label="truth")
    above.set(ylabel="mass, kg", ylim=(nominal.mass - 0.4 * mass, nominal.mass + 1.4 * mass))
    above.set_title(f"Pick-up of {mass:g} kg in 0.5 s: alarm after {delay:.2f} s")
    below.semilogy(t, np.abs(m - true), color=OURS, label="|error|")
    below.semilogy(t, 2.0 * std, color=OURS, ls=":", label="2 sigma")
    below.set(ylabel="kg", xlabel="s from the start of the pick-up")
    rung = t[1:][np.diff(alarms) > 0.0]
    for axes in (above, below):
        for i, at in enumerate(rung):
            axes.axvline(at, color=ALARM, lw=1, alpha=0.8, label="alarm" if i == 0 else None)
    above.legend(loc="lower right", fontsize=8)
    below.legend(loc="upper right", fontsize=8)
    _save(plt, figure, "pickup.png")


def paper(two: np.ndarray, joint: np.ndarray, true: np.ndarray, impossible: int) -> None:
    """The paper's experiment repeated: errors [runs, 10] of its two steps and of the joint regressor."""
    plt = _pyplot()
    n = len(two)
    figure, (plane, strips) = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    for errors, color, label in ((two, THEIRS, "two steps, as in the paper"), (joint, OURS, "joint, weak form")):
        x, y, z = 1e3 * errors[:, 1:4].T
        medians = "/".join(f"{np.median(np.abs(v)):.0f}" for v in (x, y, z))
        plane.scatter(x, y, s=18, color=color, alpha=0.6, label=f"{label}: median |error| x/y/z {medians} mm")
        plane.scatter(np.median(x), np.median(y), s=160, marker="+", color=color, lw=2.5)
    plane.scatter(*(1e3 * TABLE_III[1:3]), marker="*", s=140, color=ALARM, label="Table III, the robot itself")
    plane.scatter(0, 0, marker="x", s=60, color=TRUTH, label="truth")
    plane.set(
        xlabel="error of CoG x, mm", ylabel="error of CoG y, mm", title=f"Centre of gravity, {n} runs (+: median)"
    )
    plane.set_ylim(top=plane.get_ylim()[1] + 90.0)  # room for the legend
    plane.legend(fontsize=8, loc="upper left")
    dice = np.random.default_rng(0)
    for i in range(3):
        for errors, color, side in ((two, THEIRS, -0.15), (joint, OURS, 0.15)):
            percent = 100.0 * errors[:, 4 + i] / true[4 + i]
            at = i + side + 0.05 * dice.uniform(-1.0, 1.0, n)
            strips.scatter(at, percent, s=14, color=color, alpha=0.6)
            strips.plot([i + side - 0.11, i + side + 0.11], [np.median(percent)] * 2, color=color, lw=2.5)
        strips.scatter(i - 0.15, 100.0 * TABLE_III[4 + i] / true[4 + i], marker="*", s=140, color=ALARM, zorder=3)
    strips.axhline(0.0, color=TRUTH, lw=1)
    strips.set_xticks(range(3), ["J xx", "J yy", "J zz"])
    strips.set(ylabel="error, %", title=f"Inertia: {impossible} of {n} two-step results no body can have")
    strips.grid(axis="x", visible=False)
    figure.suptitle(
        "The paper's experiment repeated, nothing calibrated: its sensors, its motion, its method, and ours"
    )
    _save(plt, figure, "paper.png")
