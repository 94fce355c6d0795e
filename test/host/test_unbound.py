# SPDX-License-Identifier: Apache-2.0
"""The daemon on a log of another robot; the counters at its end."""

import json
import re
import subprocess

import pytest
from conftest import COGIRO, ISOLATED, TOP

from inertiad.robot import configuration, description

OTHER = "".join(f"({1 + k / 1000:.6f}) can0 {('7A1', '1ABCDEF0')[k % 2]}#0011223344556677\n" for k in range(100))


@pytest.fixture
def daemon(tmp_path):
    """Run the daemon on the text of a candump log."""
    config = tmp_path / "robot.cfg"
    configuration.write(config, description.load(COGIRO / "robot.toml"), "robot.toml")

    def run(text, *options):
        log = tmp_path / "can.log"
        log.write_text(text)
        tracker = tmp_path / "tracker.csv"
        tracker.write_text("t,x,y,z\n0.5,0,0,2\n0.6,0,0,2\n")
        command = [TOP / "build/bin/inertiad", "--config", config, "--bus", f"file:{log}", "--lcm", "none", *options]
        command += ["--tracker", f"file:{tracker}"]
        return subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=60)

    return run


def test_log_in_which_nothing_is_bound_is_refused_with_the_identifiers(daemon):
    done = daemon(OTHER)
    assert done.returncode == 1
    said = [line.removeprefix("inertiad: ") for line in done.stderr.splitlines() if line.startswith("inertiad: --bus")]
    assert said[0].startswith("--bus: no frame of the log belongs to a signal of ")
    received, expected = said[1].removeprefix("--bus: received ").split("; expected ")
    assert received == "7A1 on bus 0, 1ABCDEF0 on bus 0"
    ids = {f"{b.can_id:03X} on bus 0" for b in dbc_bindings()}
    assert set(expected.split(", ")) == ids


def dbc_bindings():
    from inertiad.robot import dbc

    return dbc.bind(description.load(COGIRO / "robot.toml"), "robot.toml")


def test_one_frame_that_is_bound_is_enough(daemon):
    known = next(iter(dbc_bindings()))
    frame = f"(0.500000) can0 {known.can_id:03X}#{'00' * known.message.length}\n"
    assert daemon(frame + OTHER).returncode == 0


def test_a_log_without_frames_is_no_wrong_log(daemon):
    assert daemon("").returncode == 0


@pytest.mark.parametrize("option", ["-v", "--verbose"])
def test_counters_of_zero_are_printed_on_request_only(daemon, option):
    def counters(done):
        rows = [line.removeprefix("inertiad: ").split() for line in done.stderr.splitlines()]
        return {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}

    short, long = counters(daemon(OTHER)), counters(daemon(OTHER, option))
    assert short["bus0.frames"] == short["decode.unknown_id"] == 100
    assert 0 not in short.values()
    assert {name: n for name, n in long.items() if n} == short
    assert len(long) > 60


def test_daemon_ends_with_ten_numbers_losses_and_verdict(inertiactl, tmp_path):
    log = TOP / "test/host/logs/estimate_v1"
    inertiactl("compile", log / "robot.toml", "-o", tmp_path / "robot.cfg")
    command = [TOP / "build/bin/inertiad", "--config", tmp_path / "robot.cfg", "--lcm", "none"]
    command += ["--bus", f"file:{log}/can.log", "--tracker", f"file:{log}/tracker.csv"]
    done = subprocess.run(
        [*command, "--estimate", tmp_path / "estimate.json"], capture_output=True, text=True, check=True
    )
    said = [line.removeprefix("inertiad: ") for line in done.stderr.splitlines()]
    found = json.loads((tmp_path / "estimate.json").read_text())
    first = next(k for k, line in enumerate(said) if line.startswith("result of "))
    values = [
        re.fullmatch(r"(.{5})  +(\S+) \+- (\S+) (m|kg|kg m2)(  \(.*\))?", line) for line in said[first + 1 : first + 11]
    ]
    wanted = [(found[key]["value"], found[key]["std"]) for key in ("mass", "cog", "inertia_cog")]
    numbers = [pair for v, s in wanted for pair in (zip(v, s, strict=True) if isinstance(v, list) else [(v, s)])]
    for match, (value, std) in zip(values, numbers, strict=True):
        assert match is not None
        assert float(match[3]) == pytest.approx(std, rel=0.06) and abs(float(match[2]) - value) < 0.06 * std
    assert said[first + 11].startswith("lost: ") and "unsettled" not in said[first + 11]
    assert said[first + 12] == {"good": "A good result"}.get(found["verdict"], said[first + 12])


def test_daemon_without_positions_says_that_none_came(inertiactl, tmp_path):
    log = TOP / "test/host/logs/estimate_v1"
    inertiactl("compile", log / "robot.toml", "-o", tmp_path / "robot.cfg")
    command = [*ISOLATED, TOP / "build/bin/inertiad", "--config", tmp_path / "robot.cfg"]
    done = subprocess.run([*command, "--bus", f"file:{log}/can.log"], capture_output=True, text=True)
    assert "position: no sample came; pass --tracker FILE" in done.stderr
    assert "imu: no sample came" not in done.stderr and "result of" not in done.stderr
