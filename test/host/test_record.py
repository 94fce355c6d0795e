# SPDX-License-Identifier: Apache-2.0
"""record: every format over real sockets from the emulator; bad input is counted or refused with a hint."""

import json
import os
import re
import socket
import struct
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from conftest import ISOLATED, TOP
from scipy.spatial.transform import Rotation

from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.live import byte_sources, record, tracker_protocols
from inertiad.live.tracker_protocols import Layout, Parser, Sample
from inertiad.run import lcmlog, tracker_csv
from inertiad_lcm import tracker_t

STRUCT = Layout("struct", ("frame", "t", "x", "y", "z"), struct="<Id3d")
LAYOUTS = [Layout("text"), STRUCT, *(Layout(name) for name in ("spatialanalyzer", "emscon", "dtrack", "natnet"))]
RATE, SECONDS = 238.0, 2.0

# Runs inside a network of its own: recorder and emulator over loopback, both as a user starts them.
END_TO_END = """
import json, os, signal, subprocess, sys, time
run, out, form, source, sink, options = sys.argv[1:6] + [json.loads(sys.argv[6])]
python = [sys.executable, "-m", "inertiad"]
limit = json.loads(sys.argv[7]) if len(sys.argv) > 7 else []
recorder = subprocess.Popen([*limit, *python, "record", *options, "--from", source, "--format", form, "-o", out])
while not os.path.exists(out + "/tracker.csv"):
    time.sleep(0.05)
    assert recorder.poll() is None
subprocess.run([*python, "replay", run, "--tracker", f"{form}={sink}"], check=True)
time.sleep(1.0)
recorder.send_signal(signal.SIGINT)
sys.exit(recorder.wait())
"""


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """SECONDS of a tracker that tells poses, at RATE."""
    t = 100.0 + np.arange(int(RATE * SECONDS)) / RATE
    xyz = np.column_stack([np.sin(t), np.cos(t), 2.0 + 0.1 * np.sin(3.0 * t)])
    folder = tmp_path / "played"
    folder.mkdir()
    turn = Rotation.from_euler("zyx", np.column_stack([np.sin(2.0 * t), 0.3 * np.cos(t), 0.2 * np.sin(t)]))
    table = np.column_stack([t, xyz, turn.as_quat(scalar_first=True)])
    np.savetxt(folder / "tracker.csv", table, "%.9f", ",", header="t,x,y,z,q_w,q_x,q_y,q_z", comments="")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "source", "sink", "options"),
    [
        ("text", "udp:5001", "udp:127.0.0.1:5001", []),
        ("text", "tcp-listen:5002", "tcp:127.0.0.1:5002", []),
        ("struct", "tcp:127.0.0.1:5003", "tcp-listen:5003", ["--struct", "<Id3d", "--columns", "frame,t,x,y,z"]),
        ("spatialanalyzer", "udp:5004", "udp:127.0.0.1:5004", []),
        ("emscon", "tcp:127.0.0.1:5005", "tcp-listen:5005", []),
        ("dtrack", "udp:5006", "udp:127.0.0.1:5006", []),
        ("natnet", "udp:239.255.42.99:1511", "udp:239.255.42.99:1511", []),
    ],
)
# dtrack and natnet are poses, the others positions
def test_emulated_instrument_is_recorded_without_loss(run, tmp_path, form, source, sink, options):
    out = tmp_path / "recorded"
    command = [*ISOLATED, sys.executable, "-c", END_TO_END, run, out, form, source, sink, json.dumps(options)]
    result = subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=60, cwd=TOP)
    print(result.stderr)
    assert result.returncode == 0, result.stderr
    played = np.loadtxt(run / "tracker.csv", delimiter=",", skiprows=1)
    events = [e for e in lcmlog.read(out / "run.lcmlog") if e.channel == "INERTIAD_TRACKER"]
    messages = [tracker_t.decode(e.data) for e in events]
    assert [m.sequence for m in messages] == list(range(len(played)))
    assert np.array([m.position for m in messages]) == pytest.approx(
        played[:, 1:4], abs=1e-6 if form == "natnet" else 1e-8
    )
    assert {m.has_q for m in messages} == {form in ("dtrack", "natnet")}
    assert json.loads((out / "header.json").read_text())["clock"]["kernel"]["error_max_s"] >= 0.0
    assert (out / "tracker.raw").stat().st_size > 20 * len(played)
    rows = np.loadtxt(out / "tracker.csv", delimiter=",", skiprows=1)
    if form in ("dtrack", "natnet"):
        q = np.array([m.q for m in messages])
        q *= np.sign(np.sum(q * played[:, 4:], axis=1, keepdims=True))  # q and -q are one attitude
        assert q == pytest.approx(played[:, 4:], abs=1e-6)
        assert np.linalg.norm(tracker_csv.read(out / "tracker.csv").stack(*quantity.QUATERNION), axis=1) == (
            pytest.approx(np.ones(len(rows)))
        )
    if form != "spatialanalyzer":  # they tell device time, so the spacing is the device's
        assert len(rows) >= len(played) - 20  # fewer while the clock's fit settles on a busy machine
        assert np.diff(rows[-200:, 0]) == pytest.approx(1 / RATE, abs=2e-4)


