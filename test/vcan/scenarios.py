# SPDX-License-Identifier: Apache-2.0
"""The faults that acquisition must survive, as schedules of frames that faults.py only has to send.

A robot with three CAN FD messages, each with a counter and the device's time: IMU, forces, position. Its run is
simulated once; every fault changes what its own bus gets of it, or what is done to its interface or daemon meanwhile.
"""

import json
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from inertiad.base import quantity

TOP = Path(__file__).resolve().parents[2]
COGIRO = TOP / "firmware/robots/cogiro"

TOGETHER = 8  # scenarios at once
RATE = 25.0  # Hz of every message: the paper's, and an emulated guest keeps pace with it
DURATION = 20.0  # s
FROM, UNTIL = 10.0, 14.0  # s of the run during which the fault lasts
LEAD = 0.05  # s after which a frame is sent: a frame can be sent before another one, but not before its time
IMU, FORCE, POSITION = 0x10, 0x20, 0x30
LENGTH = {IMU: 48, FORCE: 32, POSITION: 20}
RTR, ERROR = 0x40000000, 0x20000000
RECORD = struct.Struct("<dHH72s")
"""One frame of a schedule: s when it is due, bus, bytes of struct can(fd)_frame, these."""

DBC = """VERSION ""
NS_ :
BS_:
BU_: SENSORS HOST
BO_ 16 IMU: 48 SENSORS
 SG_ counter : 0|16@1+ (1,0) [0|65535] "" HOST
 SG_ time : 16|32@1+ (1,0) [0|4294967295] "us" HOST
{imu}
BO_ 32 FORCE: 32 SENSORS
 SG_ counter : 0|16@1+ (1,0) [0|65535] "" HOST
 SG_ time : 16|32@1+ (1,0) [0|4294967295] "us" HOST
{force}
BO_ 48 POSITION: 20 SENSORS
 SG_ counter : 0|16@1+ (1,0) [0|65535] "" HOST
 SG_ time : 16|32@1+ (1,0) [0|4294967295] "us" HOST
{position}
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","reserved","reserved","reserved","reserved",\
"reserved","reserved","reserved","reserved","reserved","reserved","reserved","StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 16 14;
BA_ "VFrameFormat" BO_ 32 14;
BA_ "VFrameFormat" BO_ 48 14;
"""


@dataclass
class Frame:
    due: float
    can_id: int
    data: bytes
    is_fd: bool = True
    is_sample: bool = True
    """a sample of a sensor, as against what a fault adds"""

    @property
    def counter(self) -> int:
        return struct.unpack_from("<H", self.data)[0]

    def with_(self, *, counter: int | None = None, time_us: float | None = None, **changes: object) -> "Frame":
        data = bytearray(self.data)
        if counter is not None:
            struct.pack_into("<H", data, 0, counter % 65536)
        if time_us is not None:
            struct.pack_into("<I", data, 2, (struct.unpack_from("<I", data, 2)[0] + round(time_us)) % 2**32)
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return Frame(**(values | {"data": bytes(data)} | changes))

    @property
    def wire(self) -> bytes:
        """struct canfd_frame or can_frame"""
        if self.is_fd:
            return struct.pack("=IBBBB64s", self.can_id, len(self.data), 1, 0, 0, self.data)
        return struct.pack("=IBBBB8s", self.can_id, len(self.data), 0, 0, 0, self.data)


Frames = list[Frame]


@dataclass
class Scenario:
    name: str
    robot: str = "timed"
    filter: bool = True
    frames: Callable[[Frames], Frames] = field(default=lambda frames: frames)
    actions: list[tuple[float, str]] = field(default_factory=list)
    """at s of the run: what faults.py does"""
    options: list[str] = field(default_factory=list)
    """of the daemon; {folder} is its own"""
    counted: list[str] = field(default_factory=list)
    """counters that must have noticed"""
    is_alone: bool = False
    """does something to the whole machine"""


def is_faulty(frame: Frame) -> bool:
    return FROM <= frame.due < UNTIL


def lose(frames: Frames) -> Frames:
    """Every seventh, and a stretch of 0.4 s."""
    return [f for i, f in enumerate(frames) if not is_faulty(f) or (i % 7 != 0 and not 12.0 <= f.due < 12.4)]


def duplicate(frames: Frames) -> Frames:
    copies = [f.with_(is_sample=False, due=f.due + 2e-3) for i, f in enumerate(frames) if is_faulty(f) and i % 5 == 0]
    return frames + copies


def reorder(frames: Frames) -> Frames:
    """Every eighth one two periods later."""
    return [f.with_(due=f.due + 2.2 / RATE) if is_faulty(f) and i % 8 == 0 else f for i, f in enumerate(frames)]


def cut(frames: Frames) -> Frames:
    return [f.with_(data=f.data[:16]) if is_faulty(f) and i % 6 == 0 else f for i, f in enumerate(frames)]


