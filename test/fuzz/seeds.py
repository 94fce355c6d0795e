#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Write the inputs that fuzzing begins with into test/fuzz/corpus/. Names say what is in them.

The other files there, found_*, were made up by libFuzzer: inputs that failed once, or that reach code of their own.
"""

import re
import struct
import zlib
from pathlib import Path

HERE = Path(__file__).resolve().parent

CANDUMP = {
    "classical": "(1436509052.249713) can0 123#0011223344556677\n(1436509052.25) vcan1 12345678#00\n",
    "fd": "(1.5) can0 123##1" + "AB" * 64 + "\n(1.6) can0 00000010##0\n",
    "remote": "(1.0) can0 123#R\n(1.1) can0 123#R5\n(1.2) can0 123#R9\n",
    "raw_length": "(1.0) can0 7FF#0011223344556677_9\n(1.0) can0 7FF#0011223344556677_F\n",
    "error_frame": "(1.0) can0 20000004#0004000000000000\n",
    "drops": "DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 17)\n(1.0) can0 123#00\n",
    "comments": "# a comment\n; another\n\n(1.0) can0 123#00 R\n(1.0) can0 123#00 T\r\n",
    "bad_lines": "(x) can0 123#00\n(1.0)\n(1.0) can0 8FF#00\n(1.0) can0 123#0\n(1.0) can0 123#00 X\n(1.0) "
    + "n" * 20
    + " 1#\n",
    "stray_stamp": "(1.0) can0 123#00\n(900.0) can0 123#01\n(1.1) can0 123#02\n",
    "stamps_at_limits": "(8999999999.999999999) can0 123#00\n(9000000000.0) can0 123#00\n(0.000000001) can0 123#00\n",
    "long_line": "(1.0) can0 123##1" + "0" * 4100 + "\n(1.0) can0 123#00\n",
    "unended": "(1.0) can0 123#0011",
    "lock_step": "position 1000123000 0.1 -0.2 2e0\nanswer\n(1.0) can7 123#00\nposition 1\nposition x\n",
    "lock_step_commands": "command 00\ncommand 0\ncommand 0g\ncommand {}\nanswer\n".format("ab" * 1025),
    "empty": "",
}

TRACKER_FILE = {
    "plain": "t,x,y,z\n0.0,1,2,3\n0.01,1.1,2.1,3.1\n",
    "rows_only": "0.0,1,2,3\n0.01,1.1,2.1,3.1\n",
    "other_columns": '\ufeffz,status,"t", y ,x\r\n3,ok,0.5,2,1\r\n-3e0,,1.25, -2.5 ,1\r\n',
    "stamps": "1436509052.249713001,0,0,0\n1436509052.,0,0,0\n1.5e3,0,0,0\n-1,0,0,0\n",
    "stamps_at_limits": "8999999999.9,0,0,0\n9000000000,0,0,0\n0,0,0,0\n",
    "bad_cells": "1,2,3\n1,2,three,4\n,1,2,3\nnan,1,2,3\n1e300,1,2,3\n1,inf,-nan,0x1p3\n",
    "stray_time": "1,1,0,0\n900,2,0,0\n1.1,3,0,0\n",
    "column_twice": "t,x,y,z,x\n1,2,3,4,5\n",
    "column_missing": "t,x,z\n1,2,3\n",
    "long_cell": "1," + "9" * 400 + ",0,0\n" + "1" * 60 + ".5,0,0,0\n",
    "many_cells": "," * 300 + "\n1,2,3,4" + ",5" * 300 + "\n",
    "unended": "8,1,2",
    "empty": "",
}

URL = {
    "file": "\0file:can.log?speed=1&interface=can0",
    "socketcan": "\0socketcan:can0?filter=off",
    "five_options": "\0file:x?a=1&b=2&a=3&b=4&a=5",
    "unknown_option": "\0file:x?c=1",
    "no_value": "\0file:x?a",
    "no_path": "\0file:?a=1",
    "no_scheme": "\0can.log",
    "group": "\1udpm://239.255.76.67:7667?ttl=0",
    "default_group": "\1udpm://",
    "bad_port": "\1udpm://239.255.76.67:99999999999999999999",
    "bad_address": "\1udpm://999.255.76.67:7667",
    "long_address": "\1udpm://" + "1" * 40,
}


def f64(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}d", *values)


def patches(*pairs: tuple[int, bytes]) -> bytes:
    """What patch() of fuzz.h reads."""
    return b"".join(struct.pack("<H", at) + value[:8].ljust(8, b"\0") for at, value in pairs)


def big(value: float) -> bytes:
    return struct.pack(">d", value)


# The hash takes 8 bytes, the name 64, gravity 8, n_cables 4; a cable has 92.
NAME, GRAVITY, N_CABLES, CABLE = 8, 72, 80, 84
CONFIG = {
    "unchanged": b"",
    "gravity_zero": patches((GRAVITY, big(0.0))),
    "gravity_nan": patches((GRAVITY, big(float("nan")))),
    "gravity_huge": patches((GRAVITY, big(1e300))),
    "no_cable": patches((N_CABLES, struct.pack(">iI", 0, 0xC01CC955))),
    "too_many_cables": patches((N_CABLES, struct.pack(">iI", 17, 0xC01CC955))),
    "negative_cables": patches((N_CABLES, struct.pack(">iI", -1, 0xC01CC955))),
    "anchor_moved": patches((CABLE, big(3.0)), (CABLE + 92, big(-3.0))),
    "anchor_at_attachment": patches((CABLE, big(0.5032)), (CABLE + 8, big(-0.4928)), (CABLE + 16, big(0.0))),
    "pulley_huge": patches((CABLE + 48, big(1e9))),
    "axis_not_unit": patches((CABLE + 56, big(1.0))),
    "name_without_end": patches(*[(NAME + 8 * i, b"xxxxxxxx") for i in range(8)]),
    "name_of_controls": patches((NAME, b"\x1b[31m\x00\xff\xfe\x9b")),
    "raw_short": b"\xff" + bytes(11),
    "raw_hash_only": b"\xff" + bytes(12),
    "raw_zeros": b"\xff" + bytes(400),
}

FIELDS = re.findall(r"^ +FIELD\(([\w.]+)\),", (HERE / "fuzz_checkpoint.c").read_text(), re.M)
"""names of the checkpoint's fields, which the target finds by offsetof: no place in the file is known here"""
FILE, FILE_BAD_CRC, CUT, RAW_FILE = b"\0", b"\1", b"\2", b"\3"
ONES = b"\xff" * 8