POSES = """
import os, signal, subprocess, sys, time, lcm
from inertiad_lcm import tracker_t
out = sys.argv[1]
recorder = subprocess.Popen([sys.executable, "-m", "inertiad", "record", "--from", "udp:5031", "-o", out])
while not os.path.exists(out + "/header.json"):
    time.sleep(0.05)
    assert recorder.poll() is None
time.sleep(1.0)
link, message = lcm.LCM("udpm://239.255.76.67:7667?ttl=0"), tracker_t()
begin = time.monotonic()
for message.sequence in range(1666):
    time.sleep(max(0.0, begin + message.sequence / 833.0 - time.monotonic()))
    link.publish("INERTIAD_POSE", message.encode())
    link.publish("OTHER_POSE", message.encode())
time.sleep(1.0)
recorder.send_signal(signal.SIGINT)
sys.exit(recorder.wait())
"""


@pytest.mark.slow
def test_commanded_pose_at_833_Hz_is_recorded_to_the_last(tmp_path):
    command = [*ISOLATED, sys.executable, "-c", POSES, str(tmp_path / "run")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=TOP)
    assert "1666 INERTIAD_POSE" in result.stderr, result.stderr
    events = list(lcmlog.read(tmp_path / "run/run.lcmlog"))
    assert [tracker_t.decode(e.data).sequence for e in events] == list(range(1666))
    assert {e.channel for e in events} == {"INERTIAD_POSE"}


@pytest.mark.slow
def test_full_disk_is_said_and_leaves_a_run_readable_to_there(run, tmp_path):
    out = tmp_path / "recorded"
    arguments = [run, out, "text", "udp:5032", "udp:127.0.0.1:5032", "[]", json.dumps(["prlimit", "--fsize=9000"])]
    command = [*ISOLATED, sys.executable, "-c", END_TO_END, *map(str, arguments)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=TOP)
    assert result.returncode == 0, result.stderr
    assert re.search(
        r"not written: \d+ pieces of tracker.raw and tracker.csv: .*: No space left on device", result.stderr
    )
    assert f"samples: {int(RATE * SECONDS)} received, {int(RATE * SECONDS)} published" in result.stderr
    positions = tracker_csv.read(out / "tracker.csv")
    assert not tracker_csv.has_attitude(positions)
    assert 100 < len(positions.t) < int(RATE * SECONDS)
    assert f"tracker.csv: {len(positions.t)} rows" in result.stderr


# ---- bytes to samples ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda x: x.format)
@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_stream_cut_anywhere_gives_the_same_samples(layout, chunk):
    samples = [Sample((0.1 * k, -1.5, 2.0), 10.0 + k) for k in range(5)]
    stream = b"".join(tracker_protocols.encode(layout, s, k + 1) for k, s in enumerate(samples))
    parser = Parser(layout)
    found = [s for i in range(0, len(stream), chunk) for s in parser.feed(stream[i : i + chunk])]
    assert np.array([s.position for s in found]) == pytest.approx(np.array([s.position for s in samples]))
    assert parser.n_bad == 0


def test_units_columns_and_separator():
    parser = Parser(Layout("text", ("frame", "-", "x", "y", "z", "valid", "t"), "", unit="mm", time_unit="ms"))
    (sample,) = parser.feed(b"7 junk 1000 2000 -500 0 1500\n")
    assert sample == Sample((1.0, 2.0, -0.5), 1.5, 7, False)


