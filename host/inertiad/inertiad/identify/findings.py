# SPDX-License-Identifier: Apache-2.0
"""What a fit's result is worth: one rule per cause, for fit, calibrate and report alike.

Every rule looks at the batch solver's result and says, in words of the robot, what is wrong, with the numbers behind it
and what to do. stop: the numbers are not to be used; care: they are, with the sigma that stands beside them.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from inertiad.base.body import NAMES, UNITS
from inertiad.base.error import InputError
from inertiad.base.finding import Finding, Severity
from inertiad.base.table import Array
from inertiad.identify import block_statistics, fit
from inertiad.identify.block_statistics import BLOCKS_MIN, Copies, Indices
from inertiad.identify.fit import Estimate
from inertiad.robot import systematic
from inertiad.robot.configuration import platform_size
from inertiad.robot.description import Robot
from inertiad.run.reader import Recording

STILL: Final = 0.05
"""sigma: a shorter way left to the solution is none"""
FALLS_TO: Final = 0.8
"""of the residual force: what another model must leave to be believed"""
CLOSE: Final = 0.8
"""of the best candidate's fall of the cost: a runner-up that is named beside it"""
FAR: Final = 4.0
"""prior sigmas beyond which a sensor's error is more than its data sheet allows"""
NAMED_MOST: Final = 3
"""corrections named one by one"""
WIDER: Final = 1.5
"""factor on a sigma that is worth a word"""
MISFIT: Final = 0.03
"""residual force over the weight: a hundred times a good set of sensors"""
ABSURD: Final = 0.25
"""residual force over the weight: nothing is explained"""
TENSION_SHARE: Final = 0.05
"""residual of the force sensors over their mean tension"""
IMPOSSIBLE: Final = (2.0, 9.0)
"""squared distance in sigmas to a body that can exist: care, stop"""
MOST: Final = 0.8
"""share of a variance that one kind of sensor error must have to be called confounded"""
CONFOUNDED_WIDE: Final = (0.02, 0.02, 0.1)
"""sigma of mass [of the mass], CoG [of the platform's size], inertia [of the largest moment] from which confounding is
named"""

SEPARATES: Final = {
    "force_offset": "tare the force sensors with no tension in any cable (inertiactl calibrate --tare FILE.csv), or "
    "add poses high and low, where the cables' elevation differs",
    "force_gain": "add a run with a known weight: inertiactl calibrate ROBOT RUN RUN2 --payload RUN2=KG",
    "attitude_bias": "turn the platform by 180 deg about its vertical axis, or tilt it both ways about each axis",
    "imu_alignment": "tilt the platform both ways about each axis; measure how the IMU sits on it",
    "acc_bias": "add poses tilted both ways about each axis, or calibrate the accelerometer in six positions",
    "geometry": "measure anchors and attachments better, and state it in [std] geometry",
    "world_yaw": "add motion along both horizontal axes, or align the tracker's frame with the IMU's",
    "position_delay": "add faster motion; synchronise the tracker with the bus",
    "force_delay": "add faster motion; give the force frames their device time",
    "force_lowpass": "add faster motion; switch the amplifiers' filters to a higher frequency",
    "gyro_bias": "let the platform rest for some seconds in every run",
    "attitude_delay": "turn the platform faster; give the attitude frames their device time",
    "imu_position": "turn the platform faster about all axes; measure where the IMU sits on it",
    "tracker_target": "turn the platform further about all axes; measure where the tracker's target sits on it",
    "acc_scale": "calibrate the accelerometer in six positions",
    "gyro_scale": "turn the platform further about all axes",
    "friction": "move every cable in both directions; measure the pulleys' friction and state it in robot.toml",
    "external_force": "move the hose's mount for one run, or fix the hose so that it pulls on nothing and run again",
    "external_stiffness": "move the platform further along every axis",
    "cable_inertia": "move slower; state the cables' mass per length and their drums in robot.toml",
}


def _weight(robot: Robot, result: dict[str, Any]) -> float:
    """N: of the heaviest body found."""
    return float(max(body["mass"] for body in result["body"])) * max(robot.gravity, 1.0)


def residual(result: dict[str, Any]) -> tuple[float, float]:
    """N and N m: root mean square over all windows."""
    n = np.array([f["n_windows"] for f in result["fit"]], dtype=float)
    square = np.array([np.square(f["rms"]) for f in result["fit"]])
    mean = n @ square / max(n.sum(), 1.0)
    return float(np.sqrt(mean[:3].sum())), float(np.sqrt(mean[3:].sum()))


