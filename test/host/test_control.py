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
from conftest import COGIRO, TOP, lock_step_lines, minimal_toml
from typer.testing import CliRunner

import inertiad_core
from inertiad.base.error import InputError
from inertiad.cli.main import app
from inertiad.control import closed_loop, experiment, request
from inertiad.control.closed_loop import SOURCES, Trial
from inertiad.control.daemon import Daemon
from inertiad.model.payload import Payload
from inertiad.report import control as reporter
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
def test_payload_announced_before_the_noise_is_learnt_is_followed(tmp_path):
    found = trial(tmp_path, "live", payload=("70@4",), announce=(request.AS_IT_IS,))
    wanted, _ = request.request_of(ROBOT, words(tmp_path, payload=("70@4",), announce=(request.AS_IT_IS,)))
    trace = closed_loop.control(replace(found, announced=wanted.announced))
    without = closed_loop.control(replace(found, arm="nominal"))
    assert any(text == "inertiad: expect: the announced payload is taken" for _, text in trace.told), trace.told
    assert rms_from(trace, 4.5) < rms_from(without, 4.5) / 8.0
    assert trace.theta[-1, 0] == pytest.approx(161.0, rel=0.01)


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
    trace = closed_loop.control(replace(trial(tmp_path, "live"), kill_at=8.0))
    texts = [text for _, text in trace.told]
    assert "the daemon was killed" in texts and "the daemon was started again" in texts
    assert f"controller: {SOURCES[2]}" in texts
    assert np.abs(trace.theta[trace.t > 8.0][:, 0] - 161.0).max() < 3.0
    assert trace.error[trace.t > 8.0].max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "said"),
    [
        ("blind", "position: lost, silent for"),
        ("stuck", "stuck at"),
        ("silent", "force: lost, silent for"),
        ("late", "although its frames arrive"),
    ],
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


@pytest.mark.parametrize(
    ("kill", "arms", "said"),
    [
        (-5.0, "live", "--kill -5: allowed: 0 to 10, s"),
        (float("nan"), "live", "--kill nan: allowed"),
        (10.0, "live", "--kill 10: allowed"),
        (5.0, "nominal,oracle", "no arm has a daemon"),
    ],
)
def test_kill_that_kills_nothing_is_refused(kill, arms, said, tmp_path):
    with pytest.raises(InputError, match=said):
        request.request_of(ROBOT, words(tmp_path, kill=kill, arms=arms))


@pytest.mark.parametrize(
    ("announce", "changed", "said"),
    [
        (("payload",), {"payload": ()}, "--announce payload: there is none; pass --payload as well"),
        (("40@10",), {}, '--announce "40@10": allowed: 0 to 10, s'),
        (("40@5", "20@3.5"), {}, "--announce: payloads at 3.5 and 5 s: allowed: 2 s apart or more"),
        (("payload",), {"payload": ("9@5", "9@6.9")}, "payloads at 5 and 6.9 s: allowed: 2 s apart"),
        (("payload",), {"arms": "nominal,oracle"}, "--announce: no arm has a daemon; add live to --arms"),
    ],
)
def test_announcement_that_nobody_hears_is_refused(announce, changed, said, tmp_path):
    with pytest.raises(InputError, match=said):
        request.request_of(ROBOT, words(tmp_path, announce=announce, **changed))


# ---- measuring and judging, without a motion -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A motion of 10 s with a payload at 5 s."""
    return request.request_of(ROBOT, words(tmp_path_factory.mktemp("run")))[0].run


def outcome(
    run, arm, before=0.001, transient=0.002, late=0.003, seed=0, cut=(), end=10.0, bandwidth=3.0
) -> experiment.Outcome:
    """A trial with these position errors, m, in its phases; commands are cut off at some times [s]."""
    t = np.arange(0.0, end, 0.01)
    last = max(p.time for p in run.payloads)
    error = np.where(t < 5.0, before, np.where(t < last + 3.0, transient, late))
    zero = np.zeros(len(t))
    is_cut = np.isin(np.round(t, 2), cut)
    trace = closed_loop.Trace(t, error, zero, zero, zero, zero, np.zeros((len(t), 10)), zero, is_cut)
    return experiment.measured(Trial(replace(run, seed=seed), arm, bandwidth), trace)


