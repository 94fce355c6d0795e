# SPDX-License-Identifier: Apache-2.0
"""The daemon's files: no pipe makes it deaf to signals, no output overwrites an input, no two daemons share a file."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import COGIRO, ISOLATED, TOP

from inertiad.robot import configuration, description
from inertiad.run import lcmlog

DAEMON = TOP / "build/bin/inertiad"
PATIENCE = 20.0  # s
STATUS_RETRY = 3


@pytest.fixture(scope="module")
def simulated(tmp_path_factory) -> Path:
    """A run of 8 s, and its configuration."""
    folder = tmp_path_factory.mktemp("run")
    command = [TOP / "build/bin/inertiactl", "simulate", COGIRO / "robot.toml", "-o", folder, "--seed", "5"]
    options = ["--trajectory", "hold", "--duration", "8", "--rate", "100"]
    subprocess.run([*map(str, command), *options], check=True, capture_output=True)
    configuration.write(folder / "robot.cfg", description.load(folder / "robot.toml"), "robot.toml")
    return folder


@pytest.fixture
def run(simulated: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(simulated, tmp_path / "run"))


def daemon(run: Path, *more: object) -> list[str]:
    return [str(a) for a in (DAEMON, "--config", run / "robot.cfg", "--lcm", "none", *more)]


def on_files(run: Path, *more: object) -> list[str]:
    return daemon(run, "--bus", f"file:{run}/can.log", "--tracker", f"file:{run}/tracker.csv", *more)


@contextmanager
def started(command: list[str], **more: object) -> Iterator[subprocess.Popen]:
    """A daemon that is killed at the end, should it still be there."""
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **more) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_until_deaf(process: subprocess.Popen) -> None:
    """Until it has blocked SIGTERM: from then on a signal reaches it by its loop only."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and process.poll() is None:
        status = Path(f"/proc/{process.pid}/status").read_text()
        blocked = next(int(line.split()[1], 16) for line in status.splitlines() if line.startswith("SigBlk"))
        if blocked & 1 << (signal.SIGTERM - 1):
            return
        time.sleep(0.01)


def stop(process: subprocess.Popen, number: int = signal.SIGTERM) -> int:
    wait_until_deaf(process)
    time.sleep(0.3)
    process.send_signal(number)
    return process.wait(timeout=PATIENCE)


# ---- buses -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 7, 8])
def test_every_number_of_buses_with_every_output(run, tmp_path, n):
    """Files, a pipe and stdin; all counters there are."""
    text = "".join((run / "can.log").read_text().splitlines(keepends=True)[:500])  # less than a pipe holds
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    addresses = [f"file:{run}/can.log"] + [f"file:{run}/can.log?interface=can{k}" for k in range(1, n)]
    if n > 2:
        addresses[-1], addresses[-2] = "file:-", f"file:{fifo}"
    buses = [part for address in addresses for part in ("--bus", address)]
    outputs = ("--record", tmp_path / "r.lcmlog", "--checkpoint", tmp_path / "c", "--estimate", tmp_path / "e.json")
    command = daemon(run, *buses, "--tracker", f"file:{run}/tracker.csv", *outputs)
    with started(command, stdin=subprocess.PIPE) as process:
        if n > 2:
            fifo.write_text(text)
        stderr = process.communicate("" if n <= 2 else text, timeout=PATIENCE)[1]
    assert process.returncode == 0, stderr
    counters = json.loads((tmp_path / "e.json").read_text())["counters"]
    assert f"bus{n - 1}.frames" in counters and f"bus{n}.frames" not in counters
    assert sum(counters[f"bus{k}.frames"] for k in range(n)) == counters["decode.frames"]


def test_nine_buses_are_refused(run):
    done = subprocess.run(daemon(run, *["--bus", "file:x"] * 9), capture_output=True, text=True)
    assert done.returncode == 2 and "--bus: more than 8" in done.stderr


# ---- pipes and signals -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("role", ["bus", "tracker", "tracker with half a header"])
def test_an_input_pipe_leaves_the_daemon_its_ears(run, tmp_path, role):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    bus = f"file:{fifo}" if role == "bus" else f"file:{run}/can.log"
    tracker = f"file:{run}/tracker.csv" if role == "bus" else f"file:{fifo}"
    writer = os.open(fifo, os.O_RDWR) if "half" in role else -1
    if writer >= 0:
        os.write(writer, b"t,x")
    with started(daemon(run, "--bus", bus, "--tracker", tracker)) as process:
        assert stop(process) == 0
    if writer >= 0:
        os.close(writer)


