# SPDX-License-Identifier: Apache-2.0
"""Protocols of position instruments: bytes to samples, and samples to bytes for tests without the instrument.

=================  =========================================================================  ===================
format             example                                                                    device time
=================  =========================================================================  ===================
text               ``12.004,0.5,1.5,2.5`` with columns t,x,y,z                                column t
struct             ``<Id3d`` with columns frame,t,x,y,z                                       column t
spatialanalyzer    ``X, 500.0 | Y, 1500.0 | Z, 2500.0 | Units: (mm)``                         none
emscon             little-endian: i32 size, i32 type 3, i32 count, i32 mode, 3 doubles,       t1 s + t2 us, where
                   count times i32 status, i32 t1, i32 t2, 3 doubles [mm]                     not both are 0
dtrack             ``fr 17``, ``ts 39600.004``, ``6d 1 [0 1.000][500 1500 2500 0 0 0][...]``  s since midnight UTC
natnet             u16 7, u16 size, frame of mocap data as Motive sends it, m, one datagram   s since its start
=================  =========================================================================  ===================

Device time is checked against the host's: one that runs at another rate is refused (record.py). That matters for
emscon, whose t1 and t2 are not documented publicly; --no-device-time leaves it out. natnet is read by the package of
that name, for the protocol of --natnet-version; multicast by --from udp:239.255.42.99:1511.

dtrack, natnet, and text and struct with columns q_w,q_x,q_y,q_z are poses: attitude as a unit quaternion, from the axes
of the body as the instrument's software has it to its world. Both must be those of the robot description, its body's
axes the platform's: convert other axes in the instrument (Motive: streaming with Z up).
"""

import math
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from inertiad.base.error import InputError

FORMATS: Final = ("text", "struct", "spatialanalyzer", "emscon", "dtrack", "natnet")
ATTITUDE: Final = ("q_w", "q_x", "q_y", "q_z")
COLUMNS: Final = ("x", "y", "z", *ATTITUDE, "t", "frame", "valid", "-")
LENGTH: Final = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
TIME: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
DAY: Final = 86400.0
UNIT: Final = 0.1
"""by which a quaternion's length, or a rotation matrix times its transpose, may miss 1"""
LINE_MAX: Final = 100_000
"""bytes without a line end after which a stream is not text"""
EMSCON_HEAD: Final = struct.Struct("<ii")
EMSCON_MULTI: Final = struct.Struct("<ii3d")
EMSCON_POINT: Final = struct.Struct("<iii3d")
EMSCON_TYPE: Final = 3
EMSCON_MAX: Final = 1 << 20
NATNET_HEAD: Final = struct.Struct("<HH")
NATNET_FRAME: Final = 7
NATNET_VERSIONS: Final = ("2.6", "2.7", "2.9", "2.10", "2.11", "3.0", "3.1", "4.0", "4.1", "4.2")


@dataclass(frozen=True)
class Sample:
    """One measurement of the instrument."""

    position: tuple[float, float, float]
    """m"""
    t_device: float | None = None
    """s, the instrument's clock"""
    frame: int | None = None
    valid: bool = True
    q: tuple[float, float, float, float] | None = None
    """unit quaternion w x y z, body to world; None: the instrument has no attitude"""


