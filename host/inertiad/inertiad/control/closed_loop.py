# SPDX-License-Identifier: Apache-2.0
"""One motion in closed loop: plant and controller in C++, sensors and frames here, the daemon in its own process.

    plant -> sensors with faults -> CAN frames, positions -> inertiad -> ESTIMATE -> gate -> controller -> plant
The controller runs at its own rate and reads the gate at every instant; it looks for new estimates every POLL seconds.
"""

import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.table import Array
from inertiad.control.daemon import Daemon
from inertiad.control.online_sensors import OnlineSensors
from inertiad.model import expectation, forward_dynamics
from inertiad.model.inverse_dynamics import Mechanics, below_hint
from inertiad.model.payload import Payload
from inertiad.robot import configuration, description
from inertiad.robot.description import read_data
from inertiad.run import folder as run_folder
from inertiad.run import lcmlog
from inertiad.run.lcmlog import Event
from inertiad.simulate import simulator
from inertiad.simulate.simulator import START, Run
from inertiad_lcm import command_t, estimate_t, event_t

ARMS: Final = ("nominal", "live", "oracle", "adaptive")
"""where the controller's parameters come from; in the order of inertiad::Arm"""
SOURCES: Final = ("nominal parameters", "live parameters", "the last good parameters", "falling back to nominal")
"""in the order of ipe_gate_source_t"""
POLL: Final = 0.02
"""s between two looks for estimates: the period of ESTIMATE as configured by default"""
ANNOUNCED_BEFORE: Final = 1.0
"""s: from then on the daemon looks for the contact (announcement.h), so telling it earlier changes nothing"""
DOWN: Final = 1.0
"""s from the daemon's end to its restart, as systemd's RestartSec=1"""
OBSERVER_SHARE: Final = 1.0
"""rate of the measured pose's observer, of the controller's; the accelerometer carries the rest. At 3 the tracker
shakes the platform so that the daemon's tilt settles after 16 s instead of 1 (CoGiRo, modern, seed 0)"""


@dataclass(frozen=True)
class Trial:
    """A motion to be controlled."""

    run: Run
    """with the plant; its robot's [nominal] is the body that the controller knows"""
    arm: str
    bandwidth: float
    """Hz"""
    is_pose_measured: bool = False
    kill_at: float = np.inf
    """s, the daemon dies; it comes back DOWN later and has forgotten everything"""
    announced: tuple[Payload, ...] = ()
    """that the daemon is told of ANNOUNCED_BEFORE their contact; they need not be those that come"""


@dataclass
class Trace:
    """What happened; a row per control instant."""

    t: Array
    """s [K]"""
    error: Array
    """m [K], of P's position"""
    turn: Array
    """rad [K], of the attitude"""
    tension_norm: Array
    """N [K]"""
    tension_step: Array
    """N [K], greatest change of a tension by the change of parameters alone"""
    beyond: Array
    """N [K], by which the worst tension breaks a limit"""
    theta: Array
    """[K, 10], in use"""
    source: Array
    """[K], index of SOURCES"""
    is_cut: NDArray[np.bool_]
    """[K], the command is cut off at the limits of the tensions: it does not give the wrench"""
    offers: Counter[str] = field(default_factory=Counter)
    """estimates by what became of them"""
    told: list[tuple[float, str]] = field(default_factory=list)
    """s, what was said: events of the daemon, refusals, changes of the parameters' source"""