def test_unreadable_lines_and_half_packets_are_counted():
    parser = Parser(Layout("text"))
    assert len(parser.feed(b"1,2,3,4\nnonsense\n1,2\n1,2,3,5\n")) == 2
    assert parser.n_bad == 2
    half = Parser(STRUCT)
    half.feed(b"\0" * 11)
    half.end()
    assert (half.n_bad, half.last_bad) == (1, "half a packet")
    swapped = Parser(Layout("emscon"))
    swapped.feed(struct.pack(">ii", 68, 3) + bytes(60))
    assert swapped.n_bad == 1


def test_dtrack_body_out_of_sight_is_beam_lost():
    parser = Parser(Layout("dtrack"))
    (sample,) = parser.feed(b"fr 1\nts 10.5\n6d 0\n")
    assert (sample.valid, sample.frame, sample.t_device) == (False, 1, 10.5)


QUARTER = (0.5**0.5, 0.0, 0.0, 0.5**0.5)  # about z: x of the body along y of the world


def test_dtrack_tells_the_rotation_matrix_column_by_column():
    told = b"fr 1\nts 10.5\n6d 1 [0 1.000][500 1500 2500 0 0 90][0 1 0 -1 0 0 0 0 1]\n"
    (sample,) = Parser(Layout("dtrack")).feed(told)
    assert sample.position == (0.5, 1.5, 2.5) and sample.q == pytest.approx(QUARTER)


def test_natnet_tells_the_scalar_last():
    sent = bytearray(tracker_protocols.encode(Layout("natnet"), Sample((1.0, 2.0, 3.0), 5.5), 7))
    at = bytes(sent).index(struct.pack("<3f", 1.0, 2.0, 3.0)) + 12
    sent[at : at + 16] = struct.pack("<4f", 0.0, 0.0, QUARTER[3], QUARTER[0])
    (sample,) = Parser(Layout("natnet")).feed(bytes(sent))
    assert sample.q == pytest.approx(QUARTER)


def test_columns_of_text_and_struct_may_be_a_pose():
    columns = ("t", "x", "y", "z", "q_w", "q_x", "q_y", "q_z")
    (sample,) = Parser(Layout("text", columns)).feed(b"1,2,3,4,0.7071068,0,0,0.7071068\n")
    assert sample.q == pytest.approx(QUARTER)
    packed = struct.pack("<8d", 1, 2, 3, 4, 0.0, 0.0, 0.0, 1.0)
    assert Parser(Layout("struct", columns, struct="<8d")).feed(packed)[0].q == (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("layout", "sent", "why"),
    [
        (Layout("dtrack"), b"fr 1\n6d 1 [0 1][1 2 3 0 0 0][2 0 0 0 2 0 0 0 2]\n", "6d 1"),
        (Layout("dtrack"), b"fr 1\n6d 1 [0 1][1 2 3 0 0 0][1 0 0 0 1 0 0 0 -1]\n", "6d 1"),
        (Layout("dtrack"), b"fr 1\n6d 1 [0 1][1 2 3 0 0 0]\n", "6d 1"),
        (Layout("text", ("x", "y", "z", "q_w", "q_x", "q_y", "q_z")), b"1,2,3,0,0,0,0\n", "1,2,3"),
        (Layout("natnet"), None, "natnet: attitude of length 0"),
    ],
)
def test_attitude_that_is_none_is_counted(layout, sent, why):
    parser = Parser(layout)
    sent = sent or tracker_protocols.encode(layout, Sample((1.0, 2.0, 3.0), 5.5, q=(0.0, 0.0, 0.0, 0.0)), 7)
    assert parser.feed(sent) == []
    assert parser.n_bad == 1 and parser.last_bad.startswith(why)


def test_natnet_body_is_chosen_by_number_and_damage_is_counted():
    sent = tracker_protocols.encode(Layout("natnet"), Sample((1.0, 2.0, 3.0), 5.5, q=QUARTER), 7)
    (body,) = Parser(Layout("natnet", body=1)).feed(sent)
    assert (body.position, body.t_device, body.frame, body.valid) == ((1.0, 2.0, 3.0), 5.5, 7, True)
    assert Parser(Layout("natnet", body=2)).feed(sent) == [Sample((0.0, 0.0, 0.0), 5.5, 7, False)]
    other = Parser(Layout("natnet", natnet_version="3.0"))
    half = Parser(Layout("natnet"))
    half.feed(sent[:4] + sent[4:60].ljust(len(sent) - 4, b"\xff"))
    assert other.feed(sent) == [] or not other.feed(sent)[0].valid
    assert half.n_bad == 1 and "is --natnet-version right?" in half.last_bad
    ping = struct.pack("<HH", 0, 3) + b"abc"
    assert len(Parser(Layout("natnet")).feed(ping + sent)) == 1