def test_an_input_pipe_is_read_to_its_end_once_somebody_writes(run, tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    out = tmp_path / "estimate.json"
    arguments = ("--bus", f"file:{fifo}", "--tracker", f"file:{run}/tracker.csv", "--estimate", out)
    with started(daemon(run, *arguments)) as process:
        time.sleep(0.3)
        fifo.write_bytes((run / "can.log").read_bytes())
        assert process.wait(timeout=PATIENCE) == 0
    expected = tmp_path / "expected.json"
    subprocess.run(on_files(run, "--estimate", expected), check=True, capture_output=True)
    assert json.loads(out.read_text())["mass"] == json.loads(expected.read_text())["mass"]


@pytest.mark.parametrize("output", ["--record", "--estimate", "stderr"])
def test_an_output_pipe_that_nobody_reads_leaves_the_daemon_its_ears(run, tmp_path, output):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDWR)  # it is open, and full soon
    more = [] if output == "stderr" else [output, str(fifo)]
    text = (run / "can.log").read_text()
    (run / "can.log").write_text(text * 20 if output == "--record" else text)
    os.write(reader, b"x" * 65536) if output != "--record" else None
    waiting = daemon(run, "--bus", "file:-", "--tracker", f"file:{run}/tracker.csv")
    command = on_files(run, *more) if output != "stderr" else waiting
    error = reader if output == "stderr" else subprocess.DEVNULL
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=error) as process:
        try:
            status = stop(process) if output != "--estimate" else process.wait(timeout=PATIENCE)
        finally:
            process.kill()
    assert status == (0 if output == "stderr" else 1)
    os.close(reader)