class _Mailbox:
    """The daemon's estimates on their way to the gate."""

    def __init__(self, trial: Trial, loop: Any, sensors: OnlineSensors, folder: Path) -> None:
        self._trial, self._loop, self._sensors = trial, loop, sensors
        config = folder / "robot.cfg"
        config.write_bytes(_compiled(trial.run, folder))
        self._daemon = Daemon(config, folder / "inertiad.log")
        self._last_reason = 0
        self._to_announce = sorted(trial.announced, key=lambda payload: payload.time)
        self.offers: Counter[str] = Counter()
        self.told: list[tuple[float, str]] = []

    def poll(self, t: float) -> None:
        """Hand over what has arrived until t [s], and offer what comes back."""
        now_ns = round(1e9 * (START + t))
        lines = self._sensors.lines(now_ns)
        is_down = self._trial.kill_at <= t < self._trial.kill_at + DOWN
        if is_down and self._daemon.is_running:
            self._daemon.kill()
            self.told.append((t, "the daemon was killed"))
        if is_down:
            return
        if not self._daemon.is_running:
            self._daemon.start()
            self.told.append((t, "the daemon was started again"))
        for event in self._daemon.ask([*lines, *self._announcements(t, now_ns)]):
            self._take(event, t, now_ns)

    def _announcements(self, t: float, now_ns: int) -> list[str]:
        """Lines of the commands that are due."""
        due = [payload for payload in self._to_announce if payload.time - ANNOUNCED_BEFORE <= t]
        self._to_announce = self._to_announce[len(due) :]
        found = []
        for number, payload in enumerate(due):
            command = command_t()
            command.kind, command.text, command.sender, command.sequence = command_t.EXPECT, "", 1, number
            command.t_ns = now_ns
            contact_ns = max(now_ns, round(1e9 * (START + payload.time)))
            command.config = expectation.message(payload.theta, contact_ns).encode()
            command.n_config = len(command.config)
            found.append(f"command {command.encode().hex()}\n")
        return found

    def _take(self, event: Event, t: float, now_ns: int) -> None:
        if event.channel == "EVENT":
            said = lcmlog.decode(event_t, event, "inertiad")
            self.told.append((t, f"inertiad: {said.source}: {said.text}"))
        elif event.channel == "ESTIMATE":
            estimate = lcmlog.decode(estimate_t, event, "inertiad")
            self._offer(estimate, t, now_ns)

    def _offer(self, e: estimate_t, t: float, now_ns: int) -> None:
        """Offer an estimate; a refusal for another reason than the one before is told."""
        covariance, seen = np.array(e.covariance), [bool(x) for x in e.observable]
        theta = np.array(e.theta)
        verdict, is_provisional = e.verdict, bool(e.provisional)
        reason = self._loop.offer(
            e.sequence, e.t_ns, e.n_changes, theta, covariance, seen, verdict, is_provisional, now_ns
        )
        text = inertiad_core.gate_reason(reason)
        self.offers[text] += 1
        if reason not in (0, self._last_reason):
            self.told.append((t, f"gate: estimate {e.sequence} is not used: {text}"))
        self._last_reason = reason

    def close(self) -> None:
        """End the daemon."""
        self._daemon.kill()


def _compiled(run: Run, folder: Path) -> bytes:
    """robot.cfg for the daemon: [nominal] is the body at the start, [std] the sensors' data sheet where it has none."""
    assert run.robot.nominal is not None
    data = {"std": simulator.data_sheet(run.level)} | read_data(run.robot_file)
    data |= {"nominal": run.robot.nominal.model_dump()}
    run_folder.write_robot(folder, run.robot, data, bitrate=None if run.level.bus_timing else 0.0)
    path = folder / "robot.toml"
    return configuration.compile_robot(description.load(path), str(path))