def place(field: str, byte: int = 0) -> bytes:
    """A byte of a field; negative: from its end."""
    return struct.pack("<Hh", zlib.crc32(FIELDS[FIELDS.index(field)].encode()) & 0xFFFF, byte)


def put(field: str, value: bytes, byte: int = 0) -> bytes:
    """The field holds other bytes, 8 or as many as it has."""
    return place(field, byte) + value[:8].ljust(8, b"\0")


def flags(value: int) -> dict[str, bytes]:
    """One flag each that is no bool."""
    names = ("observable", "consistent", "is_misfit", "is_provisional")
    return {
        f"{name}_of_{value}": FILE + put(f"estimator.{path}", bytes([value]), -1)
        for name, path in {
            "has_patterns": "filter_states.has_patterns",
            **{name: f"estimate.{name}" for name in names},
        }.items()
    }


def numbers(value: float) -> dict[str, bytes]:
    """Doubles, first and last of a field, that the reader may take as they are: then the estimator must bear them."""
    names = ("rls.x", "rls.D", "rls.U", "noise.sum", "noise.L", "change_detector.level", "change_detector.cusum")
    names += ("change_detector.contest_square", "change_detector.step.information", "pose_dwell.R", "force_delay")
    names += ("misfit_score.before", "restored", "estimate.theta", "estimate.covariance", "estimate.body")
    paths = [f"estimator.{name}" for name in names] + ["gyro_bias", "period"]
    return {
        f"{value:g}_in_{path.removeprefix('estimator.')}": FILE + put(path, f64(value)) + put(path, f64(value), -8)
        for path in paths
    }


CHECKPOINT = {
    "unchanged": FILE,
    "wrong_bit": FILE_BAD_CRC + put("estimator.rls.U", b"\1"),
    **{f"ones_in_{path.removeprefix('estimator.')}": FILE + put(path, ONES) for path in FIELDS},
    **{f"ones_at_the_end_of_{name}": FILE + put(f"estimator.{name}", ONES, -8) for name in ("rls.U", "noise.past")},
    **flags(223),
    **flags(2),
    **numbers(0.0),
    **numbers(-1.0),
    **numbers(1e-300),
    **numbers(1e300),
    "cut_at_0": CUT + place("magic"),
    "cut_in_magic": CUT + place("magic", 5),
    "cut_at_fingerprint": CUT + place("fingerprint"),
    "cut_in_the_middle": CUT + place("estimator.rls.U", -8),
    "cut_in_crc": CUT + place("period", 10),
    "raw_magic": RAW_FILE + b"ipe-chk",
}

