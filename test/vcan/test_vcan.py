# SPDX-License-Identifier: Apache-2.0
"""The daemon on real SocketCAN: vcan0, fed by can-utils and python-can.

tools/vcan provides the buses, prepare.py the runs in build/vcan.
"""

import json
import subprocess
import threading
import time
from pathlib import Path
from typing import IO

import can
import lcm
import pytest
from daemon import BIN, CLASSICAL, PATIENCE, TOP, URL, daemon, run

from inertiad_lcm import tracker_t

FD, TIMED = (TOP / "build/vcan" / name for name in ("robot_fd", "robot_timed"))
ON_TIME = 8.0  # s, no position later than that: rows still wait for it
ATTEMPTS = 3


def log_time(path: Path) -> float:
    """Stamp of a candump log's first frame, s."""
    with path.open() as file:
        return float(file.readline().split()[0].strip("()"))


def socketcan(channel: str = "vcan0", **options: object) -> can.BusABC:
    return can.Bus(channel=channel, interface="socketcan", **options)


def test_frames_of_cangen_arrive_at_candump():
    dump = subprocess.Popen(["candump", "-L", "-n", "100", "-T", "20000", "vcan1"], stdout=subprocess.PIPE, text=True)
    time.sleep(2.0)
    run("cangen", "vcan1", "-g", "1", "-n", "100", "-m")
    text, _ = dump.communicate(timeout=PATIENCE)
    assert len(text.splitlines()) == 100
    assert "##" in text, "no CAN FD frame among them"


def candump_into(recorded: IO[str], n: int) -> subprocess.Popen[str]:
    """candump of the next n frames of vcan0, once it listens."""
    listeners = Path("/proc/net/can/rcvlist_all")
    before = listeners.read_text().count("vcan0 ")
    dump = subprocess.Popen(["candump", "-L", "-r", "8000000", "-n", str(n), "vcan0"], stdout=recorded, text=True)
    end = time.monotonic() + PATIENCE
    while listeners.read_text().count("vcan0 ") == before:
        assert time.monotonic() < end, "candump does not listen"
        time.sleep(0.05)
    return dump


class Tracker(threading.Thread):
    """Publishes t, x, y, z when they are due, at host time t + offset [s]."""

    def __init__(self, rows: list[list[float]], offset: float):
        super().__init__()
        self.rows, self.offset, self.is_over, self.latest = rows, offset, threading.Event(), 0.0

    def run(self) -> None:
        link = lcm.LCM(URL)
        message = tracker_t()
        message.valid = True
        for t, *message.position in self.rows:
            due = t + self.offset
            if self.is_over.wait(max(0.0, due - time.time())):
                return
            self.latest = max(self.latest, time.time() - due)
            message.t_ns = round(1e9 * due)
            link.publish("INERTIAD_TRACKER", message.encode())
            message.sequence += 1


def play(log: Path, rows: list[list[float]], folder: Path) -> tuple[dict[str, int], float, float]:
    """The run's frames over vcan0 and its positions over LCM, at their time, to the daemon and, beside it, candump.

    -> counters, offset of host time [s], how late the latest position was sent [s]
    """
    n = len(log.read_text().splitlines())
    with daemon("--estimate", folder / "live.json", robot=TIMED) as d, (folder / "can.log").open("w") as recorded:
        dump = candump_into(recorded, n)
        listener = socketcan(fd=True)
        player = subprocess.Popen(["canplayer", "-I", str(log), "vcan0=can0"])
        offset = listener.recv(PATIENCE).timestamp - log_time(log)
        listener.shutdown()
        tracker = Tracker(rows, offset)
        tracker.start()
        try:
            assert player.wait(timeout=300) == 0
            d.wait(lambda c: c["bus0.frames"] + c["bus0.dropped_by_kernel"] >= n)
            assert dump.wait(timeout=PATIENCE) == 0
            tracker.join()
        finally:
            tracker.is_over.set()
            player.kill()
            dump.kill()
        return d.stop(), offset, tracker.latest