def severities(*outcomes: experiment.Outcome) -> dict[str, str]:
    return {f.name: f.severity for f in reporter.judge(list(outcomes)).findings}


def test_median_over_seeds_is_written(run):
    outcomes = [outcome(run, "live", *(3 * [error]), seed=k) for k, error in enumerate((0.001, 0.002, 0.009))]
    assert experiment.document(outcomes)["live"]["3"]["late_rms_mm"] == pytest.approx(2.0)


def test_traces_are_kept_for_the_first_seed_only(run):
    wanted = experiment.Request(run, ("nominal", "oracle"), (3.0,), (4, 5), is_pose_measured=False)
    outcomes = experiment.run_all(wanted, lambda text: None)
    assert [(o.seed, o.trace is not None) for o in outcomes] == [(4, True), (4, True), (5, False), (5, False)]
    drawn = reporter.page_of(wanted, outcomes, "").sections[0].blocks[-1]
    assert drawn.caption.startswith("Seed 4") and [len(panel.marks) for panel in drawn.panels] == [2, 2, 2]


def test_phases_are_told_apart(run):
    found = outcome(run, "live").phases
    assert [found[name].rms_mm for name in experiment.PHASES] == pytest.approx([1.0, 2.0, 3.0])


def test_a_second_payload_is_no_late_error(run):
    again = replace(run.payloads[0], time=6.0)
    found = outcome(replace(run, payloads=(*run.payloads, again)), "live").phases
    assert found["transient"].rms_mm == pytest.approx(2.0) and found["late"].rms_mm == pytest.approx(3.0)
    assert experiment.HEAD[4] == "transient rms"  # from the first contact to 3 s after the last


def test_motion_that_ends_in_the_transient_has_no_late_error(run, tmp_path):
    outcomes = [outcome(run, arm, end=7.0) for arm in ("nominal", "live")]
    experiment.write_json(tmp_path / "control.json", outcomes)
    assert json.loads((tmp_path / "control.json").read_text())["live"]["3"]["late_rms_mm"] is None
    (finding,) = (f for f in reporter.judge(outcomes).findings if f.name == "late")
    assert finding.severity == "care" and "ends before the transient" in finding.says
    assert "gain" not in severities(*outcomes)


def test_live_parameters_that_are_better_are_good(run):
    found = severities(outcome(run, "nominal", late=0.03), outcome(run, "live"))
    assert found == {"gain": "good", "worse": "good", "hand_over": "good"}


def test_live_parameters_that_are_worse_stop(run):
    outcomes = [outcome(run, "nominal"), outcome(run, "live", late=0.005)]
    verdict = reporter.judge(outcomes)
    assert verdict.severity == "stop"
    says = {f.name: (f.severity, f.says) for f in verdict.findings}
    assert says["worse"][0] == "stop" and "seed 0: max 5.00 against 3.00 mm" in says["worse"][1]
    assert says["gain"][0] == "care" and says["gain"][1].endswith("1.7 times more")


def test_commands_that_are_cut_off_stop(run):
    outcomes = [outcome(run, "nominal"), outcome(run, "oracle", cut=(6.5, 7.0))]
    verdict = reporter.judge(outcomes)
    (finding,) = verdict.findings
    assert (verdict.severity, finding.name) == ("stop", "cut_off")
    assert "2 of 1000 commands are cut off" in finding.says and "oracle" in finding.says
    assert "the first at t = 6.50 s" in finding.says
    assert [row[-1] for row in experiment.rows(outcomes)] == ["0", "2"] and experiment.HEAD[-1] == "cut off"


def test_platform_that_is_far_away_stops(run):
    assert severities(outcome(run, "nominal", late=0.25)) == {"lost": "stop"}
    assert severities(outcome(run, "nominal", late=0.15)) == {}


def test_hand_over_that_is_not_measured_has_an_empty_cell(run):
    outcomes = [outcome(run, arm) for arm in ("adaptive", "nominal")]
    adaptive, nominal = experiment.rows(outcomes)
    at = experiment.HEAD.index("hand-over")
    assert (adaptive[at], nominal[at]) == ("", "0.00 %")