RAW, CHANNEL_TRACKER, CHANNEL_COMMAND, TRACKER, COMMAND, CONFIGURE = range(6)


def datagram(kind: int, data: bytes) -> bytes:
    return struct.pack("<BH", kind, len(data)) + data


def tracker_message(t_ns: int, valid: int = 1, position: tuple[float, float, float] = (0.1, 0.2, 2.0)) -> bytes:
    return struct.pack(">qqqb3db4dq", 1, t_ns, 0, valid, *position, 0, 1, 0, 0, 0, 0)


def command_message(
    kind: int, text: bytes = b"\0", config: bytes = b"", sequence: int = 1, t_ns: int = 200_000_000_000
) -> bytes:
    body = struct.pack(">qqqbI", sequence, t_ns, 7, kind, len(text)) + text
    return body + struct.pack(">I", len(config)) + config


def expectation_numbers(t_ns: int, mass: float, mass_std: float) -> bytes:
    """An expectation_t without its hash."""
    return struct.pack(">q20d", t_ns, mass, mass_std, *[0.1] * 3, *[0.01] * 3, *[1.0] * 3, *[0.0] * 3, *[0.1] * 6)


INBOX = {
    "position": datagram(TRACKER, tracker_message(10**9)),
    "position_invalid": datagram(TRACKER, tracker_message(10**9, valid=0)),
    "position_before_0": datagram(TRACKER, tracker_message(-1)),
    "position_too_late": datagram(TRACKER, tracker_message(2**63 - 1)),
    "position_nan": datagram(TRACKER, tracker_message(10**9, position=(float("nan"), float("inf"), -1e308))),
    "position_cut": datagram(TRACKER, tracker_message(10**9)[:40]),
    "position_other_version": datagram(CHANNEL_TRACKER, bytes(8) + tracker_message(10**9)),
    "freeze": datagram(COMMAND, command_message(1)),
    "all_kinds": b"".join(datagram(COMMAND, command_message(k, sequence=k)) for k in range(-1, 8)),
    "repeated": 3 * datagram(COMMAND, command_message(3)),
    "old_and_ahead": b"".join(datagram(COMMAND, command_message(3, t_ns=t)) for t in (0, -(2**63), 2**63 - 1)),
    "from_before_the_start": datagram(COMMAND, command_message(3, t_ns=194_000_000_000)),
    "expect": datagram(COMMAND, command_message(7, config=expectation_numbers(2 * 10**11, 30.0, 1.0))),
    "expect_set_down": datagram(COMMAND, command_message(7, config=expectation_numbers(2 * 10**11, -30.0, 1.0))),
    "expect_nan": datagram(COMMAND, command_message(7, config=expectation_numbers(2 * 10**11, float("nan"), 1.0))),
    "expect_before_0": datagram(COMMAND, command_message(7, config=expectation_numbers(-(2**63), 30.0, 1.0))),
    "expect_cut": datagram(COMMAND, command_message(7, config=expectation_numbers(2 * 10**11, 30.0, 1.0)[:-1])),
    "mark": datagram(COMMAND, command_message(6, b"payload on\0")),
    "text_without_end": datagram(COMMAND, command_message(6, b"payload on")),
    "text_of_no_bytes": datagram(COMMAND, command_message(6, b"")),
    "text_longer_than_message": datagram(COMMAND, struct.pack(">qqqbI", 1, 0, 7, 6, 2**32 - 1) + b"x\0"),
    "config_longer_than_message": datagram(COMMAND, command_message(5)[:-4] + struct.pack(">I", 2**31)),
    "config_of_zeros": datagram(COMMAND, command_message(5, config=bytes(64))),
    "configure": datagram(CONFIGURE, b""),
    "configure_patched": datagram(CONFIGURE, patches((GRAVITY, big(float("nan"))))),
    "no_magic": datagram(RAW, b"LC03" + bytes(20)),
    "fragment": datagram(RAW, b"LC03" + bytes(4) + struct.pack(">IIIHH", 1, 100000, 0, 0, 2) + b"INERTIAD_COMMAND\0"),
    "channel_without_end": datagram(RAW, b"LC02\0\0\0\1INERTIAD_TRACKER"),
    "other_channel": datagram(RAW, b"LC02\0\0\0\1INERTIAD_TRACKER2\0" + bytes(20)),
    "empty_datagram": datagram(RAW, b""),
}

FRAME, POSITION, SAMPLES, PATCHED, JUMP, SHIFT, COMMANDED = range(7)
COLD, WARM, NARROW, FUSED = range(4)