def _loop(trial: Trial, sensors: OnlineSensors) -> tuple[Any, float, int, Mechanics]:
    """The ControlLoop, its step of integration [s], steps per control, and the true robot, which must outlive it."""
    run = trial.run
    assert run.plant is not None and run.robot.nominal is not None
    plant = run.plant.model_copy(update={"control_hz": trial.bandwidth})
    mechanics = simulator.mechanics_of(run, sensors.drawn)
    believed = forward_dynamics.believed_by_controller(run.robot, str(run.robot_file), mechanics)
    step = forward_dynamics.step_of(mechanics, run.trajectory.at(np.zeros(1)), plant, run.rate)
    per_control = max(1, round(1.0 / (plant.control_rate * step)))
    wanted = run.trajectory.at(forward_dynamics.control_instants(run.trajectory, step, per_control))
    swing, n_cables = mechanics.swing, run.robot.n_cables
    tilt = np.zeros((2, n_cables)) if swing is None else swing.amplitude * np.sin(swing.phase.T)
    rate = 2.0 * np.pi * plant.control_hz
    loop = inertiad_core.ControlLoop(
        mechanics.config,
        believed.config,
        configuration.theta_of(mechanics.body),
        configuration.theta_of(run.robot.nominal),
        forward_dynamics.payload_rows(mechanics.payloads),
        p=np.ascontiguousarray(wanted.p),
        v=np.ascontiguousarray(wanted.v),
        a=np.ascontiguousarray(wanted.a),
        R=np.ascontiguousarray(wanted.R),
        omega=np.ascontiguousarray(wanted.omega),
        alpha=np.ascontiguousarray(wanted.alpha),
        tilt=np.ascontiguousarray(tilt),
        arm=ARMS.index(trial.arm),
        limits=inertiad_core.GateLimits(),
        start_ns=round(1e9 * START),
        sensors=sensors.pose_sensors(OBSERVER_SHARE * rate) if trial.is_pose_measured else None,
        step=step,
        steps_per_control=per_control,
        EA=plant.stiffness,
        damping_time=plant.damping_time,
        winch_rate=2.0 * np.pi * plant.winch_hz,
        control_rate=rate,
        swing_damping=plant.swing_damping,
        swings=plant.swings,
    )
    return loop, step, per_control, mechanics


def _advance(
    trial: Trial, loop: Any, sensors: OnlineSensors, step: float, per_control: int, mailbox: _Mailbox | None
) -> None:
    n = max(1, round(POLL / (per_control * step))) if mailbox else 1 << 30
    done = 0
    while True:
        is_on = loop.advance(n)
        if not is_on:
            return
        done += n
        if mailbox is not None:
            sensors.measure(loop, done * per_control, step)
            mailbox.poll(done * per_control * step)


def _trace(loop: Any, period: float, mailbox: _Mailbox | None) -> Trace:
    found = loop.trace()
    source = found["source"].astype(int)
    t = period * np.arange(len(source), dtype=np.float64)
    error: Array = np.asarray(np.sqrt(np.sum(found["e_p"] ** 2, axis=1)), dtype=np.float64)
    told = list(mailbox.told) if mailbox else []
    for k in np.flatnonzero(np.diff(source)) + 1:
        told.append((float(t[k]), f"controller: {SOURCES[source[k]]}"))
    return Trace(
        t,
        error,
        np.abs(found["e_R"]),
        found["tension_norm"],
        found["tension_step"],
        found["beyond"],
        found["theta"],
        source,
        found["is_cut"] > 0.0,
        mailbox.offers if mailbox else Counter(),
        sorted(told),
    )


def control(trial: Trial) -> Trace:
    """Run a trial. Same trial, same trace, bit for bit. InputError: it cannot start, or the motion is unstable."""
    if trial.run.robot.n_cables < 6:
        raise InputError(f"{trial.run.robot_file}: {trial.run.robot.n_cables} cables: control needs 6 or more")
    simulator.check_sensors(trial.run)
    sensors = OnlineSensors(trial.run)
    loop, step, per_control, mechanics = _loop(trial, sensors)
    with tempfile.TemporaryDirectory() as folder:
        mailbox = _Mailbox(trial, loop, sensors, Path(folder)) if trial.arm == "live" else None
        try:
            _advance(trial, loop, sensors, step, per_control, mailbox)
        except ValueError as error:
            height = float(trial.run.trajectory.at(np.zeros(1)).p[0, 2])
            where = f"{trial.arm} parameters at {trial.bandwidth:g} Hz, seed {trial.run.seed}"
            raise InputError(f"{where}: {error}{below_hint(mechanics.robot, height)}") from None
        finally:
            if mailbox is not None:
                mailbox.close()
    return _trace(loop, per_control * step, mailbox)