@pytest.mark.parametrize(("late", "code"), [(0.05, 1), (0.001, 0)])
def test_command_ends_with_1_where_live_parameters_are_worse(late, code, run, tmp_path, monkeypatch):
    outcomes = [outcome(run, "nominal"), outcome(run, "live", late=late)]
    monkeypatch.setattr(experiment, "run_all", lambda request, progress: outcomes)
    words_ = [
        "control",
        str(ROBOT),
        "--trajectory",
        motion(tmp_path, 3.0),
        "--bandwidth",
        "3",
        "-o",
        str(tmp_path / "out"),
    ]
    done = CliRunner().invoke(app, [*words_, "--arms", "nominal,live", "--figures", str(tmp_path / "drawn")])
    assert done.exit_code == code, done.output
    assert ("live parameters are worse than nominal ones" in done.output) == (code == 1)
    assert "late rms" in (tmp_path / "out/control.html").read_text()
    assert {path.name for path in (tmp_path / "drawn").iterdir()} == {
        f"{key}.{ending}" for key in ("time-3", "phases") for ending in ("png", "pdf")
    }


@pytest.mark.parametrize("command", [["control", str(ROBOT)], ["demo"]])
def test_folder_cannot_be_stdout(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    program = [sys.executable, "-m", "inertiad", *command, "-o", "-"]
    done = subprocess.run(program, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "several files do not go to stdout" in done.stderr
    assert not list(tmp_path.iterdir())


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
    daemon, lines = Daemon(config, tmp_path / "said"), lock_step_lines(run)
    answered = [e for k in range(0, len(lines), 37) for e in daemon.ask(lines[k : k + 37])]
    daemon.kill()
    estimates = [e.data for e in answered if e.channel == "ESTIMATE"]
    assert len(estimates) > 10
    assert estimates == replayed


def follow(url: str, robot: Path) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, TOP / "host/examples/follow.py", url, robot]
    return subprocess.run(program, capture_output=True, text=True, timeout=60)


@pytest.fixture
def log(tmp_path):
    """URL of a log of eight estimates of a body of 100 kg."""
    file = lcm.EventLog(str(tmp_path / "run.lcmlog"), "w")
    for k in range(8):
        e = estimate_t()
        e.sequence, e.t_ns, e.verdict = k, (k + 1) * 10**8, estimate_t.GOOD
        e.theta = [100.0, 0.0, 0.0, 0.0, 50.0, 50.0, 50.0, 0.0, 0.0, 0.0]
        e.covariance, e.observable = np.diag(np.full(10, 1e-3)).tolist(), [True] * 10
        file.write_event(k, "INERTIAD_ESTIMATE", e.encode())
    file.close()
    return f"file://{tmp_path}/run.lcmlog?speed=0"


def test_python_example_follows_estimates(log):
    done = follow(log, ROBOT)
    assert done.returncode == 0, done.stderr
    rows = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    assert rows[0, 2] == pytest.approx(161.058 * 9.81, rel=1e-3)
    assert rows[-1, 2] < rows[0, 2]
    assert "more of them in a row are needed" in done.stderr


def test_python_example_gives_what_the_one_in_cpp_gives(log, tmp_path):
    """Also where robot.toml has no body, and another gravity."""
    robot = tmp_path / "robot.toml"
    robot.write_text("gravity = 9.7\n" + minimal_toml(8))
    subprocess.run([sys.executable, "-m", "inertiad", "compile", robot, "-o", tmp_path / "robot.cfg"], check=True)
    program = [TOP / "build/bin/examples/follow", log, tmp_path / "robot.cfg"]
    other = subprocess.run(program, capture_output=True, text=True, timeout=60, check=True)
    ours, theirs = (
        np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
        for done in (follow(log, robot), other)
    )
    assert ours.shape == (8, 6)
    np.testing.assert_allclose(ours, theirs, atol=2e-6)


@pytest.mark.parametrize(
    ("url", "robot"), [("file:///nowhere.lcmlog", ROBOT), ("none-such://", ROBOT), ("", "no.toml")]
)
def test_python_example_that_cannot_begin_says_so_in_one_line(url, robot):
    done = follow(url, robot)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1), done.stderr
