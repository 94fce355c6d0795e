# SPDX-License-Identifier: Apache-2.0
"""CAN logs of every format as arrays, whole and damaged; LCM logs up to their first damage."""

import contextlib
import subprocess
import sys
from pathlib import Path

import can
import lcm
import numpy as np
import pytest

from inertiad.base.error import InputError
from inertiad.run import canlog, lcmlog
from inertiad_lcm import can_frame_t, raw_t

DBC = Path(__file__).parents[2] / "firmware/robots/cogiro/platform.dbc"
LINES = """\
(0000000001.000119) can1 010#0011223344556677
(0000000001.000250) can0 12345678#F802
(0000000001.000376) can0 013#R
(0000000001.000448) can0 7FF##1112233445566778899AABBCC
(0000000001.000557) can1 013#R5
(0000000001.000600) can0 20000004#0001000000000000
"""
DROPS = "DROPCOUNT: dropped 7 CAN frames on 'can0' socket (total drops 7)\n"


def test_candump_lines_come_back_as_they_were(tmp_path: Path):
    (tmp_path / "can.log").write_text(LINES)
    log = canlog.read(tmp_path / "can.log")
    assert log.names == ("can0", "can1")
    assert log.bus.tolist() == [1, 0, 0, 0, 1, 0]
    assert log.data.shape == (6, 64)
    assert b"".join(canlog.lines(log)).decode() == LINES


def test_interface_name_that_is_no_text_is_read(tmp_path: Path):
    (tmp_path / "can.log").write_bytes(b"(1.0) c\x80n0 123#00\n")
    assert canlog.read(tmp_path / "can.log").names == ("c\N{REPLACEMENT CHARACTER}n0",)


def test_wire_is_what_socketcan_takes(tmp_path: Path):
    (tmp_path / "can.log").write_text(LINES)
    data, begin = canlog.wire(canlog.read(tmp_path / "can.log"))
    assert np.diff(begin).tolist() == [16, 16, 16, 72, 16, 16]
    extended, fd = bytes(data[begin[1] : begin[2]]), bytes(data[begin[3] : begin[4]])
    assert extended == bytes.fromhex("78563492 02000000 F802000000000000")
    assert fd[4:8] == bytes([12, 1, 0, 0])


def test_damaged_lines_are_counted_and_said(tmp_path: Path):
    (tmp_path / "can.log").write_text(LINES + "nonsense\n" + DROPS + "(00000000")
    log = canlog.read(tmp_path / "can.log")
    assert len(log) == 6 and log.n_damaged == 2
    assert "2 lines left out, the first: 7" in log.remarks[0]
    assert "7 lost frames" in log.remarks[1]


def messages() -> list[can.Message]:
    return [
        can.Message(timestamp=100.0 + 0.001 * k, arbitration_id=0x10 + k % 3, is_extended_id=False, channel=0,
                    data=bytes([k, 255 - k] * 4), is_rx=True)
        for k in range(20)
    ]  # fmt: skip


@pytest.mark.parametrize("ending", ["asc", "blf", "trc", "mf4"])
def test_formats_of_other_tools(tmp_path: Path, ending: str):
    path = tmp_path / f"can.{ending}"
    with can.Logger(path) as writer:
        for message in messages():
            writer(message)
    log = canlog.read(path)
    assert log.can_id.tolist() == [m.arbitration_id for m in messages()]
    assert [bytes(d) for d in log.data] == [bytes(m.data) for m in messages()]
    assert np.diff(log.t_ns) == pytest.approx(1e6, abs=2e3)


IN_A_PROCESS_OF_ITS_OWN = """
import sys
from pathlib import Path
from inertiad.robot import dbc
from inertiad.run import canlog
dbc.load([Path(sys.argv[1])])
print("pandas" in sys.modules, len(canlog.read(Path(sys.argv[2]))))
"""


def test_a_dbc_does_not_wait_for_mf4_which_is_read_afterwards(tmp_path: Path):
    path = tmp_path / "can.mf4"
    with can.Logger(path) as writer:
        for message in messages():
            writer(message)
    done = subprocess.run(
        [sys.executable, "-c", IN_A_PROCESS_OF_ITS_OWN, str(DBC), str(path)], capture_output=True, text=True
    )
    assert (done.stdout, done.stderr) == ("False 20\n", "")


def raw_message(k: int) -> raw_t:
    block = raw_t()
    for i in range(3):
        frame = can_frame_t()
        frame.t_ns, frame.can_id, frame.length = 10**9 + 1000 * (3 * k + i), 0x10 + i, 8
        frame.data = bytes([k, i] * 4)
        block.frame.append(frame)
    block.n_frames, block.sequence = 3, k
    return block


def lcm_log(path: Path) -> Path:
    log = lcm.EventLog(str(path), "w", overwrite=True)
    for k in range(10):
        log.write_event(1000 * k, "INERTIAD_RAW", raw_message(k).encode())
    log.close()
    return path


def test_lcm_log_is_read_to_its_damage(tmp_path: Path):
    path = lcm_log(tmp_path / "run.lcmlog")
    assert len(canlog.read(path)) == 30
    path.write_bytes(path.read_bytes()[:-40])
    log = canlog.read(path)
    assert len(log) == 27
    assert "cut off in the middle of a record; 9 messages" in log.remarks[0]


def test_frames_of_no_length_in_an_lcm_log_are_left_out_and_said(tmp_path: Path):
    good, bad = raw_message(0), raw_message(1)
    data = bytearray(bad.encode())
    data[-9] = 0xFF  # the last frame's length, -1
    with contextlib.closing(lcmlog.Writer(tmp_path / "run.lcmlog")) as log:
        log.write(0, "INERTIAD_RAW", good.encode())
        log.write(1, "INERTIAD_RAW", bytes(data))
    found = canlog.read(tmp_path / "run.lcmlog")
    assert len(found) == 5
    assert found.remarks[0].endswith("1 frames of INERTIAD_RAW left out: their length is not 0 to 64")


def test_lcm_log_of_other_types_is_refused(tmp_path: Path):
    path = lcm_log(tmp_path / "run.lcmlog")
    data = bytearray(path.read_bytes())
    data[lcmlog.HEAD.size + len("INERTIAD_RAW")] ^= 1  # the type's fingerprint
    path.write_bytes(data)
    with pytest.raises(InputError, match="is no raw_t of this version"):
        canlog.read(path)


def test_writer_makes_what_lcm_reads(tmp_path: Path):
    writer = lcmlog.Writer(tmp_path / "run.lcmlog")
    writer.write(17, "A", b"one")
    writer.write(18, "B", b"")
    writer.close()
    events = [(e.timestamp, e.channel, e.data) for e in lcm.EventLog(str(tmp_path / "run.lcmlog"), "r")]
    assert events[:2] == [(17, "A", b"one"), (18, "B", b"")]
    assert [channel for _, channel, _ in events[2:]] == ["INERTIAD_CHECK"]  # the checksum, an event like any other


@pytest.mark.parametrize("name", ["can.xyz", "nowhere.log", "empty.log"])
def test_unusable_log_is_one_line(tmp_path: Path, name: str):
    for given in ("can.xyz", "empty.log"):
        (tmp_path / given).write_text("")
    with pytest.raises(InputError, match=rf"^[^\n]*{name}: [^\n]+$"):
        canlog.read(tmp_path / name)