@dataclass(frozen=True)
class Layout:
    """Layout of the bytes."""

    format: str = "text"
    columns: tuple[str, ...] = ("t", "x", "y", "z")
    separator: str = ","
    struct: str = ""
    """as Python's struct module: byte order, then one letter per column, x for pad bytes"""
    unit: str = "m"
    time_unit: str = "s"
    wrap: float = 0.0
    """s after which device time starts again; 0: never"""
    body: int | None = None
    """number of the body to take, dtrack and natnet; None: the first"""
    device_time: bool = True
    """False: the instrument's time is ignored"""
    natnet_version: str = "4.1"
    """protocol that Motive is set to"""

    def check(self) -> None:
        """InputError names the option."""
        if self.format not in FORMATS:
            raise InputError(f"--format {self.format}: allowed: {', '.join(FORMATS)}")
        unknown = [c for c in self.columns if c not in COLUMNS]
        if unknown or not {"x", "y", "z"} <= set(self.columns):
            raise InputError(
                f"--columns {','.join(self.columns)}: allowed: x, y, z and any of {', '.join(COLUMNS[3:])}"
            )
        if 0 < len(set(ATTITUDE) & set(self.columns)) < len(ATTITUDE):
            raise InputError(f"--columns {','.join(self.columns)}: allowed: all of {', '.join(ATTITUDE)}, or none")
        if self.unit not in LENGTH or self.time_unit not in TIME:
            raise InputError(f"--unit: allowed: {', '.join(LENGTH)}; --time-unit: {', '.join(TIME)}")
        if self.natnet_version not in NATNET_VERSIONS:
            raise InputError(f"--natnet-version {self.natnet_version}: allowed: {', '.join(NATNET_VERSIONS)}")
        if self.format == "struct":
            self._check_struct()

    def _check_struct(self) -> None:
        try:
            n = len(struct.unpack(self.struct, bytes(struct.calcsize(self.struct))))
        except struct.error as error:
            raise InputError(f"--struct {self.struct}: {error}: allowed: such as <Id3d") from None
        if n != len(self.columns):
            raise InputError(f"--struct {self.struct}: {n} values: allowed: {len(self.columns)}, one per column")

    @property
    def has_attitude(self) -> bool:
        """True: valid samples are poses."""
        return self.format in ("dtrack", "natnet") or (
            self.format in ("text", "struct") and set(ATTITUDE) <= set(self.columns)
        )

    @property
    def time_wrap(self) -> float:
        """s, 0: never."""
        return DAY if self.format == "dtrack" and not self.wrap else self.wrap


def _quaternion(q: list[float]) -> tuple[float, float, float, float]:
    """Normalised. ValueError: its length is not 1 +- 0.1."""
    norm = math.hypot(*q)
    if not abs(norm - 1.0) < UNIT:
        raise ValueError(f"attitude of length {norm:.3g}")
    w, x, y, z = (v / norm for v in q)
    return w, x, y, z


def _of_columns(b: list[float]) -> tuple[float, float, float, float]:
    """Quaternion of a rotation matrix given column by column. ValueError: it is none."""
    R = np.array(b).reshape(3, 3).T
    if not np.abs(R @ R.T - np.eye(3)).max() < UNIT or np.linalg.det(R) < 0.0:
        raise ValueError("not a rotation matrix")
    return _quaternion(Rotation.from_matrix(R).as_quat(scalar_first=True).tolist())