def test_emscon_tells_device_time_unless_it_is_not_wanted():
    sent = tracker_protocols.encode(Layout("emscon"), Sample((1.0, 2.0, 3.0), 77.000123), 1)
    assert Parser(Layout("emscon")).feed(sent)[0].t_device == pytest.approx(77.000123)
    assert Parser(Layout("emscon", device_time=False)).feed(sent)[0].t_device is None


# ---- samples to messages ---------------------------------------------------------------------------------------------


def feed(tracker: record.Tracker, samples: list[Sample], period: float = 0.01) -> list[tracker_t]:
    messages = [tracker.take(s, 10**18 + round(1e9 * period * k)) for k, s in enumerate(samples)]
    return [m for m in messages if m is not None]


def test_millimetres_for_metres_are_refused_with_a_hint():
    with pytest.raises(InputError, match=r"is it in mm\? try --unit mm"):
        feed(record.Tracker(Layout("text")), [Sample((1500.0, 200.0, 2000.0), 0.01 * k) for k in range(30)])


def test_wrong_byte_order_is_refused_with_a_hint():
    big = b"".join(struct.pack(">Id3d", k, 0.01 * k, 1.1, 2.2, 3.3) for k in range(30))
    with pytest.raises(InputError, match="byte order"):
        feed(record.Tracker(STRUCT), [Sample(s.position) for s in Parser(STRUCT).feed(big)])


def test_lost_repeated_and_late_frames_are_counted():
    tracker = record.Tracker(STRUCT)
    order = [1, 2, 2, 5, 4, 6, 2**32 - 1, 0, 1]
    feed(tracker, [Sample((1.0, 1.0, 1.0), None, n) for n in order[:6]])
    assert (tracker.counts.n_published, tracker.counts.n_repeated, tracker.counts.n_lost) == (4, 2, 2)
    wrapping = record.Tracker(STRUCT)
    assert len(feed(wrapping, [Sample((1.0, 1.0, 1.0), None, n) for n in order[6:]])) == 3
    assert wrapping.counts.n_lost == 0


def test_device_time_goes_on_over_midnight():
    tracker = record.Tracker(Layout("dtrack"))
    t = 86399.0 + 0.01 * np.arange(300)
    samples = [Sample((1.0, 1.0, 1.0), float(x % 86400.0), k) for k, x in enumerate(t)]
    stamps = np.array([m.t_ns for m in feed(tracker, samples)])
    assert np.diff(stamps) == pytest.approx(1e7, abs=1e3)


def test_device_time_goes_on_over_its_counters_end():
    wrap = 2**32 * 1e-6
    tracker = record.Tracker(Layout("text", wrap=wrap))
    t = wrap - 1.0 + 0.01 * np.arange(300)
    stamps = np.array([m.t_ns for m in feed(tracker, [Sample((1.0, 1.0, 1.0), float(x % wrap)) for x in t])])
    assert len(stamps) == 300
    assert np.diff(stamps) == pytest.approx(1e7, abs=1e3)


@pytest.mark.parametrize("rate", [1000.0, 0.001, 60.0])
def test_device_time_of_another_unit_is_refused_with_a_hint(rate):
    samples = [Sample((1.0, 1.0, 1.0), rate * 0.01 * k) for k in range(300)]
    with pytest.raises(InputError, match=rf"passes {rate:g} times as fast .*is --time-unit right\?"):
        feed(record.Tracker(Layout("text")), samples)


def test_beam_lost_for_seconds_is_counted_and_the_rest_goes_on():
    samples = [Sample((0.0, 0.0, 0.0) if 100 < k < 500 else (1.0, 1.0, 1.0), 0.01 * k, k, not 100 < k < 500)
               for k in range(700)]  # fmt: skip
    tracker = record.Tracker(Layout("text"))
    messages = feed(tracker, samples)
    assert [m.valid for m in messages] == [s.valid for s in samples]
    assert (tracker.counts.n_invalid, tracker.counts.n_lost) == (399, 0)


def test_beam_lost_is_published_as_not_valid():
    messages = feed(record.Tracker(Layout("text")), [Sample((0.0, 0.0, 0.0), 1.0, None, False)])
    assert [m.valid for m in messages] == [False]


