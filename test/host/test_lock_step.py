# SPDX-License-Identifier: Apache-2.0
"""The daemon driven step by step through stdin and stdout: what it refuses, how it ends, what it does once a second."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import COGIRO, TOP, lock_step_lines

from inertiad.control.daemon import Daemon
from inertiad.run import lcmlog
from inertiad_lcm import command_t, event_t, expectation_t


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("config") / "robot.cfg"
    command = [sys.executable, "-m", "inertiad", "compile", COGIRO / "robot.toml", "-o", path]
    subprocess.run(command, check=True, capture_output=True)
    return path


def command_of(config: Path) -> list[str]:
    return [str(TOP / "build/bin/inertiad"), "--config", str(config), "--lock-step"]


def test_stdout_that_takes_nothing_ends_it_with_1(config: Path) -> None:
    with open("/dev/full", "wb") as full:
        done = subprocess.run(command_of(config), input=b"answer\n" * 3, stdout=full, stderr=-1, timeout=60)
    assert done.returncode == 1
    assert "stdout: No space left on device; nobody takes the answers" in done.stderr.decode()


def test_reader_that_goes_away_ends_it_with_1(config: Path) -> None:
    process = subprocess.Popen(command_of(config), stdin=-1, stdout=-1, stderr=-1)
    assert process.stdin is not None and process.stdout is not None and process.stderr is not None
    process.stdout.close()
    process.stdin.write(b"answer\n")
    process.stdin.flush()
    assert process.wait(60) == 1
    assert "stdout: Broken pipe" in process.stderr.read().decode()
    process.stdin.close()
    process.stderr.close()


def test_closed_stdout_ends_it_with_1(config: Path) -> None:
    line = " ".join(command_of(config)) + " >&-"
    done = subprocess.run(["sh", "-c", line], input=b"answer\n", capture_output=True, timeout=60)
    assert (done.returncode, "nobody takes the answers" in done.stderr.decode()) == (1, True)


def test_stdin_that_cannot_be_read_is_refused(config: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        ["sh", "-c", " ".join(command_of(config)) + f" < {tmp_path}"], capture_output=True, timeout=60
    )
    assert (done.returncode, done.stderr.decode()) == (2, "inertiad: --lock-step: Is a directory\n")


def test_bytes_that_are_no_lines_end_it_with_1_and_are_counted(config: Path) -> None:
    noise = np.random.default_rng(5).integers(0, 256, 300_000, np.uint8).tobytes()
    done = subprocess.run(command_of(config), input=noise, capture_output=True, timeout=60)
    assert done.returncode == 1
    said = done.stderr.decode()
    assert "lines is of use" in said and "lock_step.bad_frame" in said


def test_lines_of_no_use_among_others_are_counted_by_cause(config: Path) -> None:
    text = "position 1 0 0 " + "1" * 300 + "\nposition -5 1 2 3\nposition 1000 1 2\nanswer\n"
    text += "(1.0) vcan0 123#00\nnonsense\nposition 1000 0 0 2"
    done = subprocess.run(command_of(config), input=text.encode(), capture_output=True, timeout=60)
    assert done.returncode == 0
    said = done.stderr.decode()
    for reason in ("is too long", 'is no "position T_NS X Y Z"', "no host time", "can0 to can7", "does not begin with"):
        assert reason in said
    assert done.stdout.count(b"INERTIAD_ANSWER") == 1
    counted = dict(line.split()[1:3] for line in said.splitlines() if line.startswith("inertiad: lock_step."))
    assert counted == {
        **{"lock_step.lines": "7", "lock_step.answers": "1", "lock_step.too_long": "1", "lock_step.cut": "1"},
        **{"lock_step.bad_position": "1", "lock_step.bad_time": "1", "lock_step.bad_frame": "2"},
    }


@pytest.mark.parametrize("option", ["--lcm", "--bus", "--tracker"])
def test_options_that_it_stands_for_are_refused(option: str, config: Path) -> None:
    done = subprocess.run([*command_of(config), option, "none"], input=b"", capture_output=True, timeout=60)
    assert done.returncode == 2
    assert "stands for --bus, --tracker and --lcm, which cannot be given as well" in done.stderr.decode()


def test_states_of_the_bus_are_told_in_every_second(config: Path, tmp_path: Path) -> None:
    """At most ten a second of data time."""
    warning, active = "20000004#0004000000000000", "20000004#0040000000000000"
    rows = [f"({1.0 + 0.05 * k:.6f}) can0 {active if k % 2 else warning}\n" for k in range(60)]
    daemon = Daemon(config, tmp_path / "said")
    events = [lcmlog.decode(event_t, e, "") for e in daemon.ask(rows) if e.channel == "EVENT"]
    daemon.kill()
    at = np.array([e.t_ns for e in events if e.source == "stdin"]) * 1e-9
    assert [int(np.sum((at >= t) & (at < t + 1.0))) for t in (1.0, 2.0, 3.0)] == [10, 10, 10]


def test_payload_is_expected_from_a_second_past_to_ten_minutes_ahead(config: Path, tmp_path: Path) -> None:
    rows = ["(60.000000) can0 123#00\n", *(announcement(1, 60.0, ahead) for ahead in (-1.1, 600.1, -0.9, 599.9))]
    daemon = Daemon(config, tmp_path / "said")
    got = [lcmlog.decode(event_t, e, "") for e in daemon.ask(rows) if e.channel == "EVENT"]
    daemon.kill()
    assert [e.kind for e in got] == [event_t.REFUSED, event_t.REFUSED, event_t.DONE, event_t.DONE]
    assert got[0].text == "expect refused: t_ns: -1.100 s from now; allowed: -1 to 600 s"
    assert got[2].text == "expect done: 20 +- 0.4 kg in -0.900 s"
    assert got[3].text == "expect done: 20 +- 0.4 kg in 599.900 s; replaces the payload announced before"


def announcement(sequence: int, t: float, ahead: float) -> str:
    """A line that announces 20 kg at t [s], in contact so many seconds later."""
    expected, command = expectation_t(), command_t()
    expected.t_ns, expected.mass, expected.mass_std = round(1e9 * (t + ahead)), 20.0, 0.4
    command.kind, command.text, command.sender, command.sequence = command_t.EXPECT, "", 1, sequence
    command.t_ns, command.config = round(1e9 * t), expected.encode()
    command.n_config = len(command.config)
    return f"command {command.encode().hex()}\n"


@pytest.mark.slow
def test_checkpoint_is_written_by_data_time(config: Path, tmp_path: Path) -> None:
    run, state = tmp_path / "run", tmp_path / "state.bin"
    moved = ["--trajectory", "hold", "-o", run]
    subprocess.run([sys.executable, "-m", "inertiad", "simulate", COGIRO / "robot.toml", *moved], check=True)
    options = [*command_of(config), "--checkpoint", str(state)]
    with (tmp_path / "answers").open("wb") as answers:  # a pipe would fill up
        process = subprocess.Popen(options, stdin=subprocess.PIPE, stdout=answers, stderr=subprocess.DEVNULL)
    assert process.stdin is not None
    process.stdin.write("".join(lock_step_lines(run)).encode())
    process.stdin.flush()
    for _ in range(600):  # the file is written by a thread of its own
        if state.exists():
            break
        time.sleep(0.1)
    was_there = state.exists() and process.poll() is None
    process.kill()
    process.communicate()
    assert was_there
