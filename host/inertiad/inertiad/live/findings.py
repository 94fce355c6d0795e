# SPDX-License-Identifier: Apache-2.0
"""State of a running daemon as findings: what is not as it should be now, from ESTIMATE, HEALTH and silence."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from inertiad.base.body import NAMES
from inertiad.base.counters import is_loss
from inertiad.base.finding import Finding, Severity, ordered
from inertiad.live.incoming import plain
from inertiad_lcm import bus_t, estimate_t, health_t

SILENT_AFTER: Final = 2.0
"""s without any message from which the daemon counts as silent"""
AGE_CARE: Final = 0.2
"""s since a sensor's last sample"""
AGE_STOP: Final = 0.5
NIS_CARE: Final = 16.8
"""99 % of chi-squared with 6 degrees of freedom"""
SENSORS: Final = ("IMU", "force", "position")
CONDITIONS: Final = {bus_t.ACTIVE: "active", bus_t.WARNING: "warning", bus_t.PASSIVE: "passive", bus_t.OFF: "bus-off"}
NAMED_MOST: Final = 4
"""counters named in one finding"""


@dataclass(frozen=True)
class State:
    """The newest messages of a daemon."""

    estimate: estimate_t | None
    health: health_t | None
    earlier: health_t | None
    """a HEALTH some seconds before, for counters that grow"""
    silence: float
    """s since the last message"""


def counters(health: health_t | None) -> dict[str, int]:
    """The counters of a HEALTH by name."""
    return {} if health is None else {plain(c.name, 60): c.value for c in health.counter}


def grown(state: State) -> dict[str, int]:
    """By how much counters that stay 0 on a good run grew since the earlier HEALTH."""
    now, then = counters(state.health), counters(state.earlier)
    if state.earlier is None:
        return {}
    return {name: n - then.get(name, 0) for name, n in now.items() if is_loss(name) and n > then.get(name, 0)}


def _of_silence(state: State) -> Iterator[Finding]:
    if state.silence > SILENT_AFTER:
        says = f"no message for {state.silence:.0f} s"
        yield Finding("silent", "stop", says, "see whether inertiad runs, and on which LCM network and prefix")


def _of_sensors(health: health_t) -> Iterator[Finding]:
    for sensor, age in zip(SENSORS, health.age, strict=True):
        if age < 0.0:
            yield Finding(f"{sensor}.none", "care", f"{sensor}: no sample yet", "check its cable and its messages' IDs")
        elif age > AGE_CARE:
            severity: Severity = "stop" if age > AGE_STOP else "care"
            says = f"{sensor}: last sample {age:.2g} s ago"
            yield Finding(f"{sensor}.late", severity, says, "check the sensor", {"age": age})


def _of_buses(health: health_t) -> Iterator[Finding]:
    for bus in health.bus:
        name = plain(bus.name, 40)
        if not bus.up:
            yield Finding("bus.down", "stop", f"{name}: interface down", f"ip link set {name} up")
        elif bus.condition != bus_t.ACTIVE:
            severity: Severity = "stop" if bus.condition == bus_t.OFF else "care"
            says = f"{name}: {CONDITIONS.get(bus.condition, 'unknown state')}"
            yield Finding("bus.errors", severity, says, "check bit rate, termination and wiring")


def _of_counters(state: State) -> Iterator[Finding]:
    new = grown(state)
    if new:
        most = sorted(new.items(), key=lambda item: -item[1])
        named = ", ".join(f"{name} {n}" for name, n in most[:NAMED_MOST])
        more = f" and {len(most) - NAMED_MOST} more" if len(most) > NAMED_MOST else ""
        yield Finding("losses", "care", f"lost or refused just now: {named}{more}", "see the counters", dict(most))


def _of_estimate(estimate: estimate_t) -> Iterator[Finding]:
    if estimate.verdict == estimate_t.STOP:
        yield Finding("verdict.stop", "stop", "the daemon says stop: do not use the estimate", "see the events")
    if estimate.verdict == estimate_t.CARE:
        yield Finding("verdict.care", "care", "the daemon says care: the estimate is less sure", "see the events")
    if not estimate.consistent:
        says = "the data's parameters are no body that can exist; the nearest one is shown"
        yield Finding("consistency", "care", says, "move more, check force sensors and geometry")
    if estimate.nis > NIS_CARE:
        says = (
            f"NIS {estimate.nis:.0f}: the last window fits badly; 6 is expected, {NIS_CARE} passed once in 100 windows"
        )
        yield Finding("nis", "care", says, "look for a push, a slack cable or a force sensor", {"nis": estimate.nis})
    unseen = [name for name, seen in zip(NAMES, estimate.observable, strict=True) if not seen]
    mass, cog = estimate.mass_std / estimate.mass if estimate.mass > 0.0 else 1.0, max(estimate.cog_std)
    says = (
        f"mass to {100.0 * mass:.2g} %, CoG to {1e3 * cog:.2g} mm, inertia to {max(estimate.inertia_cog_std):.2g} kg m²"
    )
    yield Finding("accuracy", "good", f"{says} (one σ)", "", {"mass_share": mass, "cog_std": cog})
    if unseen:
        says = f"not observable yet: {', '.join(unseen)}"
        yield Finding("observability", "care", says, "tilt and turn the platform about every axis")


def of(state: State) -> list[Finding]:
    """Findings of a state, the worst first."""
    found = [*_of_silence(state), *_of_counters(state)]
    if state.estimate is None:
        found.append(Finding("estimate.none", "care", "no estimate yet", "wait for 3 s of motion with every sensor"))
    else:
        found += _of_estimate(state.estimate)
    if state.health is not None:
        found += [*_of_sensors(state.health), *_of_buses(state.health)]
        if state.health.frozen:
            found.append(Finding("frozen", "care", "frozen: nothing is learnt", "inertiactl command resume"))
    return ordered(found)