# ---- where bytes come from -------------------------------------------------------------------------------------------


def drain(source: byte_sources.Input, n: int) -> bytes:
    data = b""
    for _ in range(200):
        data += b"".join(d for d, _ in source.receive())
        if len(data) >= n:
            break
    return data


def test_second_sender_is_counted_and_left_out():
    source = byte_sources.open_input("udp:127.0.0.1:5011")
    first, second = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for link, text in ((first, b"a"), (second, b"b"), (first, b"c")):
        link.sendto(text, ("127.0.0.1", 5011))
    assert drain(source, 2) == b"ac"
    assert source.n_foreign == 1
    source.close()


@pytest.mark.parametrize(("patience", "said"), [("SILENT", b"1"), ("START", b"")])
def test_peer_that_hangs_or_goes_is_connected_anew(monkeypatch, patience, said):
    monkeypatch.setattr(byte_sources, patience, 0.3)
    server = socket.create_server(("127.0.0.1", 0))
    source = byte_sources.open_input(f"tcp:127.0.0.1:{server.getsockname()[1]}")

    def serve() -> None:
        hanging, _ = server.accept()
        hanging.sendall(said)
        server.accept()[0].sendall(b"2")
        hanging.close()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    assert drain(source, len(said) + 1) == said + b"2"
    assert source.n_connected == 2
    thread.join()
    source.close()
    server.close()


def test_peer_that_is_slow_to_begin_does_not_hang(monkeypatch):
    monkeypatch.setattr(byte_sources, "SILENT", 0.3)
    server = socket.create_server(("127.0.0.1", 0))
    source = byte_sources.open_input(f"tcp:127.0.0.1:{server.getsockname()[1]}")
    assert source.receive() == []
    link, _ = server.accept()
    later = threading.Timer(1.0, link.sendall, (b"1",))
    later.start()
    assert drain(source, 1) == b"1"
    assert source.n_connected == 1
    later.join()
    for opened in (link, server, source):
        opened.close()


UNPLUGGED = """
import socket, subprocess, time
from inertiad.live import byte_sources
server = socket.create_server(("127.0.0.1", 5014))
source = byte_sources.open_input("tcp:127.0.0.1:5014")
link = server.accept()[0] if source.receive() == [] else None
link.sendall(b"1")
assert source.receive() == [(b"1", False)]
subprocess.run(["ip", "link", "set", "lo", "down"], check=True)
end = time.monotonic() + 0.8 * byte_sources.SILENT
while source.is_connected and time.monotonic() < end:
    source.receive()
assert not source.is_connected
"""


def test_pulled_plug_is_noticed_before_silence_is_taken_for_a_hang():
    command = [*ISOLATED, sys.executable, "-c", UNPLUGGED]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=TOP)
    assert result.returncode == 0, result.stderr


def test_serial_line():
    master, slave = os.openpty()
    source = byte_sources.open_input(f"serial:{os.ttyname(slave)}@115200")
    source.receive()
    os.write(master, b"1,2,3,4\n")
    assert drain(source, 8).strip() == b"1,2,3,4"
    source.close()


def test_full_disk_is_said_and_does_not_stop(tmp_path):
    writer = lcmlog.Writer(Path("/dev/full"))
    for _ in range(3000):
        writer.write(1, "A", bytes(1000))
    writer.close()
    assert writer.error == "No space left on device"
    assert writer.n_failed > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--from", "usb:1"], "--from usb:1: allowed: udp:"),
        (["--from", "udp:0"], "--from udp:0: port: allowed: 1 to 65535"),
        (["--from", "udp:5020", "--format", "nmea"], "--format nmea: allowed: text"),
        (["--from", "udp:5020", "--natnet-version", "9"], "--natnet-version 9: allowed: 2.6"),
        (["--from", "udp:5020", "--columns", "x,y"], "--columns x,y: allowed: x, y, z"),
        (["--from", "udp:5020", "--format", "struct", "--struct", "<3d"], "--struct <3d: 3 values: allowed: 4"),
    ],
)
def test_unusable_options_are_one_line_and_exit_2(inertiactl, tmp_path, options, message):
    result = inertiactl("record", *options, "-o", tmp_path / "run")
    assert result.returncode == 2
    assert message in result.stderr and len(result.stderr.splitlines()) == 1
