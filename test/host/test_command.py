# SPDX-License-Identifier: Apache-2.0
"""Commands to a running daemon: each is carried out, recorded and answered with what changed or why not."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import COGIRO, ISOLATED, TOP

from inertiad.check import daemon_run, estimate_checks
from inertiad.check.case import Case
from inertiad.check.daemon_run import Published
from inertiad.robot import configuration, description
from inertiad.run import lcmlog
from inertiad_lcm import command_t, estimate_t, event_t, order_item_t, robot_config_t

pytestmark = pytest.mark.slow

DAEMON = TOP / "build/bin/inertiad"
SETTINGS = "[estimator]\nestimate_rate = 20\nmemory = 600\n"


def compiled(toml: Path) -> None:
    configuration.write(toml.with_suffix(".cfg"), description.load(toml), str(toml))


def simulated(folder: Path, *more: str) -> Path:
    command = [TOP / "build/bin/inertiactl", "simulate", COGIRO / "robot.toml", "-o", folder, "--seed", "11", *more]
    subprocess.run([*map(str, command), "--rate", "100"], check=True, capture_output=True)
    compiled(folder / "robot.toml")
    return folder


@pytest.fixture(scope="module")
def moving(tmp_path_factory) -> Path:
    """A run of the paper's motion, with three more configurations."""
    folder = simulated(tmp_path_factory.mktemp("moving"))
    text = (folder / "robot.toml").read_text()
    (folder / "settings.toml").write_text(text + SETTINGS)
    (folder / "other.toml").write_text(re.sub(r"^mass = .*", "mass = 150.0", text, flags=re.M))
    for name in ("settings", "other"):
        compiled(folder / f"{name}.toml")
    damaged = bytearray((folder / "robot.cfg").read_bytes())
    damaged[100] ^= 1
    (folder / "damaged.cfg").write_bytes(damaged)
    return folder


@pytest.fixture(scope="module")
def resting(tmp_path_factory) -> Path:
    return simulated(tmp_path_factory.mktemp("resting"), "--trajectory", "hold", "--duration", "8")


def session(run: Path, steps: list[str], *more: object) -> tuple[list[dict], dict]:
    """Answers and events in order, and the daemon's end."""
    daemon = [DAEMON, "-v", "--config", run / "robot.cfg", "--bus", f"file:{run}/can.log?speed=1"]
    arguments = [*daemon, "--tracker", f"file:{run}/tracker.csv", *more, "--", *steps]
    command = [*ISOLATED, sys.executable, TOP / "test/host/session.py", *arguments]
    result = subprocess.run([str(a) for a in command], capture_output=True, text=True, timeout=90)
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert lines and "status" in lines[-1], result.stderr
    assert lines[-1]["status"] == 0
    return lines[:-1], lines[-1]


def answers(lines: list[dict]) -> list[tuple[bool, str]]:
    return [(line["done"], line["answer"]) for line in lines if "answer" in line]


@pytest.mark.slow
def test_every_command_is_answered_recorded_and_counted(moving, tmp_path):
    record = tmp_path / "run.lcmlog"
    steps = ["2", "freeze", "0.3", "freeze", "resume", "reset", "tare", "mark=load on", f"configure={moving}/robot.cfg"]
    steps += [f"configure={moving}/settings.cfg", "0.7", f"configure={moving}/damaged.cfg"]
    steps += [f"configure={moving}/other.cfg"]
    lines, end = session(moving, steps, "--record", record)
    expected = [
        (True, r"freeze done: frozen after \d+ windows"),
        (True, r"freeze done: frozen already, \d+ windows"),
        (True, r"resume done: learning after \d+ windows"),
        (True, r"reset done: \d+ windows discarded; starting from the prior"),
        (False, r"tare refused: moving: the attitude changes"),
        (True, r"mark done: load on"),
        (True, r"configure done: the same configuration, nothing changed"),
        (True, r"configure done: memory, estimate_rate changed; the learnt state stays"),
        (False, r"configure refused: damaged or not a compiled configuration \(CRC differs\).*"),
        (True, r"configure done: .*prior_theta.* changed; starting from the prior"),
    ]
    got = answers(lines)
    assert [done for done, _ in got] == [done for done, _ in expected]
    for (_, text), (_, pattern) in zip(got, expected, strict=True):
        assert re.fullmatch(pattern, text), text
    n = end["counters"]
    assert (n["command.done"], n["command.refused"], n["lcm.commands"]) == (8, 2, 10)
    assert n["window.windows"] == n["rls.updates"] + n["estimate.frozen"] + n["detect.held"]
    lost = ("overrun",)
    assert n["align.imu.samples"] == n["align.rows"] + sum(n[f"align.{cause}"] for cause in lost)
    events = list(lcmlog.read(record))
    recorded = [event_t.decode(e.data) for e in events if e.channel == "INERTIAD_EVENT"]
    assert [e.text for e in recorded if e.kind != event_t.NEWS] == [text for _, text in got]
    assert [command_t.decode(e.data).text for e in events if e.channel == "INERTIAD_COMMAND"].count("load on") == 1
    configs = [robot_config_t.decode(e.data) for e in events if e.channel == "INERTIAD_CONFIG"]
    assert [c.estimate_rate for c in configs] == [50.0, 20.0, 50.0]