def foreign(can_id: int, data: bytes, per_second: float, is_fd: bool = False) -> Callable[[Frames], Frames]:
    n = int((UNTIL - FROM) * per_second)
    return lambda frames: frames + [Frame(FROM + i / per_second, can_id, data, is_fd, False) for i in range(n)]


def bus_off(frames: Frames) -> Frames:
    """CAN_ERR_BUSOFF, silence, CAN_ERR_RESTARTED."""
    states = [Frame(11.0, ERROR | 0x40, bytes(8), False, False), Frame(12.5, ERROR | 0x100, bytes(8), False, False)]
    return [f for f in frames if not 11.0 <= f.due < 12.5] + states


def silent(frames: Frames) -> Frames:
    return [f for f in frames if not (f.can_id == FORCE and is_faulty(f))]


def stick(frames: Frames) -> Frames:
    """The third force repeats: bytes 12 .. 14."""
    last = next(f.data[12:15] for f in frames if f.can_id == FORCE and is_faulty(f))
    return [f.with_(data=f.data[:12] + last + f.data[15:]) if f.can_id == FORCE and is_faulty(f) else f for f in frames]


def jump(frames: Frames) -> Frames:
    return [f.with_(counter=f.counter + 20000) if f.can_id == IMU and f.due >= FROM else f for f in frames]


def step_clock(frames: Frames) -> Frames:
    """The IMU's clock: 12 ms ahead from 10 s on, started again from 0 at 14 s."""
    restart = next(f for f in frames if f.can_id == IMU and f.due >= UNTIL)
    (at,) = struct.unpack_from("<I", restart.data, 2)
    offset = {f.due: (12e3 if is_faulty(f) else -at if f.due >= UNTIL else 0.0) for f in frames}
    return [f.with_(time_us=offset[f.due]) if f.can_id == IMU else f for f in frames]


def drift(frames: Frames) -> Frames:
    """The IMU's clock: 200 ppm fast."""
    return [f.with_(time_us=200.0 * f.due) if f.can_id == IMU else f for f in frames]


def stall(frames: Frames) -> Frames:
    """Forces of the first 90 ms of every half second come all at once after it, those of 11.0 to 11.3 s as well."""

    def release(t: float) -> float:
        return 11.3 if 11.0 < t < 11.3 else max(t, 0.5 * int(t / 0.5) + 0.09)

    return [f.with_(due=release(f.due)) if f.can_id == FORCE and f.due > 3.0 else f for f in frames]


SCENARIOS = [
    Scenario("none"),
    Scenario("frames lost", frames=lose, counted=["group.imu.lost", "group.force.lost", "group.position.lost"]),
    Scenario("frames duplicated", frames=duplicate, counted=["group.imu.duplicate_frames"]),
    Scenario("frames reordered", frames=reorder, counted=["align.imu.reordered"]),
    Scenario("length corrupted", frames=cut, counted=["decode.bad_length"]),
    Scenario("unknown IDs", filter=False, frames=foreign(0x7A0, bytes(8), 250.0), counted=["decode.unknown_id"]),
    Scenario("remote frames", filter=False, frames=foreign(RTR | IMU, b"", 250.0), counted=["decode.remote"]),
    Scenario("foreign frames, full load", is_alone=True,
             actions=[(FROM, "unknown storm"), (12.0, "calm"), (12.0, "remote storm"), (UNTIL, "calm")]),
    Scenario("error frames", frames=foreign(ERROR | 0x88, bytes(8), 100.0), counted=["decode.error_frame"]),
    Scenario("bus-off and back", frames=bus_off, counted=["decode.error_frame", "group.imu.lost"]),
    Scenario("interface down, up", actions=[(FROM, "down"), (12.0, "up")], counted=["bus0.went_down"]),
    Scenario("interface deleted, made", actions=[(FROM, "delete"), (12.0, "create")], counted=["bus0.went_down"]),
    Scenario("sensor silent and back", frames=silent, counted=["group.force.lost"]),
    Scenario("sensor stuck", frames=stick, counted=["stuck.force.unknown"]),
    Scenario("counter jumps", frames=jump, counted=["group.imu.counter_jumps"]),
    Scenario("device clock steps", frames=step_clock, counted=["clock.imu.steps"]),
    Scenario("device clock 200 ppm fast", frames=drift),
    Scenario("host stalls, no device time", robot="untimed", frames=stall),
    Scenario("LCM network gone", options=["--lcm", "udpm://239.255.76.67:7667?ttl=0"],
             actions=[(FROM, "no multicast"), (UNTIL, "multicast")]),
    Scenario("disk full", options=["--record", "{folder}/small/run.lcmlog"], actions=[(0.0, "small disk")],
             counted=["record.dropped"]),
    Scenario("SIGSTOP for 2 s", actions=[(FROM, "stop"), (12.0, "continue")]),
    Scenario("SIGTERM in mid-burst", actions=[(UNTIL, "terminate")]),
    Scenario("kill -9 and restart", options=["--checkpoint", "{folder}/checkpoint"], actions=[(13.0, "kill")]),
    Scenario("host clock 1 h ahead", is_alone=True, actions=[(FROM, "hour ahead"), (UNTIL, "hour back")]),
]  # fmt: skip