def test_run_replayed_by_canplayer_is_estimated_as_candump_recorded_it(tmp_path: Path):
    # when: a run is played, again where the machine stalled and positions were late
    log, positions = TIMED / "run/can.log", TIMED / "run/tracker.csv"
    n = len(log.read_text().splitlines())
    rows = [[float(cell) for cell in line.split(",")] for line in positions.read_text().splitlines()[1:]]
    for _ in range(ATTEMPTS):
        summary, offset, latest = play(log, rows, tmp_path)
        print(f"no position later than {latest:.3f} s", summary)
        if latest <= ON_TIME:
            break

    # then: nothing was lost, and the estimate is that of the recorded frames and positions, and near the truth
    assert summary["bus0.frames"] == n
    assert summary["bus0.dropped_by_kernel"] == 0
    assert summary["decode.decoded"] == n
    assert summary["lcm.tracker_positions"] >= 0.99 * len(rows)  # UDP on a machine that may stall
    shifted = [f"{t + offset:.9f},{x},{y},{z}\n" for t, x, y, z in rows]
    (tmp_path / "tracker.csv").write_text("t,x,y,z\n" + "".join(shifted))
    files = ["--bus", f"file:{tmp_path / 'can.log'}", "--tracker", f"file:{tmp_path / 'tracker.csv'}"]
    config = TIMED / "robot.cfg"
    run(BIN / "inertiad", "--config", config, "--lcm", "none", *files, "--estimate", tmp_path / "file.json")
    live, file = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("live", "file"))
    truth = json.loads((TIMED / "run/truth.json").read_text())
    assert live["samples"]["used"] == pytest.approx(file["samples"]["used"], rel=0.01)
    assert live["mass"]["value"] == pytest.approx(file["mass"]["value"], rel=1e-3)
    assert live["cog"]["value"] == pytest.approx(file["cog"]["value"], abs=1e-3)
    assert live["inertia_cog"]["value"] == pytest.approx(file["inertia_cog"]["value"], abs=0.5)
    assert live["mass"]["value"] == pytest.approx(truth["mass"], rel=0.02)
    assert live["cog"]["value"] == pytest.approx(truth["cog"], abs=0.01)


def test_classical_frames_of_canplayer_at_full_speed_are_all_decoded():
    log = CLASSICAL / "run/can.log"
    n = len(log.read_text().splitlines())
    with daemon() as d:
        run("canplayer", "-t", "-g", "0", "-I", log, "vcan0=can0")
        d.wait(lambda c: c["bus0.frames"] + c["bus0.dropped_by_kernel"] >= n)
        summary = d.stop()
    assert summary["bus0.dropped_by_kernel"] == 0
    assert summary["decode.decoded"] == n


def test_fd_frames_of_python_can_are_all_decoded():
    with can.LogReader(FD / "run/can.log") as reader:
        messages = list(reader)
    assert messages[0].is_fd
    with daemon(robot=FD) as d, socketcan(fd=True) as bus:
        for message in messages:
            bus.send(message, timeout=1.0)
        d.wait(lambda c: c["bus0.frames"] >= len(messages))
        summary = d.stop()
    assert summary["decode.decoded"] == len(messages)
    assert summary["group.imu.complete"] == summary["group.force.complete"] == len(messages)


def test_random_traffic_at_full_speed_is_counted_to_the_last_frame():
    n = 10000
    with daemon(bus="socketcan:vcan0?filter=off") as d:
        run("cangen", "vcan0", "-g", "0", "-n", n, "-m", "-R", "-p", "10")
        d.wait(lambda c: c["bus0.frames"] + c["bus0.dropped_by_kernel"] >= n)
        summary = d.stop()
    assert summary["bus0.frames"] + summary["bus0.dropped_by_kernel"] == n
    outcomes = ("decoded", "unknown_id", "remote", "error_frame", "bad_length")
    assert sum(summary[f"decode.{outcome}"] for outcome in outcomes) == summary["decode.frames"]
    assert summary["decode.frames"] == summary["bus0.frames"]
    assert summary["decode.unknown_id"] > 0.5 * n and summary["decode.remote"] > 0
    assert summary["lcm.estimates_not_finite"] == 0


def test_unbound_identifiers_do_not_reach_the_daemon_behind_its_filter():
    with daemon() as d, socketcan() as bus:
        for can_id in (0x7FF, 0x010, 0x7FE):
            bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=bytes(8)))
        d.wait(lambda c: c["bus0.frames"] > 0)
        assert d.stop()["bus0.frames"] == 1


def test_error_frame_of_an_overrun_controller_is_counted():
    CAN_ERR_CRTL, CAN_ERR_CRTL_RX_OVERFLOW = 0x004, 0x01
    with daemon() as d, socketcan() as bus:
        data = bytes([0, CAN_ERR_CRTL_RX_OVERFLOW, 0, 0, 0, 0, 0, 0])
        bus.send(can.Message(arbitration_id=CAN_ERR_CRTL, is_error_frame=True, is_extended_id=False, data=data))
        d.wait(lambda c: c["bus0.error_frames"] > 0)
        summary = d.stop()
    assert (summary["bus0.error_frames"], summary["bus0.controller_overruns"]) == (1, 1)


def test_interface_that_goes_down_and_up_is_taken_up_again():
    with daemon() as d:
        run("ip", "link", "set", "vcan0", "down")
        d.wait(lambda c: c["bus0.went_down"] == 1)
        run("ip", "link", "set", "vcan0", "up")
        end = time.monotonic() + PATIENCE
        while d.counters["bus0.frames"] == 0 and time.monotonic() < end:
            run("cansend", "vcan0", "010#0011223344556677")
            d.lcm.handle_timeout(1000)
        assert d.stop()["bus0.frames"] > 0


def test_absent_interface_is_one_line_and_exit_status_2():
    command = [BIN / "inertiad", "-v", "--config", CLASSICAL / "robot.cfg", "--bus", "socketcan:vcan9", "--lcm", "none"]
    result = subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=PATIENCE)
    assert result.returncode == 2
    assert len(result.stderr.splitlines()) == 1
    assert "vcan9" in result.stderr