def test_record_repeats_every_estimate_whatever_was_commanded(resting, tmp_path):
    record = tmp_path / "run.lcmlog"
    session(resting, ["1", "freeze", "0.5", "resume", "2.2", "tare", "0.5", "reset", "1"], "--record", record)
    case = recorded_case(resting, record)
    kinds = [item.kind for message in case.published.messages["ORDER"] for item in message.item if item.kind]
    assert kinds == [command_t.FREEZE, command_t.RESUME, command_t.TARE, command_t.RESET]
    checks = {c.name: c for c in estimate_checks.check_recomputation(case, estimate_checks.recompute(case))}
    assert checks["rows recomputed"].passed and checks["estimates"].passed, checks


@pytest.mark.slow
def test_expected_payload_is_answered_counted_and_repeated(moving, tmp_path):
    record = tmp_path / "run.lcmlog"
    steps = ["2", "expect=20@1@0,0,0.3", "expect=-5@0@0,0,0", "0.5", "reset", "0.5"]
    lines, end = session(moving, steps, "--record", record)
    got = answers(lines)
    assert [done for done, _ in got] == [True, True, True]
    assert re.fullmatch(r"expect done: 20 \+- 0\.4 kg in \d\.\d+ s", got[0][1]), got[0]
    assert (end["counters"]["command.done"], end["counters"]["command.refused"]) == (3, 0)
    case = recorded_case(moving, record)
    items = [item for message in case.published.messages["ORDER"] for item in message.item if item.kind]
    assert [item.kind for item in items] == [*[command_t.EXPECT] * 2 * order_item_t.EXPECT_ITEMS, command_t.RESET]
    assert items[0].value == pytest.approx((20.0, 0.4, 0.0))
    checks = {c.name: c for c in estimate_checks.check_recomputation(case, estimate_checks.recompute(case))}
    assert checks["rows recomputed"].passed and checks["estimates"].passed, checks


def recorded_case(run: Path, record: Path) -> Case:
    published = Published()
    for event in lcmlog.read(record):
        channel = event.channel.replace("INERTIAD_", daemon_run.PREFIX)
        published.add(lcmlog.Event(event.number, event.t_us, channel, event.data))
    data, raw = (run / "robot.cfg").read_bytes(), published.frames(1)
    robot = description.load(run / "robot.toml")
    return Case(robot, data, data, raw, raw, published, [], [], run)


def test_frozen_estimate_stays_and_resumed_one_goes_on(moving, tmp_path):
    record = tmp_path / "run.lcmlog"
    session(moving, ["4", "freeze", "1", "resume", "1"], "--record", record)  # 4 s: the attitude settles in 3
    log = list(lcmlog.read(record))
    at = [i for i, e in enumerate(log) if e.channel == "INERTIAD_COMMAND"]
    windows = [[], [], []]
    for i, event in enumerate(log):
        if event.channel == "INERTIAD_ESTIMATE":
            windows[sum(i > k for k in at)].append(estimate_t.decode(event.data).n_windows)
    assert len(windows[1]) > 30 and len(set(windows[1])) == 1
    assert windows[2][-1] > windows[1][-1] + 5
    assert 0 <= windows[1][0] - windows[0][-1] <= 1