class Parser:
    """Bytes to samples. Half packets wait for their rest; unreadable ones are counted, never fatal."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.n_bad = 0
        self.last_bad = ""
        self._rest = b""
        self._frame: int | None = None
        self._time: float | None = None
        takers: dict[str, Callable[[], list[Sample]]] = {
            "struct": self._structs,
            "emscon": self._emscon,
            "natnet": self._natnet,
        }
        self._take = takers.get(layout.format, self._lines)

    def feed(self, data: bytes) -> list[Sample]:
        """The samples that are complete with these bytes."""
        self._rest += data
        found = self._take()
        return found if self.layout.device_time else [replace(sample, t_device=None) for sample in found]

    def end(self) -> list[Sample]:
        """The end of a datagram or connection: the rest is a line without its end, or half a packet."""
        found: list[Sample] = []
        if self._rest and self._take == self._lines:
            found = self.feed(b"\n")
        elif self._rest:
            self._bad("half a packet")
        self._rest = b""
        return found

    def _bad(self, why: str) -> None:
        self.n_bad += 1
        self.last_bad = why

    # text ----------------------------------------------------------------------------------------

    def _lines(self) -> list[Sample]:
        *lines, self._rest = self._rest.replace(b"\r", b"\n").split(b"\n")
        if len(self._rest) > LINE_MAX:
            self._rest = b""
            self._bad("no line end")
        read = {"text": self._row, "spatialanalyzer": self._watch_window, "dtrack": self._dtrack}[self.layout.format]
        found = []
        for line in lines:
            text = line.decode("ascii", errors="replace").strip()
            try:
                sample = read(text) if text else None
            except (ValueError, IndexError):
                self._bad(text[:60])
                continue
            if sample is not None:
                found.append(sample)
        return found

    def _of(self, values: dict[str, float]) -> Sample:
        scale = LENGTH[self.layout.unit]
        x, y, z = (scale * values[a] for a in "xyz")
        t = values["t"] * TIME[self.layout.time_unit] if "t" in values else None
        frame = int(values["frame"]) if "frame" in values else None
        q = _quaternion([values[name] for name in ATTITUDE]) if ATTITUDE[0] in values else None
        return Sample((x, y, z), t, frame, bool(values.get("valid", 1.0)) and all(map(math.isfinite, (x, y, z))), q)

    def _row(self, text: str) -> Sample | None:
        if text.startswith("#"):
            return None
        separator = self.layout.separator
        cells = text.split() if separator in ("", " ") else text.split(separator)
        pairs = zip(self.layout.columns, cells, strict=False)
        values = {name: float(cell) for name, cell in pairs if name != "-"}
        if len(cells) < len(self.layout.columns):
            raise ValueError
        return self._of(values)

    def _watch_window(self, text: str) -> Sample | None:
        fields = dict(re.findall(r"\b([XYZ])\s*[,:]\s*([-+0-9.eE]+)", text))
        if not fields:
            return None
        unit = re.search(r"Units:\s*\(?([a-z]+)\)?", text)
        scale = LENGTH.get(unit.group(1) if unit else self.layout.unit)
        if scale is None or len(fields) < 3:
            raise ValueError
        return Sample((scale * float(fields["X"]), scale * float(fields["Y"]), scale * float(fields["Z"])))

    def _dtrack(self, text: str) -> Sample | None:
        word, _, rest = text.partition(" ")
        if word == "fr":
            self._frame, self._time = int(rest), None
        elif word == "ts":
            self._time = float(rest)
        elif word == "6d":
            return self._dtrack_body(rest)
        return None

    def _dtrack_body(self, rest: str) -> Sample | None:
        groups = [g.split() for g in re.findall(r"\[([^\]]*)\]", rest)]
        for head, place, turn in zip(groups[0::3], groups[1::3], groups[2::3], strict=True):
            if self.layout.body is None or int(head[0]) == self.layout.body:
                x, y, z = (1e-3 * float(v) for v in place[:3])
                valid = float(head[1]) >= 0.0
                q = _of_columns([float(v) for v in turn]) if valid else None
                return Sample((x, y, z), self._time, self._frame, valid, q)
        return Sample((0.0, 0.0, 0.0), self._time, self._frame, False)  # the body is not seen

    # binary --------------------------------------------------------------------------------------

    def _structs(self) -> list[Sample]:
        size = struct.calcsize(self.layout.struct)
        found = []
        while len(self._rest) >= size:
            values = struct.unpack(self.layout.struct, self._rest[:size])
            self._rest = self._rest[size:]
            found.append(self._of(dict(zip(self.layout.columns, values, strict=True))))
        return found

    def _emscon(self) -> list[Sample]:
        found: list[Sample] = []
        while len(self._rest) >= EMSCON_HEAD.size:
            size, kind = EMSCON_HEAD.unpack_from(self._rest)
            if not EMSCON_HEAD.size <= size <= EMSCON_MAX:
                self._bad(f"packet of {size} bytes")
                self._rest = b""
                break
            if len(self._rest) < size:
                break
            packet, self._rest = self._rest[EMSCON_HEAD.size : size], self._rest[size:]
            if kind == EMSCON_TYPE:
                found += self._emscon_points(packet)
        return found

    def _emscon_points(self, packet: bytes) -> list[Sample]:
        body = packet[EMSCON_MULTI.size :]
        n = EMSCON_MULTI.unpack_from(packet)[0] if len(packet) >= EMSCON_MULTI.size else -1
        if n < 0 or len(body) < n * EMSCON_POINT.size:
            self._bad("points cut off")
            return []
        points = [EMSCON_POINT.unpack_from(body, i * EMSCON_POINT.size) for i in range(n)]
        return [
            Sample((1e-3 * x, 1e-3 * y, 1e-3 * z), t1 + 1e-6 * t2 if t1 or t2 else None, valid=status == 0)
            for status, t1, t2, x, y, z in points
        ]

    def _natnet(self) -> list[Sample]:
        found: list[Sample] = []
        while len(self._rest) >= NATNET_HEAD.size:
            kind, size = NATNET_HEAD.unpack_from(self._rest)
            if len(self._rest) < NATNET_HEAD.size + size:
                break
            packet, self._rest = self._rest[NATNET_HEAD.size :][:size], self._rest[NATNET_HEAD.size + size :]
            if kind == NATNET_FRAME:
                found += self._natnet_frame(packet)
        return found

    def _natnet_frame(self, packet: bytes) -> list[Sample]:
        from natnet.data_frame import DataFrame
        from natnet.packet_buffer import PacketBuffer
        from natnet.version import Version

        try:
            version = Version(*map(int, self.layout.natnet_version.split(".")))
            frame: Any = DataFrame.read_from_buffer(PacketBuffer(packet), version)
        except (struct.error, ValueError, MemoryError) as error:
            self._bad(f"natnet {self.layout.natnet_version}: {error}; is --natnet-version right?")
            return []
        t, number = frame.suffix.timestamp, frame.prefix.frame_number
        for body in frame.rigid_bodies:
            if self.layout.body is None or body.id_num == self.layout.body:
                x, y, z, w = body.rot
                valid = bool(body.tracking_valid)
                try:
                    return [Sample(body.pos, t, number, valid, _quaternion([w, x, y, z]) if valid else None)]
                except ValueError as error:
                    self._bad(f"natnet: {error}")
                    return []
        return [Sample((0.0, 0.0, 0.0), t, number, False)]  # the body is not seen


def encode(layout: Layout, sample: Sample, index: int) -> bytes:
    """The bytes an instrument would send for a sample: one datagram, or a piece of a stream."""
    scale = 1.0 / LENGTH[layout.unit]
    x, y, z = sample.position
    t = 0.0 if sample.t_device is None else sample.t_device / TIME[layout.time_unit]
    q = sample.q or (1.0, 0.0, 0.0, 0.0)
    values = {
        "x": scale * x,
        "y": scale * y,
        "z": scale * z,
        "t": t,
        "frame": index,
        "valid": int(sample.valid),
        "-": 0,
    } | dict(zip(ATTITUDE, q, strict=True))
    match layout.format:
        case "text":
            return (layout.separator.join(repr(values[c]) for c in layout.columns) + "\n").encode()
        case "struct":
            return struct.pack(layout.struct, *(values[c] for c in layout.columns))
        case "spatialanalyzer":
            return f"X, {1e3 * x:.6f} | Y, {1e3 * y:.6f} | Z, {1e3 * z:.6f} | Units: (mm)\n".encode()
        case "emscon":
            body = EMSCON_MULTI.pack(1, 0, 20.0, 1013.0, 50.0)
            t1, t2 = divmod(round(1e6 * t), 1_000_000)
            body += EMSCON_POINT.pack(0 if sample.valid else 1, t1, t2, 1e3 * x, 1e3 * y, 1e3 * z)
            return EMSCON_HEAD.pack(EMSCON_HEAD.size + len(body), EMSCON_TYPE) + body
        case "natnet":
            return _natnet_bytes(sample, index)
    wrapped = math.fmod(sample.t_device or 0.0, DAY)
    place = f"{1e3 * x:.6f} {1e3 * y:.6f} {1e3 * z:.6f} {_dtrack_turn(q)}"
    seen = f"6d 1 [0 1.000][{place}]" if sample.valid else "6d 0"
    return f"fr {index}\r\nts {wrapped:.6f}\r\n{seen}\r\n".encode()


def _dtrack_turn(q: tuple[float, float, float, float]) -> str:
    """Angles about x, y, z [deg], R = Rx Ry Rz, and R column by column."""
    turn = Rotation.from_quat(q, scalar_first=True)
    angles = " ".join(f"{a:.4f}" for a in turn.as_euler("XYZ", degrees=True))
    return angles + "][" + " ".join(f"{b:.9f}" for b in turn.as_matrix().T.ravel())


def _natnet_bytes(sample: Sample, index: int) -> bytes:
    """A frame of protocol 4.1 with one rigid body, number 1. Counts stand before byte sizes of what follows."""
    w, x, y, z = sample.q or (1.0, 0.0, 0.0, 0.0)
    body = struct.pack("<I3f4ffH", 1, *sample.position, x, y, z, w, 0.0, int(sample.valid))
    nothing = bytes(8)
    parts = struct.pack("<I", index) + 2 * nothing  # marker sets, markers
    parts += struct.pack("<II", 1, len(body)) + body
    parts += 5 * nothing  # skeletons, assets, labelled markers, force plates, devices
    parts += struct.pack("<IIdQQQH", 0, 0, sample.t_device or 0.0, 0, 0, 0, 0)
    return NATNET_HEAD.pack(NATNET_FRAME, len(parts)) + parts
