# SPDX-License-Identifier: Apache-2.0
"""Files of any bytes: each reader takes them or refuses them with messages of one line, never with a traceback."""

import contextlib
import shutil
from collections.abc import Callable
from pathlib import Path

import foreign_recordings as recorded
import numpy as np
import pytest
from conftest import COGIRO
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from inertiad.base.error import InputError
from inertiad.exchange import channels, foreign_import
from inertiad.robot import description
from inertiad.run import canlog, lcmlog, signals_csv, tracker_csv
from inertiad_lcm import can_frame_t, raw_t

ROBOT = description.load(COGIRO / "robot.toml")
RAW = b"INERTIAD_RAW"
WORDS = (
    *(b"", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\n", b"\r", b'"', b"'", b",", b";", b"=", b"#", b"[", b"]", b"{}"),
    *(b"nan", b"inf", b"-1", b"1e999", b"-0", b"9" * 40, b"0x1", b"true", b"\xed\xa0\x80", b"\x1b[31m", b"[[cable]]\n"),
    *(b"\n[imu]\n", b'base = "robot.toml"\n', b"(1.0) can0 123#00\n", b"\xed\xa1\xda\x01", b"t,x,y,z\n"),
)

edits = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.integers(0, 40), st.one_of(st.sampled_from(WORDS), st.binary(max_size=12))),
    min_size=1,
    max_size=4,
)
"""places as shares of the file; bytes that go from there; bytes that come"""


def edited(whole: bytes, changes: list[tuple[float, int, bytes]]) -> bytes:
    for share, n_gone, new in changes:
        at = int(share * len(whole))
        whole = whole[:at] + new + whole[at + n_gone :]
    return whole


def take(read: Callable[[Path], object], path: Path, content: bytes) -> None:
    path.write_bytes(content)
    try:
        read(path)
    except InputError as error:
        assert error.lines and all(line and "\n" not in line for line in error.lines), error.lines


def text(n_rows: int, header: str, *columns: str) -> bytes:
    rows = (",".join((f"{0.01 * k:.3f}", *columns)) for k in range(n_rows))
    return "\n".join((header, *rows, "")).encode()


MAPPING = b'[channels]\nacc_x = { channel = "ax", unit = "g", scale = -1.0, offset = 0.1 }\n'
CANDUMP = b"".join(b"(1.%06d) can0 %03X#00112233445566%02X\n" % (100 * k, 16 + k % 8, k) for k in range(40))
SIGNALS = signals_csv.columns(ROBOT)


def lcm_log() -> bytes:
    """RAW messages as other programs log them, without checksums, so that damaged ones reach the decoder."""
    log = b""
    for k in range(20):
        block = raw_t()
        for i in range(3):
            frame = can_frame_t()
            frame.t_ns, frame.can_id, frame.length, frame.data = (
                10**9 + 1000 * (3 * k + i),
                16 + i,
                8,
                bytes([k, i] * 4),
            )
            block.frame.append(frame)
        block.n_frames, block.sequence = 3, k
        data = block.encode()
        log += lcmlog.HEAD.pack(lcmlog.SYNC, k, 1000 * k, len(RAW), len(data)) + RAW + data
    return log


TEXTS: dict[str, tuple[str, bytes, Callable[[Path], object]]] = {
    "robot": ("robot.toml", (COGIRO / "robot.toml").read_bytes(), description.load),
    "mapping": ("x.map.toml", MAPPING, channels.read_mapping),
    "candump": ("can.log", CANDUMP, canlog.read),
    "lcm log as frames": ("run.lcmlog", lcm_log(), canlog.read),
    "tracker": ("tracker.csv", text(20, "t,x,y,z", "1", "2.5", "-3e-1"), tracker_csv.read),
    "signals": (
        "signals.csv",
        text(20, ",".join(SIGNALS), *["0.5"] * (len(SIGNALS) - 1)),  # four of them are a quaternion
        lambda p: signals_csv.read(p, ROBOT),
    ),
    "foreign table": ("log.csv", text(40, "Time,ax [g],ay,f_1 [kN]", "0.1", "-2", "3"), channels.summary),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """With what robot.toml refers to."""
    made = tmp_path_factory.mktemp("any")
    shutil.copytree(COGIRO, made / "x")
    return made / "x"


@pytest.mark.parametrize("kind", TEXTS)
def test_a_text_is_of_use_before_it_is_edited(folder: Path, kind: str):
    name, whole, read = TEXTS[kind]
    (folder / f"whole_{name}").write_bytes(whole)
    read(folder / f"whole_{name}")


@pytest.mark.parametrize("kind", TEXTS)
@settings(max_examples=60, deadline=None)
@given(changes=edits)
def test_an_edited_text_is_taken_or_refused_in_lines(folder: Path, kind: str, changes):
    name, whole, read = TEXTS[kind]
    take(read, folder / f"edited_{name}", edited(whole, changes))


@settings(max_examples=60, deadline=None)
@given(changes=edits)
def test_an_edited_import_is_taken_or_refused_in_lines(folder: Path, changes):
    def read(path: Path) -> None:
        shutil.rmtree(folder / "run", ignore_errors=True)
        foreign_import.import_mapped(path, folder / "run", None, None, [])

    whole = text(40, "Time,acc_x [g],acc_y,acc_z,gyro_x,gyro_y,gyro_z,f_1,f_2", *["0.1"] * 8)
    take(read, folder / "log.csv", edited(whole, changes))


@settings(max_examples=100, deadline=None)
@given(changes=edits)
def test_an_edited_log_gives_messages_that_were_in_it_or_says_so(folder: Path, changes):
    path = folder / "run.lcmlog"
    path.unlink(missing_ok=True)
    with contextlib.closing(lcmlog.Writer(path)) as writer:
        for k in range(30):
            writer.write(10 * k, "INERTIAD_RAW", bytes([k]) * k)
    written = {event.data for event in lcmlog.read(path)}
    assert len(written) == 30
    path.write_bytes(edited(path.read_bytes(), changes))
    remarks: list[str] = []
    found = {event.data for event in lcmlog.read(path, remarks)}
    assert found <= written or remarks
    assert all("\n" not in line for line in remarks)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> dict[str, Path]:
    kinds = ("parquet", "mat5", "mcap-json")
    return {k: recorded.KINDS[k][1](tmp_path_factory.mktemp(k) / recorded.KINDS[k][0]) for k in kinds}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["parquet", "mat5", "mcap-json"])
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(changes=edits)
def test_an_edited_recording_is_taken_or_refused_in_lines(
    recordings: dict[str, Path], folder: Path, kind: str, changes
):
    def read(path: Path) -> None:
        with np.errstate(all="ignore"):
            found = channels.summary(path)
            channels.mapped(path, found, channels.proposed_mapping(path, found))

    path = recordings[kind]
    take(read, folder / path.name, edited(path.read_bytes(), changes))