def _far(result: dict[str, Any], robot: Robot) -> list[tuple[str, float, float]]:
    """Name, value in its unit and size in prior sigmas of every sensor error, the furthest first."""
    labels, n_theta = systematic.names(robot.n_cables), 10 * len(result["body"])
    found = []
    for k, i in enumerate(result["free"]):
        prior = float(result["prior_std"][n_theta + k])
        if prior > 1e-11:
            found.append((labels[i], float(result["xi"][i]), abs(float(result["xi"][i])) / prior))
    return sorted(found, key=lambda entry: -entry[2])


def _name_of_unknown(robot: Robot, result: dict[str, Any], at: int) -> str:
    """In words: a parameter of the body, a sensor's error, or an attachment."""
    free, n_theta = list(result["free"]), 10 * len(result["body"])
    if at < n_theta:
        return ("mass", *3 * ("first moment",), *6 * ("inertia",))[at % 10]
    if at < n_theta + len(free):
        return systematic.names(robot.n_cables)[free[at - n_theta]].replace("_", " ")
    return f"attachment of cable {(at - n_theta - len(free)) // 3 + 1}"


def _convergence(robot: Robot, result: dict[str, Any]) -> Iterator[Finding]:
    if result["converged"]:
        return
    far, slowest = _far(result, robot), _name_of_unknown(robot, result, int(result["slowest"]))
    evidence = {"steps": result["n_steps"], "next_step_sigmas": float(result["last_step"]), "slowest": slowest}
    evidence["noise_change"] = float(result["weight_change"])
    if far:
        evidence |= {"parameter": far[0][0], "value": far[0][1], "prior_sigmas": far[0][2]}
    if result["refused"] and far:
        says = (
            f"the fit does not converge: it drives {far[0][0].replace('_', ' ')} to {far[0][1]:.3g}, {far[0][2]:.0f} "
            "times the standard deviation stated for it, where the equations no longer hold"
        )
        name = "parameter_at_bound"
    elif result["last_step"] < STILL:
        says = (
            f"the fit does not converge: the noise that its residuals show still changes by "
            f"{100 * result['weight_change']:.2g} % from step to step; the motion determines too few of the unknowns"
        )
        name = "not_converged"
    else:
        says = (
            f"the fit does not converge: after {result['n_steps']} steps {slowest} still has "
            f"{result['last_step']:.2g} sigma to go"
        )
        name = "not_converged"
    do = "use none of these numbers; correct robot.toml, or record faster and wider motion with an IMU"
    yield Finding(name, "stop", says, do, evidence)


def _causes_of_misfit(robot: Robot, result: dict[str, Any]) -> list[str]:
    """Why the residuals are no noise, in words; empty: they may be."""
    force, weight = residual(result)[0], _weight(robot, result)
    correlation = fit.correlation_time(result)
    spread, causes = result.get("spread"), []
    if force > MISFIT * weight:
        causes.append(f"it is {100 * force / weight:.2g} % of the weight")
    if fit.is_correlated(robot, result):
        causes.append(f"it stays correlated over {correlation:.2g} s")
    if spread is not None and spread.n_blocks >= BLOCKS_MIN and _wider(result) > WIDER:
        causes.append(f"its stretches scatter {_wider(result):.2g} times more than their sigma")
    return causes


def has_misfit(robot: Robot, result: dict[str, Any]) -> bool:
    """Residuals that are no noise."""
    return bool(_causes_of_misfit(robot, result))


def _wider(result: dict[str, Any]) -> float:
    """Largest factor on the sigma of mass and CoG."""
    spread = result.get("spread")
    return 1.0 if spread is None else float(max(np.max(ratio[:4]) for ratio in spread.body))


def _misfit(robot: Robot, result: dict[str, Any]) -> Iterator[Finding]:
    force, moment = residual(result)
    weight = _weight(robot, result)
    correlation = fit.correlation_time(result)
    evidence = {
        "residual_force": force,
        "residual_moment": moment,
        "share_of_weight": force / max(weight, 1e-9),
        "correlation_time": correlation,
        "sigma_factor": min(_wider(result), 1e3),
    }
    do = "look at geometry, friction of the pulleys and the force sensors; report RUN shows the residual over time"
    if force > ABSURD * weight:
        says = f"the residual is {force:.3g} N of {weight:.3g} N weight: the data do not follow from this robot.toml"
        yield Finding("misfit", "stop", says, do, evidence)
        return
    causes = _causes_of_misfit(robot, result)
    if causes:
        says = f"unexplained misfit of {force:.3g} N and {moment:.3g} N m: {', '.join(causes)}; sigma is widened for it"
        yield Finding("misfit", "care", says, do, evidence)