def test_an_estimate_pipe_without_a_reader_is_an_error(run, tmp_path):
    os.mkfifo(tmp_path / "fifo")
    done = subprocess.run(on_files(run, "--estimate", tmp_path / "fifo"), capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and "nobody reads this pipe" in done.stderr


@pytest.mark.parametrize("name", ["HUP", "QUIT", "USR1", "USR2", "ALRM", "XCPU", "XFSZ", "INT", "TERM"])
def test_a_signal_ends_it_with_an_estimate(run, tmp_path, name):
    out = tmp_path / "estimate.json"
    arguments = ("--bus", "file:-", "--tracker", f"file:{run}/tracker.csv", "--estimate", out)
    with started(daemon(run, *arguments), stdin=subprocess.PIPE) as process:
        assert stop(process, getattr(signal, f"SIG{name}")) == 0
    assert json.loads(out.read_text())["mass"] is None


def test_nohup_is_respected(run):
    command = ["nohup", *daemon(run, "--bus", "file:-", "--tracker", f"file:{run}/tracker.csv")]
    with started(command, stdin=subprocess.PIPE) as process:
        wait_until_deaf(process)
        process.send_signal(signal.SIGHUP)
        time.sleep(0.3)
        assert process.poll() is None
        assert stop(process) == 0


def test_closed_standard_descriptors_harm_no_file(run, tmp_path):
    record = tmp_path / "run.lcmlog"
    command = " ".join(on_files(run, "--record", record))
    done = subprocess.run(["sh", "-c", f"{command} <&- >&- 2>&-"])
    remarks: list[str] = []
    assert done.returncode == 0 and len(list(lcmlog.read(record, remarks))) > 100 and remarks == []


def test_a_closed_stdin_as_input_is_refused(run):
    command = " ".join(daemon(run, "--bus", "file:-", "--tracker", f"file:{run}/tracker.csv"))
    done = subprocess.run(["sh", "-c", f"{command} <&-"], capture_output=True, text=True)
    assert done.returncode == 2 and "Bad file descriptor" in done.stderr


# ---- files that must not be written ----------------------------------------------------------------------------------


@pytest.mark.parametrize("option", ["--estimate", "--record", "--checkpoint"])
@pytest.mark.parametrize("name", ["robot.cfg", "can.log", "tracker.csv"])
def test_an_output_that_is_an_input_is_refused(run, option, name):
    before = (run / name).read_bytes()
    (run / "link").symlink_to(run / name)
    for path in (run / name, run / ".." / "run" / name, run / "link"):
        done = subprocess.run(on_files(run, option, path), capture_output=True, text=True)
        assert done.returncode == 2 and option in done.stderr and "name another" in done.stderr, done.stderr
    assert (run / name).read_bytes() == before and not (run / f"{name}.1").exists()


@pytest.mark.parametrize(
    "outputs",
    [
        ["--estimate", "x", "--checkpoint", "x"],
        ["--record", "x", "--checkpoint", "./x"],
        ["--record", "file:x?rotate_mb=1", "--estimate", "x"],
        ["--estimate", "x", "--record", "x.tmp"],
        ["--lcm", "file://x?mode=w", "--record", "x"],
    ],
)
def test_outputs_of_one_name_are_refused(run, outputs):
    done = subprocess.run(on_files(run, *outputs), capture_output=True, text=True, cwd=run)
    assert done.returncode == 2 and "name another" in done.stderr, done.stderr
    assert not (run / "x").exists()


def test_devices_may_be_shared(run):
    outputs = ("--record", "/dev/null", "--estimate", "/dev/null")
    assert subprocess.run(on_files(run, *outputs), capture_output=True).returncode == 0


@pytest.mark.parametrize("option", ["--record", "--checkpoint"])
def test_a_second_daemon_on_a_file_is_refused_for_now(run, tmp_path, option):
    live = ("--bus", "file:-", "--tracker", f"file:{run}/tracker.csv", option, tmp_path / "file")
    with started(daemon(run, *live), stdin=subprocess.PIPE) as first:
        wait_until_deaf(first)
        time.sleep(0.3)
        second = subprocess.run(daemon(run, *live), capture_output=True, text=True, stdin=subprocess.DEVNULL)
        assert second.returncode == STATUS_RETRY and "another inertiad" in second.stderr, second.stderr
        assert stop(first) == 0
    assert subprocess.run(on_files(run, option, tmp_path / "file"), capture_output=True).returncode == 0


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--lcm", "foo", "foo: allowed: udpm://ADDRESS:PORT?ttl=N, none"),
        ("--lcm", "udpm://nowhere:0", "udpm://nowhere:0: Invalid argument"),
        ("--lcm-prefix", "a b", 'prefix "a b": allowed are'),
    ],
)
def test_a_mistyped_network_is_an_error_that_no_unit_tries_again(run, option, value, says):
    command = [DAEMON, "--config", run / "robot.cfg", "--bus", f"file:{run}/can.log", option, value]
    done = subprocess.run(
        [str(a) for a in command], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, says in done.stderr) == (2, True), done.stderr


def test_a_second_daemon_with_the_same_prefix_is_refused_for_now(run):
    script = """
import subprocess, sys, time
command = sys.argv[1:]
first = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
time.sleep(0.5)
second = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
third = subprocess.run([*command, "--lcm-prefix", "OTHER_"], stdin=subprocess.DEVNULL, capture_output=True)
first.terminate()
print(second.returncode, third.returncode, first.wait(), second.stderr)
"""
    command = [*map(str, (DAEMON, "--config", run / "robot.cfg", "--bus", "file:-"))]
    done = subprocess.run(
        [*ISOLATED, sys.executable, "-c", script, *command], capture_output=True, text=True, timeout=60
    )
    assert done.stdout.startswith("3 0 0 "), done.stdout + done.stderr
    assert "INERTIAD_: another inertiad publishes with this prefix" in done.stdout


def test_an_unwritable_checkpoint_is_tried_again(run):
    done = subprocess.run(on_files(run, "--checkpoint", run / "none/state"), capture_output=True, text=True)
    assert done.returncode == STATUS_RETRY and "--checkpoint: " in done.stderr
    unit = (TOP / "firmware/packaging/inertiad.service").read_text()
    assert "\nRestart=on-failure\n" in unit and "\nStartLimitIntervalSec=0\n" in unit
    assert str(STATUS_RETRY) not in unit.split("RestartPreventExitStatus=")[1].splitlines()[0].split()
