# SPDX-License-Identifier: Apache-2.0
"""The control loop with the daemon in it: lock-step, arms, gate, faults, contract of control.json."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import lcm
import numpy as np
import pytest
from conftest import COGIRO, TOP

import inertiad_core
from inertiad.base.error import InputError
from inertiad.control import closed_loop, experiment, request
from inertiad.control.closed_loop import SOURCES, Trial
from inertiad.control.daemon import Daemon
from inertiad.model.payload import Payload
from inertiad.run import lcmlog
from inertiad_lcm import estimate_t

ROBOT = COGIRO / "robot.toml"
THETA = np.array([70.0, 0.0, 0.0, 7.0, 1.0, 1.0, 0.5, 0.0, 0.0, 0.0])
MOTION = "t,x,y,z,roll,pitch,yaw\n"


def motion(folder: Path, seconds: float) -> str:
    """A pose CSV that moves in all six coordinates from rest to rest."""
    t = np.linspace(0.0, seconds, int(10 * seconds) + 1)
    share = np.clip(np.minimum(t, seconds - t), 0.0, 1.0)
    grow = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    columns = [grow * a * np.sin(2.0 * np.pi * f * t) for a, f in ((0.3, 0.31), (0.3, 0.23), (0.2, 0.41))]
    columns += [grow * a * np.sin(2.0 * np.pi * f * t) for a, f in ((0.12, 0.47), (0.12, 0.37), (0.15, 0.29))]
    columns[2] = columns[2] + 2.0
    path = folder / f"motion{seconds:g}.csv"
    rows = "\n".join(",".join(f"{x:.6f}" for x in row) for row in zip(t, *columns, strict=True))
    path.write_text(f"{MOTION}{rows}\n")
    return str(path)


def words(folder: Path, **changed: object) -> request.Arguments:
    chosen = {"mass": 91.0, "trajectory": motion(folder, 10.0), "payload": ("70@5",)}
    return request.Arguments(**(chosen | changed))  # type: ignore[arg-type]


def trial(folder: Path, arm: str, **changed: object) -> Trial:
    wanted, _ = request.request_of(ROBOT, words(folder, **changed))
    return Trial(wanted.run, arm, 1.5)


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    return closed_loop.control(trial(tmp_path_factory.mktemp("live"), "live"))


@pytest.fixture(scope="module")
def nominal(tmp_path_factory):
    return closed_loop.control(trial(tmp_path_factory.mktemp("nominal"), "nominal"))


def late(trace: closed_loop.Trace) -> float:
    """m, rms from 3 s after the contact on."""
    return float(np.sqrt(np.mean(trace.error[trace.t >= 8.0] ** 2)))


@pytest.mark.slow
def test_live_parameters_find_the_payload_and_reduce_the_error(live, nominal):
    assert late(live) < late(nominal) / 8.0
    assert live.theta[-1, 0] == pytest.approx(161.0, rel=0.01)
    assert nominal.theta[-1, 0] == 91.0
    assert live.tension_step.max() < 0.02 * 4900.0
    assert live.beyond.max() <= nominal.beyond.max()
    assert any("detect: payload changed" in text for _, text in live.told)
    assert any(text == f"controller: {SOURCES[1]}" for _, text in live.told)


def announced(folder: Path, words_: str, payload: str = "70@12") -> closed_loop.Trace:
    """A live trial of 16 s with a payload; what the daemon is told of it."""
    folder.mkdir()
    found = trial(folder, "live", trajectory=motion(folder, 16.0), payload=(payload,))
    wanted, _ = request.request_of(
        ROBOT, words(folder, trajectory=motion(folder, 16.0), payload=(payload,), announce=(words_,) if words_ else ())
    )
    return closed_loop.control(replace(found, announced=wanted.announced))


def rms_from(trace: closed_loop.Trace, t: float) -> float:
    return float(np.sqrt(np.mean(trace.error[trace.t >= t] ** 2)))


@pytest.mark.slow
def test_announced_payload_shortens_the_transient_and_a_wrong_one_does_no_harm(tmp_path):
    without = announced(tmp_path / "none", "")
    right = announced(tmp_path / "right", request.AS_IT_IS)
    wrong = announced(tmp_path / "wrong", "140@12")
    assert any(text == "inertiad: expect: the announced payload is taken" for _, text in right.told), right.told
    assert rms_from(right, 12.5) < rms_from(without, 12.5) / 8.0
    assert right.error.max() < without.error.max() / 4.0
    assert right.tension_step.max() < 0.02 * 4900.0
    assert not any("is taken" in text and "another mass" not in text for _, text in wrong.told), wrong.told
    assert rms_from(wrong, 12.0) < rms_from(without, 12.0)
    assert wrong.error.max() < without.error.max()


@pytest.mark.slow
def test_announced_payload_that_never_comes_changes_no_bit(live, tmp_path):
    again = closed_loop.control(replace(trial(tmp_path, "live"), announced=(Payload(9.5, 0.5 * THETA),)))
    assert again.error.tobytes() == live.error.tobytes()
    assert any("expect done" in text for _, text in again.told), again.told


@pytest.mark.slow
def test_same_trial_gives_the_same_bits(live, tmp_path):
    again = closed_loop.control(trial(tmp_path, "live"))
    for name in ("error", "turn", "theta", "tension_norm", "source"):
        assert getattr(again, name).tobytes() == getattr(live, name).tobytes()
    assert again.told == live.told


@pytest.mark.slow
def test_exact_parameters_are_best_and_adapted_ones_learn(nominal, tmp_path):
    exact = closed_loop.control(trial(tmp_path, "oracle"))
    adapted = closed_loop.control(trial(tmp_path, "adaptive"))
    assert late(exact) < late(nominal) / 20.0
    assert late(adapted) < late(nominal)
    assert adapted.theta[-1, 0] == pytest.approx(161.0, rel=0.2)
    assert all(inertiad_core.is_consistent(theta) for theta in adapted.theta[::500])


@pytest.mark.slow
def test_daemon_that_dies_leaves_the_last_good_parameters(tmp_path):
    trace = closed_loop.control(replace(trial(tmp_path, "live"), kill_at=8.0, stale_at=7.8))
    texts = [text for _, text in trace.told]
    assert "the daemon was killed" in texts and "the daemon was started again" in texts
    assert any("not newer than the last estimate" in text for text in texts)
    assert f"controller: {SOURCES[2]}" in texts
    assert np.abs(trace.theta[trace.t > 8.0][:, 0] - 161.0).max() < 3.0
    assert trace.error[trace.t > 8.0].max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "said"), [("blind", "position: lost"), ("stuck", "stuck at"), ("silent", "force: lost")]
)
def test_lost_sensors_are_told_and_the_loop_goes_on(preset, said, tmp_path):
    trace = closed_loop.control(trial(tmp_path, "live", faults=preset))
    assert any(said in text for _, text in trace.told), trace.told
    assert trace.t[-1] == pytest.approx(10.0, abs=0.01)
    assert trace.error.max() < 0.2


@pytest.mark.slow
def test_command_writes_the_contract(tmp_path):
    arguments = ["--mass", "91", "--payload", "70@1", "--trajectory", motion(tmp_path, 3.0), "--bandwidth", "1.5,3"]
    command = [
        sys.executable,
        "-m",
        "inertiad",
        "control",
        ROBOT,
        *arguments,
        "--faults",
        "paper",
        "-o",
        tmp_path / "out",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=TOP)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads((tmp_path / "out/control.json").read_text())
    assert list(found) == ["nominal", "live", "oracle", "adaptive"]
    for values in found.values():
        assert list(values) == ["1.5", "3"]
        assert all(list(v) == ["rms_mm", "max_mm", "rms_deg", "late_rms_mm"] for v in values.values())
    assert found["oracle"]["1.5"]["rms_mm"] < found["nominal"]["1.5"]["rms_mm"]
    assert "later rms" in done.stdout
    assert 'id="figure-phases"' in (tmp_path / "out/control.html").read_text()


def test_measured_pose_is_late_and_noisy(tmp_path):
    still = {"trajectory": motion(tmp_path, 3.0), "payload": ()}
    true = closed_loop.control(trial(tmp_path, "oracle", **still))
    seen = closed_loop.control(replace(trial(tmp_path, "oracle", **still), is_pose_measured=True))
    assert true.error.max() < seen.error.max() < 0.05


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"arms": "nominal,exakt"}, "--arms"),
        ({"bandwidth": "1.5,fast"}, "--bandwidth"),
        ({"bandwidth": "nan"}, "--bandwidth"),
        ({"plant": "exact"}, "--plant"),
    ],
)
def test_bad_words_are_refused(changed, said, tmp_path):
    with pytest.raises(InputError, match=said):
        request.request_of(ROBOT, words(tmp_path, **changed))


def test_median_over_seeds_is_written(tmp_path):
    wanted, _ = request.request_of(ROBOT, words(tmp_path))
    t = np.array([0.0, 6.0, 9.0])
    outcomes = []
    for seed, error in enumerate((0.001, 0.002, 0.009)):
        zero = np.zeros(3)
        trace = closed_loop.Trace(t, np.full(3, error), zero, zero, zero, zero, np.zeros((3, 10)), zero, 0)
        outcomes.append(experiment.measured(Trial(replace(wanted.run, seed=seed), "live", 3.0), trace))
    assert experiment.document(outcomes)["live"]["3"]["late_rms_mm"] == pytest.approx(2.0)


def items(run: Path) -> list[str]:
    """Lines for the daemon in lock-step, in the order in which a replay of the run uses them."""
    lines = [(round(1e6 * float(line[1:18])), 0, line) for line in (run / "can.log").read_text().splitlines()]
    for line in (run / "tracker.csv").read_text().splitlines()[1:]:
        t, x, y, z = line.split(",")[:4]
        t_ns = round(1e6 * float(t)) * 1000
        lines.append((t_ns // 1000, 1, f"position {t_ns} {x} {y} {z}"))
    return [f"{line}\n" for _, _, line in sorted(lines, key=lambda item: item[:2])]


@pytest.mark.slow
def test_lock_step_gives_the_estimates_of_a_replay(tmp_path):
    inertiactl = [sys.executable, "-m", "inertiad"]
    run, config = tmp_path / "run", tmp_path / "run/robot.cfg"
    moved = ["--trajectory", motion(tmp_path, 3.0), "-o", run]
    subprocess.run([*inertiactl, "simulate", ROBOT, *moved], check=True, capture_output=True)
    subprocess.run([*inertiactl, "compile", run / "robot.toml", "-o", config], check=True, capture_output=True)
    files = ["--bus", f"file:{run / 'can.log'}", "--tracker", f"file:{run / 'tracker.csv'}", "--lcm", "none"]
    log = tmp_path / "log"
    command = [TOP / "build/bin/inertiad", "--config", config, *files, "--record", log]
    subprocess.run(command, check=True, capture_output=True)
    replayed = [e.data for e in lcmlog.read(log) if e.channel == "INERTIAD_ESTIMATE"][:-1]  # the last: at the end
    daemon, lines = Daemon(config, tmp_path / "said"), items(run)
    answered = [e for k in range(0, len(lines), 37) for e in daemon.ask(lines[k : k + 37])]
    daemon.kill()
    estimates = [e.data for e in answered if e.channel == "ESTIMATE"]
    assert len(estimates) > 10
    assert estimates == replayed


def test_lock_step_reports_lines_that_are_none(tmp_path):
    config = tmp_path / "robot.cfg"
    command = [sys.executable, "-m", "inertiad", "compile", ROBOT, "-o", config]
    subprocess.run(command, check=True, capture_output=True)
    daemon = [TOP / "build/bin/inertiad", "--config", config, "--lock-step"]
    bad = "position 1 2\n(1.0) vcan0 123#00\nnonsense\nanswer\n"
    done = subprocess.run(daemon, input=bad.encode(), capture_output=True, timeout=60)
    said = done.stderr.decode()
    for text in ('is no "position T_NS X Y Z"', "none of can0 to can7", "does not begin with"):
        assert text in said
    assert done.stdout.count(b"INERTIAD_ANSWER") == 1
    done = subprocess.run([*daemon, "--bus", "file:-"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "--lock-step: stands for --bus and --tracker" in done.stderr


def test_python_example_follows_estimates(tmp_path):
    log = lcm.EventLog(str(tmp_path / "run.lcmlog"), "w")
    for k in range(8):
        e = estimate_t()
        e.sequence, e.t_ns, e.verdict = k, (k + 1) * 10**8, estimate_t.GOOD
        e.theta = [100.0, 0.0, 0.0, 0.0, 50.0, 50.0, 50.0, 0.0, 0.0, 0.0]
        e.covariance, e.observable = np.diag(np.full(10, 1e-3)).tolist(), [True] * 10
        log.write_event(k, "INERTIAD_ESTIMATE", e.encode())
    log.close()
    program = [sys.executable, TOP / "host/examples/follow.py", f"file://{tmp_path}/run.lcmlog?speed=0", ROBOT]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    rows = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    assert rows[0, 2] == pytest.approx(161.058 * 9.81, rel=1e-3)
    assert rows[-1, 2] < rows[0, 2]
    assert "more of them in a row are needed" in done.stderr