def _few_blocks(result: dict[str, Any]) -> Iterator[Finding]:
    spread = result.get("spread")
    if spread is None or spread.n_blocks >= BLOCKS_MIN:
        return
    correlation = fit.correlation_time(result)
    says = (
        f"only {spread.n_blocks} independent stretches of data: residuals last for {correlation:.2g} s; sigma "
        "is taken wider, at most the prior's"
    )
    do = f"record for {np.ceil(BLOCKS_MIN * max(correlation, 1.0)):.0f} s or more"
    yield Finding("short_record", "care", says, do, {"blocks": spread.n_blocks, "correlation_time": correlation})


def _corrections(robot: Robot, result: dict[str, Any]) -> Iterator[Finding]:
    units = [(g.factor, g.unit) for g in systematic.groups(robot.n_cables) for _ in range(g.n)]
    labels = systematic.names(robot.n_cables)
    for name, value, far in _far(result, robot)[:NAMED_MOST]:
        if far > FAR:
            factor, unit = units[labels.index(name)]
            says = f"{name} = {factor * value:.3g} {unit}: {far:.0f} times the standard deviation stated for it"
            do = "look at this sensor, or correct its [std] in robot.toml; inertiactl calibrate keeps what was found"
            evidence = {"parameter": name, "value": value, "prior_sigmas": far}
            yield Finding("correction_beyond_prior", "care", says, do, evidence)


def has_symptom(robot: Robot, result: dict[str, Any]) -> bool:
    """The runs do not follow from robot.toml: no solution, residuals that are no noise, or errors beyond the stated."""
    is_far = any(far > FAR for _, _, far in _far(result, robot))
    return is_far or not result["converged"] or has_misfit(robot, result)


def _forces(config: Any, result: dict[str, Any], recordings: list[Recording], group: list[int]) -> Iterator[Finding]:
    estimates = [fit.of_batch("joint", result, g) for g in range(len(result["body"]))]
    squares = [
        np.square(fit.validate(config, estimates[g], run).tension_typical)
        for g, run in zip(group, recordings, strict=True)
    ]
    residual = np.sqrt(np.mean(squares, axis=0))
    tension = float(np.mean([np.abs(run.rows.f).mean() for run in recordings]))
    worst = int(residual.argmax())
    share = float(np.sqrt(np.mean(residual**2))) / max(tension, 1e-9)
    if share < TENSION_SHARE:
        return
    says = (
        f"the force sensors agree only to {share * tension:.3g} N, {100 * share:.2g} % of the mean {tension:.3g} N; "
        f"cable {worst + 1} is worst with {residual[worst]:.3g} N"
    )
    do = f"check zero and gain of force sensor {worst + 1}, friction of its pulley, and the cables' wiring"
    evidence = {"residual": residual.tolist(), "mean_tension": tension, "share": share}
    yield Finding("forces_disagree", "care", says, do, evidence)


def _inconsistent(distance: float) -> Iterator[Finding]:
    if distance <= IMPOSSIBLE[0]:
        return
    severity: Severity = "stop" if distance > IMPOSSIBLE[1] else "care"
    says = (
        "the estimate is not physically consistent; the nearest consistent body is shown, "
        f"{np.sqrt(distance):.1f} sigma away"
    )
    do = "more excitation, or look for a mistake in geometry and sensor axes"
    yield Finding("impossible_body", severity, says, do, {"distance": distance})


def _unseen(names: list[str]) -> Finding:
    return Finding(
        "poorly_observable",
        "care",
        f"poorly observable in this motion: {', '.join(names)}; the sigma is more than half of the prior's",
        "turn the platform faster about all axes: inertiactl excite ROBOT -o excite.csv plans such a motion",
        {"parameters": names},
    )


def _possible(result: dict[str, Any]) -> Iterator[Finding]:
    for body in result["body"]:
        if not body["consistent"]:
            yield from _inconsistent(float(body["distance"]))


def _observability(result: dict[str, Any]) -> Iterator[Finding]:
    unseen = sorted({i for body in result["body"] for i in range(10) if not body["observable"][i]})
    if unseen:
        yield _unseen([NAMES[i] for i in unseen])


