# SPDX-License-Identifier: Apache-2.0
"""Replay: order, pacing, cutting, loops, and tracker positions as LCM packets. The bus itself is in test/vcan."""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import ISOLATED, TOP

import inertiad_replay
from inertiad.live import replay
from inertiad_lcm import tracker_t


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """1 s of 100 frames/s on two interfaces and of 50 positions/s."""
    lines = [f"({5 + 0.01 * k:017.6f}) can{k % 2} 123#{k:04X}\n" for k in range(100)]
    (tmp_path / "can.log").write_text("".join(lines))
    rows = [f"{5 + 0.02 * k:.6f},{k},0.5,-0.25\n" for k in range(50)]
    (tmp_path / "tracker.csv").write_text("t,x,y,z\n" + "".join(rows))
    return tmp_path


def test_log_comes_out_of_stdout_as_it_is_and_in_time(inertiactl, run):
    began = time.monotonic()
    result = inertiactl("replay", run, "--bus", "-", "--speed", "2")
    assert result.returncode == 0, result.stderr
    assert result.stdout == (run / "can.log").read_text()
    assert time.monotonic() - began > 0.49
    assert "stdout: 100 sent, late by" in result.stderr


def test_start_stop_and_loop(inertiactl, run):
    result = inertiactl("replay", run, "--bus", "-", "--speed", "50", "--start", "0.2", "--stop", "0.4", "--loop", "3")
    assert result.returncode == 0, result.stderr
    assert result.stdout == 3 * "".join((run / "can.log").read_text().splitlines(keepends=True)[20:41])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere", "--bus", "-"], "nowhere: No such file"),
        (["RUN", "--bus", "can0"], "--bus can0: allowed: socketcan:INTERFACE"),
        (["RUN", "--bus", "-", "--speed", "0"], "--speed 0: allowed: 0.001 to 1000"),
        (["RUN", "--bus", "-", "--start", "2", "--stop", "1"], "--stop 1: allowed: above --start = 2 s"),
        (["RUN", "--bus", "-", "--start", "9"], "nothing between --start 9"),
        (["RUN", "--bus", "-", "--tracker", "usb"], "--tracker usb: allowed: lcm, none, text=ADDRESS"),
        (["RUN", "--lcm", "tcpq://x", "--tracker", "lcm"], "--lcm tcpq://x: allowed: udpm://"),
    ],
)
def test_unusable_arguments_are_one_line_and_exit_2(inertiactl, run, arguments, message):
    result = inertiactl("replay", *[run if a == "RUN" else a for a in arguments])
    assert result.returncode == 2
    assert len(result.stderr.splitlines()) == 1 and message in result.stderr


def test_reader_that_goes_away_is_one_line(run):
    command = f"{sys.executable} -m inertiad replay {run} --bus - --speed 5 | head -n 1"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60, cwd=TOP)
    assert result.stderr.splitlines() == ["inertiactl: stdout: Broken pipe"]


def test_merge_keeps_order_and_content():
    a = replay.Items("a", 1, np.array([10, 30, 20]), np.frombuffer(b"AABCC", np.uint8), np.array([0, 2, 3, 5]))
    b = replay.Items("b", 1, np.array([5, 30]), np.frombuffer(b"xyz", np.uint8), np.array([0, 1, 3]))
    schedule = replay.schedule_of([a, b])
    pieces = [bytes(schedule.data[i:j]) for i, j in zip(schedule.begin[:-1], schedule.begin[1:], strict=True)]
    assert pieces == [b"x", b"AA", b"B", b"CC", b"yz"]
    assert schedule.t_ns.tolist() == [5, 10, 30, 30, 30]


def test_player_keeps_time_and_says_how_late_it_was():
    receiver, sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    n, period = 200, 1_000_000
    data, begin = np.arange(n, dtype=np.uint8), np.arange(n + 1)
    due = period * np.arange(n)
    start = time.monotonic_ns() + 10_000_000
    result = inertiad_replay.play(data, begin, due, np.zeros(n, np.uint8), [sender.fileno()], start, 50_000)
    assert time.monotonic_ns() >= start + due[-1]
    assert [receiver.recv(9)[0] for _ in range(n)] == data.tolist()
    assert (result["lateness_ns"] >= 0).all() and result["error"] == 0


def test_player_waits_for_a_slow_reader():
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    data = np.zeros(200_000, dtype=np.uint8)
    with subprocess.Popen(["sh", "-c", "sleep 0.2; wc -c"], stdin=reader, stdout=subprocess.PIPE, text=True) as process:
        os.close(reader)
        begin, none = np.array([0, 100_000, 200_000]), np.zeros(2, dtype=np.int64)
        result = inertiad_replay.play(data, begin, none, np.zeros(2, np.uint8), [writer], time.monotonic_ns(), 0)
        os.close(writer)
        assert process.communicate()[0].strip() == "200000"
    assert result["n_waits"] > 0


RECEIVER = """
import subprocess, sys, time, lcm
from inertiad_lcm import tracker_t
link, got = lcm.LCM("udpm://239.255.76.67:7667?ttl=0"), []
subscription = link.subscribe("INERTIAD_TRACKER", lambda c, d: got.append((time.time_ns(), tracker_t.decode(d))))
subscription.set_queue_capacity(1000)
command = [sys.executable, "-m", "inertiad", "replay", sys.argv[1], "--speed", "2", "--loop", "2", "--tracker", "lcm"]
with subprocess.Popen(command) as player:
    while player.poll() is None or link.handle_timeout(300):
        link.handle_timeout(100)
first = got[0][1]
for t, m in got:
    late = 1e-9 * (t - m.t_ns)
    print(m.sequence, m.valid, *m.position, m.t_device_ns, m.t_ns - first.t_ns, round(late, 3))
"""


def test_tracker_positions_arrive_as_lcm_messages(run):
    result = subprocess.run(
        [*ISOLATED, sys.executable, "-c", RECEIVER, run], capture_output=True, text=True, timeout=60, cwd=TOP
    )
    rows = [line.split() for line in result.stdout.splitlines()]
    assert [int(r[0]) for r in rows] == list(range(100)), result.stderr
    assert [float(r[2]) for r in rows] == 2 * list(range(50))
    assert {tuple(r[3:5]) for r in rows} == {("0.5", "-0.25")}
    assert [int(r[5]) for r in rows[:50]] == [5_000_000_000 + 20_000_000 * k for k in range(50)]
    assert [int(r[6]) for r in rows[:50]] == [10_000_000 * k for k in range(50)]
    assert all(0 <= float(r[7]) < 0.5 for r in rows)


def test_packet_is_the_message_lcm_would_make():
    packet = replay.tracker_packets("C", np.array([7]), np.array([[1.0, 2.0, 3.0]]))[0]
    message = tracker_t()
    message.t_ns = message.t_device_ns = 7
    message.valid, message.position = True, [1.0, 2.0, 3.0]
    assert packet.tobytes() == b"LC02" + bytes(4) + b"C\0" + message.encode()