@pytest.mark.slow
def test_tare_at_rest_finds_the_bias_and_survives_a_restart(resting, tmp_path):
    record, state = tmp_path / "run.lcmlog", tmp_path / "state"
    lines, _ = session(resting, ["3.5", "tare", "0.5"], "--record", record, "--checkpoint", state)
    [(done, text)] = answers(lines)
    assert done, text
    found = [float(x) for x in re.findall(r"-?\d\.\d{6}", text)][:3]
    truth = json.loads((resting / "truth.json").read_text())["gyro_bias"]
    assert found == pytest.approx(truth, abs=1e-4) and max(map(abs, truth)) > 3e-4
    configs = [robot_config_t.decode(e.data) for e in lcmlog.read(record) if e.channel == "INERTIAD_CONFIG"]
    assert list(configs[-1].gyro_bias) == pytest.approx(found, abs=1e-6)
    assert list(configs[0].gyro_bias) != list(configs[-1].gyro_bias)
    session(resting, ["0.5"], "--record", tmp_path / "next.lcmlog", "--checkpoint", state)
    first = next(lcmlog.read(tmp_path / "next.lcmlog"))
    assert list(robot_config_t.decode(first.data).gyro_bias) == list(configs[-1].gyro_bias)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["melt"], 'command "melt": allowed: freeze, resume, reset, tare, configure, mark, expect'),
        (["expect"], "command expect: PAYLOAD is missing"),
        (["expect", "70@2"], 'command expect: "70@2": allowed: KG@S@x,y,z or FILE@S'),
        (["expect", "0@2@0,0,0"], "mass = 0: allowed: above 0 to take up, below 0 to set down, kg"),
        (["expect", "70@-1@0,0,0"], "time = -1: allowed: 0 and more, s"),
        (["expect", "70@601@0,0,0"], "time = 601: allowed: 0 to 600, s from now"),
        (["expect", "70@1e300@0,0,0"], "time = 1e+300: allowed: 0 to 600, s from now"),
        (["expect", "70@2@0,0,0", "--std", "1,-2,3"], '--std "1,-2,3": allowed: KG,M,KGM2, each 0 or more'),
        (["mark", "x", "--std", "1,2,3"], "command mark: --std is not wanted"),
        (["mark"], "command mark: TEXT is missing"),
        (["freeze", "now"], 'command freeze: "now" is not wanted'),
        (["configure", "nowhere.cfg"], "nowhere.cfg: No such file or directory"),
        (["mark", "x" * 201], "command mark: allowed: one line of at most 200 bytes"),
        (["freeze", "--lcm", "nonsense://"], "--lcm nonsense://: cannot open"),
        (["expect", "-5@2@0,0,0", "--lcm", "memq://", "--wait", "0.1"], "no answer on INERTIAD_EVENT within 0.1 s"),
        (["expect", "--lcm", "memq://", "--wait", "0.1", "--", "-5@2@0,0,0"], "no answer on INERTIAD_EVENT"),
        (["expect", "-5"], "No such option: -5"),
        (["freeze", "--lcm", "memq://", "--wait", "0.1"], "no answer on INERTIAD_EVENT within 0.1 s"),
    ],
)
def test_unusable_commands_are_one_line_and_exit_2(arguments, message):
    command = [sys.executable, "-m", "inertiad", "command", *arguments]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=TOP)
    assert result.returncode == 2 and result.stdout == ""
    assert len(result.stderr.splitlines()) == 1 and message in result.stderr


FORGERS = """
import secrets, struct, sys, time
from inertiad.base import channels
from inertiad.live import command, lcm_network
from inertiad_lcm import command_t, event_t

answers = []
link = lcm_network.connect(channels.DEFAULT_URL)


def event(kind, sender, sequence, text):
    e = event_t()
    e.kind, e.sender, e.command, e.source, e.text = kind, sender, sequence, "command", text
    return e.encode()


def on_command(_, data):
    "Everything but the answer, then the answer, which wants the screen."
    c = command_t.decode(data)
    right = event(event_t.DONE, c.sender, c.sequence, "done \\x1b[2J\\x9b31m[bold]\\u202e")
    for wrong in (b"", b"x", right[:-3], right[:40], right[:8] + secrets.token_bytes(200), bytes(8) + right[8:]):
        link.publish("INERTIAD_EVENT", wrong)
    for forged in (event(1, c.sender, 0, "forged"), event(1, c.sender ^ 1, c.sequence, "forged"),
                   event(7, c.sender, c.sequence, "forged")):
        link.publish("INERTIAD_EVENT", forged)
    link.publish("INERTIAD_EVENT", right)


link.subscribe("INERTIAD_COMMAND", on_command)
print("ready", flush=True)
end = time.monotonic() + 20
while time.monotonic() < end:
    link.handle_timeout(50)
"""


def test_client_survives_any_bytes_and_believes_no_forged_answer():
    script = f"""
{sys.executable} -c '{FORGERS.replace("'", '"')}' & forger=$!
sleep 2
{sys.executable} -m inertiad command freeze --wait 10; echo "status $?"
kill $forger
"""
    result = subprocess.run([*ISOLATED, "sh", "-c", script], capture_output=True, text=True, timeout=90, cwd=TOP)
    assert "status 0" in result.stdout and "Traceback" not in result.stderr, result.stderr
    [shown] = [line for line in result.stdout.splitlines() if line.startswith("done")]
    assert shown == "done \N{REPLACEMENT CHARACTER}[2J\N{REPLACEMENT CHARACTER}31m[bold]\N{REPLACEMENT CHARACTER}"


def test_client_prints_the_answer_and_exits_by_it(moving):
    script = f"""
{DAEMON} --config {moving}/robot.cfg --bus 'file:{moving}/can.log?speed=1' --tracker file:{moving}/tracker.csv &
sleep 1
{sys.executable} -m inertiad command freeze; echo $?
{sys.executable} -m inertiad command tare; echo $?
{sys.executable} -m inertiad command expect -5@2@0,0,0; echo $?
kill $!; wait $!
"""
    result = subprocess.run([*ISOLATED, "sh", "-c", script], capture_output=True, text=True, timeout=60, cwd=TOP)
    lines = result.stdout.splitlines()
    assert lines[0].startswith("freeze done: ") and lines[1] == "0", result.stderr
    assert lines[2].startswith("tare refused: ") and lines[3] == "1"
    assert lines[4].startswith("expect done: -5 +- 0.1 kg in ") and lines[5] == "0"