def kinds_of_unknowns(robot: Robot, result: dict[str, Any], group: int = 0) -> dict[str, Indices]:
    """Where the body and each kind of sensor error are among the unknowns."""
    free, n_theta = list(result["free"]), 10 * len(result["body"])
    found = {"body": np.arange(10 * group, 10 * group + 10)}
    for kind in systematic.groups(robot.n_cables):
        at = [n_theta + free.index(i) for i in range(kind.first, kind.first + kind.n) if i in free]
        if not at:
            continue
        found[kind.name] = np.array(at, dtype=np.intp)
    found["geometry"] = np.arange(n_theta + len(free), len(result["prior_std"]))
    return found


def shares(robot: Robot, result: dict[str, Any], group: int = 0) -> dict[str, Array]:
    """By kind of sensor error: part [10] of the variance of mass, CoG, inertia that would go if it were known."""
    P = np.array(result["covariance"])
    E = block_statistics.by_body(robot, np.array(result["body"][group]["theta_possible"]))
    part = slice(10 * group, 10 * group + 10)
    variance = np.diag(E @ P[part, part] @ E.T)
    found = {}
    for name, at in kinds_of_unknowns(robot, result, group).items():
        if name == "body":
            continue
        cross = E @ P[part, at]
        known = np.einsum("ij,jk,ik->i", cross, np.linalg.pinv(P[np.ix_(at, at)]), cross) if len(at) else np.zeros(10)
        found[name] = np.asarray(known / variance)
    return found


def _confounded(robot: Robot, result: dict[str, Any]) -> Iterator[Finding]:
    if not len(result["free"]):
        return
    body = result["body"][0]
    std = np.array(fit.of_batch("joint", result).body.std)
    unit = np.array([body["mass"], platform_size(robot), max(*body["inertia_cog"][:3], 1e-9)])
    share = shares(robot, result)
    for k, part in enumerate((slice(0, 1), slice(1, 4), slice(4, 10))):
        i = part.start + int(np.argmax(np.where(np.array(body["observable"])[part], std[part], 0.0)))
        if std[i] < CONFOUNDED_WIDE[k] * abs(unit[k]) or not body["observable"][i]:
            continue
        kind = max(share, key=lambda name: share[name][i])
        if share[kind][i] > MOST:
            yield Finding(
                "confounded",
                "care",
                f"{NAMES[i]} and {kind.replace('_', ' ')} cannot be separated by this motion: "
                f"{100 * share[kind][i]:.0f} % of the variance of {NAMES[i]} comes from it",
                SEPARATES[kind],
                {"parameter": NAMES[i], "with": kind, "correlation": float(np.sqrt(min(share[kind][i], 1.0)))},
            )


def widening_of(result: dict[str, Any]) -> float:
    """The spread between blocks over what the weights say, one number for all unknowns."""
    spread = result.get("spread")
    if spread is None:
        return 1.0
    return float(min(np.sqrt(np.mean([np.mean(np.square(ratio)) for ratio in spread.body])), 1e3))


def _is_alone_better(config: Any, result: dict[str, Any], recordings: list[Recording]) -> bool:
    """Runs fitted one by one leave much less: what they share now is not the same for all."""
    alone = []
    for run in recordings:
        try:
            alone.append(fit.batch(config, [run])["fit"][0])
        except InputError:
            return False
    return residual({"fit": alone})[0] < FALLS_TO * residual(result)[0]


def _bodies_apart(config: Any, recordings: list[Recording]) -> Iterator[Finding]:
    """Where no body fits all runs: the run whose own body is farthest from those of the others, if that is far."""
    try:
        results = [fit.batch(config, [run]) for run in recordings]
    except InputError:
        return
    if not all(result["converged"] for result in results):
        return
    alone = [result["body"][0] for result in results]
    value = np.array([[b["mass"], *b["cog"], *b["inertia_cog"]] for b in alone])
    variance = np.array([block_statistics.standard_deviations(b) for b in alone]) ** 2
    difference, far = np.zeros_like(value), np.zeros_like(value)
    for r in range(len(recordings)):
        weight = np.delete(1.0 / variance, r, axis=0)
        difference[r] = value[r] - (np.delete(value, r, axis=0) * weight).sum(axis=0) / weight.sum(axis=0)
        far[r] = np.abs(difference[r]) / np.sqrt(variance[r] + 1.0 / weight.sum(axis=0))
    r, i = divmod(int(np.argmax(far)), far.shape[1])
    if far[r, i] < FAR:
        return
    name, mass = recordings[r].path.name, float(difference[r, 0])
    evidence = {"run": name, "kind": "body", "mass_difference": mass, "sigmas": float(far[r, i])}
    shown = f"mass differs by {mass:+.3g} kg"
    if i > 0:
        shown += f", {NAMES[i]} by {difference[r, i]:+.3g} {UNITS[i]}"
    says = f"{name} saw a different body than the other runs: {shown}"
    yield Finding("runs_disagree", "stop", says, FIT_APART, evidence)