def signals(names: list[str], scale: float, offset: float) -> str:
    return "\n".join(
        f' SG_ {name} : {48 + 24 * i}|24@1{"-" if offset == 0 else "+"} ({scale:g},{offset:g}) [0|0] "{unit}" HOST'
        for i, (name, unit) in enumerate(n.split() for n in names)
    )


def imu_signals() -> str:
    lines = [("acc", "m/s2", 1e-5, "xyz"), ("gyro", "rad/s", 1e-6, "xyz"), ("q", "", 1.25e-7, "wxyz")]
    at, text = 48, []
    for name, unit, scale, axes in lines:
        for axis in axes:
            text.append(f' SG_ {name}_{axis} : {at}|24@1- ({scale:g},0) [0|0] "{unit}" HOST')
            at += 24
    return "\n".join(text)


def description(has_force_time: bool) -> str:
    bound = [f'{name} = "IMU.{name}"' for name in (*quantity.ACC, *quantity.GYRO, *quantity.QUATERNION)]
    bound += [f'f_{i} = "FORCE.f_{i}"' for i in range(1, 9)] + [f'pos_{a} = "POSITION.pos_{a}"' for a in "xyz"]
    for sensor, message in (("imu", "IMU"), ("pos", "POSITION"), ("force", "FORCE")):
        if sensor != "force" or has_force_time:
            bound += [f'{sensor}_counter = "{message}.counter"', f'{sensor}_time = "{message}.time"']
    head = f'base = "{COGIRO}/robot.toml"\n[position]\nsource = "can"\n[align]\nmax_wait = 1.0\n'
    return f'{head}[[bus]]\ndbc = "faults.dbc"\nbitrate = 1_000_000\n[signals]\n' + "\n".join(bound) + "\n"


def tool(*arguments: object) -> None:
    command = [str(a) for a in (TOP / "build/bin/inertiactl", *arguments)]
    subprocess.run(command, check=True, capture_output=True)


def simulate(folder: Path) -> Frames:
    """The robots, compiled, and the frames of one run."""
    forces = signals([f"f_{i} N" for i in range(1, 9)], 0.001, -1000)
    position = signals([f"pos_{a} m" for a in "xyz"], 1e-5, 0)
    for name in ("timed", "untimed"):
        (folder / name).mkdir(parents=True)
        (folder / name / "faults.dbc").write_text(DBC.format(imu=imu_signals(), force=forces, position=position))
        (folder / name / "robot.toml").write_text(description(name == "timed"))
        tool("compile", folder / name / "robot.toml", "-o", folder / name / "robot.cfg")
    tool("simulate", folder / "timed/robot.toml", "--rate", RATE, "--faults", "modern", "--seed", 1,
         "-o", folder / "run")  # fmt: skip
    return list(read_log(folder / "run/can.log"))


def read_log(path: Path) -> Iterator[Frame]:
    first = None
    for line in path.read_text().splitlines():
        stamp, _, text = line.split()
        t = float(stamp.strip("()"))
        first = t if first is None else first
        if t - first > DURATION:
            return
        can_id, data = text.split("##1")
        yield Frame(t - first, int(can_id, 16), bytes.fromhex(data))


def phases() -> list[list[int]]:
    """Numbers of the scenarios that run together: as many as an emulated guest can keep pace with."""
    together = [n for n, scenario in enumerate(SCENARIOS) if not scenario.is_alone]
    batches = [together[i : i + TOGETHER] for i in range(0, len(together), TOGETHER)]
    return batches + [[n] for n, scenario in enumerate(SCENARIOS) if scenario.is_alone]


def write(folder: Path) -> None:
    """schedule_<phase>.bin and scenarios.json."""
    shutil.rmtree(folder, ignore_errors=True)
    run = simulate(folder)
    facts = {}
    for phase, numbers in enumerate(phases()):
        records = []
        for n in numbers:
            frames = SCENARIOS[n].frames(run)
            fields = {k: v for k, v in asdict(SCENARIOS[n]).items() if k != "frames"}
            facts[n] = fields | {"phase": phase, "made": len(run)}
            records += [(f.due + LEAD, n, f.wire) for f in frames]
        records.sort(key=lambda r: r[0])
        packed = b"".join(RECORD.pack(due, n, len(wire), wire) for due, n, wire in records)
        (folder / f"schedule_{phase}.bin").write_bytes(packed)
    (folder / "scenarios.json").write_text(json.dumps([facts[n] for n in sorted(facts)], indent=1) + "\n")
