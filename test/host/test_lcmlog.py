# SPDX-License-Identifier: Apache-2.0
"""LCM logs: damage is found by the checksums of daemon and recorder, and other programs read the log as before."""

import random
import shutil
import subprocess
from pathlib import Path

import lcm
import pytest
from conftest import COGIRO, TOP

from inertiad.robot import configuration, description
from inertiad.run import lcmlog


@pytest.fixture(scope="module")
def record(tmp_path_factory) -> Path:
    """The daemon's record of 8 s."""
    run = tmp_path_factory.mktemp("run")
    command = [TOP / "build/bin/inertiactl", "simulate", COGIRO / "robot.toml", "-o", run, "--seed", "5"]
    options = ["--trajectory", "hold", "--duration", "8", "--rate", "100"]
    subprocess.run([*map(str, command), *options], check=True, capture_output=True)
    configuration.write(run / "robot.cfg", description.load(run / "robot.toml"), "robot.toml")
    daemon = [
        TOP / "build/bin/inertiad",
        "--config",
        run / "robot.cfg",
        "--bus",
        f"file:{run}/can.log",
        "--lcm",
        "none",
    ]
    more = ["--tracker", f"file:{run}/tracker.csv", "--record", run / "run.lcmlog"]
    subprocess.run([str(a) for a in (*daemon, *more)], check=True, capture_output=True)
    return run / "run.lcmlog"


@pytest.fixture
def written(tmp_path) -> Path:
    """A log of our writer: a thousand messages, 600 KB."""
    log = lcmlog.Writer(tmp_path / "run.lcmlog")
    for k in range(1000):
        log.write(k, "INERTIAD_TRACKER", bytes([k % 256]) * 600)
    log.close()
    return tmp_path / "run.lcmlog"


def read(path: Path) -> tuple[list[lcmlog.Event], list[str]]:
    remarks: list[str] = []
    return list(lcmlog.read(path, remarks)), remarks


def undamaged(path: Path) -> bytes:
    events, remarks = read(path)
    assert len(events) > 100 and remarks == []
    return path.read_bytes()


@pytest.mark.parametrize("kind", [pytest.param("record", marks=pytest.mark.slow), "written"])
def test_every_flipped_bit_is_found(kind, request, tmp_path):
    path = request.getfixturevalue(kind)
    data, events = undamaged(path), read(path)[0]
    rng = random.Random(1)
    damaged = tmp_path / "damaged.lcmlog"
    for _ in range(60):
        at, bit = rng.randrange(len(data)), rng.randrange(8)
        damaged.write_bytes(data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :])
        got, remarks = read(damaged)
        assert remarks, f"bit {bit} of byte {at}"
        assert all(e in events for e in got[:: max(1, len(got) // 50)])


def test_flips_in_a_checksum_itself_are_found(written, tmp_path):
    data = undamaged(written)
    begin = data.rindex(b"INERTIAD_CHECK") - lcmlog.HEAD.size
    for at in range(begin, len(data)):
        damaged = tmp_path / "damaged.lcmlog"
        damaged.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        assert read(damaged)[1], f"byte {at - begin} of the record"


def test_a_log_cut_off_is_read_up_to_there(written, tmp_path):
    data = undamaged(written)
    (tmp_path / "cut.lcmlog").write_bytes(data[:500_000])
    events, remarks = read(tmp_path / "cut.lcmlog")
    assert len(events) == 500_000 // (28 + 16 + 600) and "cut off" in remarks[0]


def test_a_log_without_its_last_checksum_says_how_many_messages_it_covers(written, tmp_path):
    data = undamaged(written)
    begins = [k for k in range(len(data)) if data.startswith(b"INERTIAD_CHECK", k)]
    end = begins[-1] - lcmlog.HEAD.size
    (tmp_path / "cut.lcmlog").write_bytes(data[:end])
    events, remarks = read(tmp_path / "cut.lcmlog")
    n_last = data[begins[-2] : end].count(b"INERTIAD_TRACKER")
    assert len(events) == 1000 and 0 < n_last < 1000
    assert remarks == [f"{tmp_path}/cut.lcmlog: cut off: the last {n_last} of 1000 messages have no checksum"]


def test_logs_without_checksums_or_copied_are_read_as_they_are(written, tmp_path):
    """As earlier versions and lcm-logger write them; the latter with the checksums of another log in it."""
    for name, with_checks in (("plain", False), ("copied", True)):
        log = lcm.EventLog(str(tmp_path / name), "w", overwrite=True)
        for e in lcm.EventLog(str(written), "r"):
            if with_checks or e.channel != lcmlog.CHECK:
                log.write_event(e.timestamp + 12345, e.channel, e.data)
        log.close()
        events, remarks = read(tmp_path / name)
        assert len(events) == 1000 and remarks == []


def test_other_programs_read_every_message(record):
    found = [e for e in lcm.EventLog(str(record), "r") if e.channel != lcmlog.CHECK]
    assert [(e.timestamp, e.channel, e.data) for e in found] == [
        (e.t_us, e.channel, e.data) for e in lcmlog.read(record)
    ]


@pytest.mark.slow
def test_the_commands_name_the_damage(record, tmp_path, inertiactl):
    shutil.copytree(record.parent, tmp_path / "run")
    log = tmp_path / "run/run.lcmlog"
    data = bytearray(log.read_bytes())
    data[len(data) // 2] ^= 4
    log.write_bytes(data)
    verified = inertiactl("verify", tmp_path / "run")
    assert verified.returncode == 1 and "checksum differs" in verified.stdout + verified.stderr
    fitted = inertiactl("fit", log)
    assert "checksum differs" in fitted.stdout + fitted.stderr
    inertiactl("report", log, "-o", tmp_path / "report.html")
    assert "checksum differs" in (tmp_path / "report.html").read_text()