def _runs(
    robot: Robot, config: Any, result: dict[str, Any], recordings: list[Recording], group: list[int]
) -> Iterator[Finding]:
    """Runs whose body or sensors are others than those of all the rest.

    A large difference widens the residuals it is judged by; fits of single runs show it then.
    """
    if len(recordings) < 2:
        return
    if not result["converged"]:
        yield from _bodies_apart(config, recordings)
        return
    of, widening = block_statistics.blocks(result, 0.0), widening_of(result)
    is_alone_better = has_misfit(robot, result) and _is_alone_better(config, result, recordings)
    tried = []
    for r, run in enumerate(recordings):
        if any(g == group[r] for q, g in enumerate(group) if q != r):
            found = block_statistics.other_in_run(of, r, kinds_of_unknowns(robot, result, group[r]))
            sure = [block_statistics.is_significant(c, len(recordings) * len(found), widening) for c in found.values()]
            tried.append((max(c.fall - c.size for c in found.values()), any(sure), run.path.name, found, group[r]))
    tried.sort(key=lambda entry: -entry[0])
    named = [entry for entry in tried if entry[1]] or (tried[:1] if is_alone_better else [])
    for _, _, name, found, g in named[:1] if len(recordings) == 2 else named:  # of two, each differs from the other
        yield _other_run(name, found, result, robot, g)


FIT_APART: Final = (
    "fit runs of one body together, others apart; with a known added weight use inertiactl calibrate --payload"
)


def _other_run(name: str, tried: dict[str, Copies], result: dict[str, Any], robot: Robot, group: int) -> Finding:
    order = sorted(tried, key=lambda kind: tried[kind].size - tried[kind].fall)
    kind = order[0]
    is_close = len(order) > 1 and tried[order[1]].fall > CLOSE * tried[kind].fall
    second = f"; or another {order[1].replace('_', ' ')}" if is_close else ""
    evidence: dict[str, Any] = {
        "run": name,
        "kind": kind,
        "chi_squared": tried[kind].fall,
        "unknowns": tried[kind].size,
    }
    if len(order) > 1:
        evidence |= {"runner_up": order[1], "runner_up_chi_squared": tried[order[1]].fall}
    if kind == "body":
        mass = float(tried[kind].step[0] * result["prior_std"][10 * group])
        evidence["mass_difference"] = mass
        says = f"{name} saw a different body than the other runs: mass differs by {mass:+.3g} kg{second}"
        return Finding("runs_disagree", "stop", says, FIT_APART, evidence)
    says = f"{name} disagrees with the other runs; another {kind.replace('_', ' ')} in it explains most{second}"
    do = "fit the runs apart and compare; look whether that sensor was restarted, moved or warmed up between them"
    return Finding("runs_disagree", "care", says, do, evidence)


def of_result(
    robot: Robot, config: Any, result: dict[str, Any], recordings: list[Recording], group: list[int] | None = None
) -> list[Finding]:
    """All findings about a batch result, the worst first. group: of each run's body; default: one body."""
    bodies = [0] * len(recordings) if group is None else group
    found = [*_convergence(robot, result)]
    if not found:
        found += [*_misfit(robot, result), *_few_blocks(result), *_forces(config, result, recordings, bodies)]
    found += [*_runs(robot, config, result, recordings, bodies)]  # may be why there is no convergence
    found += [*_possible(result), *_corrections(robot, result)]
    found += [*_observability(result), *_confounded(robot, result)]
    return found


def of_estimate(estimate: Estimate) -> list[Finding]:
    """Findings about a result that another method than joint gave, the worst first."""
    found = []
    if not estimate.is_converged:
        found.append(Finding("not_converged", "stop", "the fit does not converge", "look for a mistake in robot.toml"))
    unseen = [name for name, seen in zip(NAMES, estimate.observable, strict=True) if not seen]
    if unseen:
        found.append(_unseen(unseen))
    if not estimate.consistent:
        found += _inconsistent(estimate.distance)
    return found