def raw_frame(which: int, length: int, data: bytes, dt_us: int = 500) -> bytes:
    return struct.pack("<BBBH", FRAME, which, length, dt_us) + data[: length % 65].ljust(length % 65, b"\0")


def samples(n: int) -> bytes:
    return bytes([SAMPLES, n // 4])


def patched(n: int, which: int, value: float) -> bytes:
    """n samples; which: 0 acceleration, 3 rate, 6 quaternion, 10 position, 13 forces."""
    return bytes([PATCHED, n, which]) + f64(value)


def jump(t_ns: int) -> bytes:
    return bytes([JUMP]) + struct.pack("<q", t_ns)


def shift(ms: float) -> bytes:
    return bytes([SHIFT]) + struct.pack("<h", int(100 * ms))


def command(kind: int) -> bytes:
    return bytes([COMMANDED, kind])


def expect(which: int, value: float, in_ms: int = 0) -> bytes:
    """A payload is announced; which: number of expectation_t that is replaced, 255: none."""
    return bytes([COMMANDED, 0xF0, which]) + struct.pack("<H", in_ms) + (f64(value) if which < 20 else b"")


FRAMES = {
    "warm_goes_on": bytes([WARM]) + samples(400),
    "fused_goes_on": bytes([FUSED]) + samples(400),
    "cold_start": bytes([COLD]) + samples(1000),
    "narrow": bytes([NARROW])
    + b"".join(raw_frame(3 + i % 4, 8, bytes([1 + i % 2, i, 0, 9, 1, 0, 3, i])) for i in range(40)),
    "nan_acceleration": bytes([WARM]) + patched(5, 0, float("nan")) + samples(200),
    "huge_force": bytes([WARM]) + patched(5, 13, 1e300) + samples(200),
    "negative_force": bytes([FUSED]) + patched(15, 14, -500.0) + samples(200),
    "spikes": bytes([FUSED]) + (patched(1, 15, 4000.0) + samples(40)) * 6,
    "huge_position": bytes([FUSED]) + patched(3, 10, 1e200) + samples(200),
    "quaternion_zero": bytes([WARM]) + patched(2, 6, 0.0) + patched(2, 7, 1e-200) + samples(100),
    "held_force": bytes([FUSED]) + patched(15, 13, 1000.0) * 14 + samples(200),
    "clock_back": bytes([WARM]) + samples(40) + shift(-300) + samples(100),
    "clock_ahead": bytes([WARM]) + samples(40) + shift(300) + samples(100),
    "gap": bytes([FUSED]) + samples(40) + shift(300) * 5 + samples(100),
    "stamp_at_limits": bytes([WARM])
    + jump(0)
    + samples(20)
    + jump(8_999_999_999 * 10**9)
    + samples(20)
    + jump(-1)
    + samples(20),
    "remote_and_error": bytes([WARM]) + raw_frame(0x40, 8, b"") + raw_frame(0x80, 8, b"\4") + raw_frame(0x83, 200, b""),
    "wrong_lengths": bytes([WARM]) + b"".join(raw_frame(0, n, b"\xff" * 64) for n in (0, 1, 8, 48, 63, 64)),
    "positions": bytes([FUSED])
    + b"".join(bytes([POSITION, 0, 0]) + f64(x, 0.0, 2.0) for x in (0.0, 1e9, float("nan"))),
    "commands": bytes([FUSED]) + b"".join(command(k) + samples(60) for k in range(6)),
    "expect_and_push": bytes([FUSED]) + samples(200) + expect(255, 0.0) + patched(15, 14, 1500.0) * 8 + samples(200),
    "expect_odd": bytes([WARM])
    + b"".join(expect(k, float("nan")) + expect(k, -1e300) for k in range(20))
    + samples(60),
    "flush_and_on": bytes([WARM]) + command(5) + samples(60) + command(5) + samples(60),
}

ALL = {
    "candump": CANDUMP,
    "tracker_file": TRACKER_FILE,
    "url": URL,
    "config": CONFIG,
    "checkpoint": CHECKPOINT,
    "inbox": INBOX,
    "frames": FRAMES,
}


def write(corpus: Path) -> None:
    """All inputs below corpus, one folder for each target; those of another name are left."""
    for target, inputs in ALL.items():
        (corpus / target).mkdir(parents=True, exist_ok=True)
        for name, content in inputs.items():
            (corpus / target / name).write_bytes(content.encode() if isinstance(content, str) else content)


if __name__ == "__main__":
    write(HERE / "corpus")
