# SPDX-License-Identifier: Apache-2.0
"""The daemon never touches the heap after its start, in no thread; --rt and --cpu do what they say or say why not."""

import os
import subprocess
from pathlib import Path

import pytest
from conftest import COGIRO, ISOLATED, TOP

DAEMON = TOP / "build/bin/inertiad"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def trap(tmp_path_factory) -> Path:
    library = tmp_path_factory.mktemp("trap") / "trap.so"
    source = TOP / "test/host/trap.c"
    subprocess.run(["cc", "-std=gnu11", "-O2", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    return library


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A simulated run and its compiled configuration."""
    folder = tmp_path_factory.mktemp("run")
    command = [TOP / "build/bin/inertiactl"]
    subprocess.run([*command, "simulate", COGIRO / "robot.toml", "-o", folder], check=True, capture_output=True)
    subprocess.run(
        [*command, "compile", folder / "robot.toml", "-o", folder / "robot.cfg"], check=True, capture_output=True
    )
    return folder


def daemon(run: Path, *more: object) -> list[str]:
    arguments = [DAEMON, "-v", "--config", run / "robot.cfg", "--bus", f"file:{run}/can.log"]
    return [str(a) for a in [*arguments, "--tracker", f"file:{run}/tracker.csv", *more]]


def heap_calls(trap: Path, run: Path, command: list[str]) -> tuple[int, int]:
    """Calls of any thread between the first and last look at the event loop, and looks."""
    (run / "trap.txt").unlink(missing_ok=True)
    result = subprocess.run(
        [*ISOLATED, "env", f"LD_PRELOAD={trap}", f"TRAP={run}/trap.txt", *command],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr
    calls, waits = map(int, (run / "trap.txt").read_text().split())
    return calls, waits


@pytest.mark.parametrize("lcm", ["none", "udpm://239.255.76.67:7667?ttl=0"])
def test_no_thread_calls_the_heap_after_start(trap, run, tmp_path, lcm):
    more = ["--lcm", lcm, "--record", tmp_path / "run.lcmlog", "--checkpoint", tmp_path / "state"]
    calls, waits = heap_calls(trap, run, daemon(run, *more))
    assert waits > 10
    assert calls == 0


def test_trap_sees_a_transport_that_does_allocate(trap, run, tmp_path):
    calls, _ = heap_calls(trap, run, daemon(run, "--lcm", f"file://{tmp_path}/out.lcmlog?mode=w"))
    assert calls > 100


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rt", "0"], '--rt: "0" is not a whole number from 1 to 99'),
        (["--rt", "fifo"], '--rt: "fifo" is not a whole number from 1 to 99'),
        (["--collect", "0.2"], '--collect: "0.2" is not a number of seconds from 0 to 0.1'),
        (["--collect", "nan"], '--collect: "nan" is not a number of seconds from 0 to 0.1'),
        (["--cpu", "-1"], '--cpu: "-1" is not a whole number from 0 to 1023'),
        (["--cpu", "1023"], "--cpu: 1023: no such processor"),
    ],
)
def test_unusable_settings_are_one_line_and_exit_2(run, arguments, message):
    result = subprocess.run(daemon(run, "--lcm", "none", *arguments), capture_output=True, text=True, timeout=60)
    assert result.returncode == 2
    assert len(result.stderr.splitlines()) == 1 and message in result.stderr


def test_without_permission_it_says_what_is_missing(run):
    drop = ["prlimit", "--memlock=65536:65536", "--rtprio=0:0", "setpriv", "--bounding-set=-all", "--inh-caps=-all"]
    if os.geteuid() != 0 or subprocess.run([*drop, "true"], capture_output=True).returncode != 0:
        pytest.skip("cannot give up permissions here")
    command = [*drop, *daemon(run, "--lcm", "none", "--rt", "50")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert result.returncode == 2
    assert "--rt: cannot lock memory" in result.stderr and "CAP_IPC_LOCK" in result.stderr


def scheduling(pid: int) -> dict[str, tuple[str, str]]:
    """Policy and priority of every thread, main first."""
    lines = subprocess.run(["ps", "-L", "-o", "lwp=,cls=,rtprio=", str(pid)], capture_output=True, text=True).stdout
    return {lwp: (cls, priority) for lwp, cls, priority in map(str.split, lines.splitlines())}


def test_priority_and_processor_are_the_main_threads_alone(run, tmp_path):
    more = ["--lcm", "none", "--rt", "7", "--cpu", "0", "--record", tmp_path / "run.lcmlog"]
    command = daemon(run, *more)
    command[command.index("--bus") + 1] += "?speed=1"
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            process.wait(timeout=1)
        except subprocess.TimeoutExpired:
            threads = scheduling(process.pid)
            status = Path(f"/proc/{process.pid}/status").read_text()
            process.terminate()
            assert threads.pop(str(process.pid)) == ("FF", "7")
            assert list(threads.values()) == [("TS", "-")]
            assert "Cpus_allowed_list:\t0\n" in status
            assert int(status.split("VmLck:")[1].split()[0]) > 8000
        error = process.communicate()[1]
    if process.returncode == 2:
        assert "CAP_" in error
        pytest.skip(error.strip())
    assert process.returncode == 0
