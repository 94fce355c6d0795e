# SPDX-License-Identifier: Apache-2.0
"""Run the demo's log through the core on an emulated Cortex-M7 and judge it (make m7 has built both programs).

bits          every estimate equals that of the same sources on this machine
instructions  QEMU's count (-icount), 25 MHz timer: 40 of them per tick. No time: an emulator has no cache, no flash
stack         deepest path of calls by the compiler's call graph; the most that was used in the run
heap, state   no allocator in the program; the pipeline's size in the micro profile
"""

import re
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np

from inertiad.run import canlog

TOP = Path(__file__).resolve().parent.parent
BUILD = TOP / "build/m7"
RUN = BUILD / "run"
QEMU = ("qemu-system-arm", "-M", "mps2-an500", "-nographic", "-monitor", "none", "-serial", "none")
QEMU += ("-icount", "shift=0", "-semihosting-config", "enable=on,target=native")
ITEM = np.dtype(
    [("t_ns", "<i8"), ("id", "<u4"), ("kind", "u1"), ("length", "u1"), ("spare", "u1", 2), ("content", "u1", 24)]
)
FRAME, POSITION = 1, 2
PER_TICK = 40  # instructions: 1 ns each, the timer at 25 MHz
PER_ROW_MAX = 48_000
"""instructions: a tenth of what a Cortex-M7 of 480 MHz does in 1 ms at one instruction per cycle"""
STACK_MAX = 16 * 1024  # bytes
STATE_MAX = 64 * 1024  # bytes
EXCEPTION_FRAME = 112  # bytes that the processor pushes, registers of the FPU included, aligned
ROOTS = ("ipe_pipeline_push_frame", "ipe_pipeline_push_position", "ipe_pipeline_step", "ipe_pipeline_flush")
INTERRUPT = "board_interrupt"


# ---- input -----------------------------------------------------------------------------------------------------------


def write_tape(path: Path, config: bytes) -> None:
    """Configuration, then frames and positions by their stamps; at equal stamps the tracker's comes last."""
    log = canlog.read(RUN / "can.log")
    rows = np.loadtxt(RUN / "tracker.csv", delimiter=",", skiprows=1, usecols=(0, 1, 2, 3))
    frames, positions = np.zeros(len(log.t_ns), ITEM), np.zeros(len(rows), ITEM)
    frames["t_ns"], frames["id"], frames["kind"], frames["length"] = log.t_ns, log.can_id, FRAME, log.length
    frames["content"][:, :8] = log.data[:, :8]
    positions["t_ns"], positions["kind"] = np.rint(1e9 * rows[:, 0]).astype(np.int64), POSITION
    positions["content"] = np.ascontiguousarray(rows[:, 1:]).view("u1").reshape(-1, 24)
    items = np.concatenate([frames, positions])
    items = items[np.argsort(items["t_ns"], kind="stable")]
    path.write_bytes(len(config).to_bytes(4, "little") + config + items.tobytes())


def prepare() -> None:
    """The demo's run, as the input of both programs."""
    RUN.mkdir(parents=True, exist_ok=True)
    tool = (sys.executable, "-m", "inertiad")
    robot = "firmware/robots/cogiro/robot.toml"
    for command in (
        ("simulate", robot, "--faults", "modern", "--seed", "1", "-o", RUN),
        ("compile", RUN / "robot.toml", "--blind", "-o", RUN / "robot.cfg"),
    ):
        subprocess.run([*tool, *map(str, command)], cwd=TOP, check=True, capture_output=True)
    write_tape(RUN / "tape", (RUN / "robot.cfg").read_bytes())


# ---- stack -----------------------------------------------------------------------------------------------------------


class Calls:
    """The compiler's call graph (-fcallgraph-info=su) of all sources."""

    def __init__(self, files: list[Path]) -> None:
        self.frame: dict[str, int] = {}
        self.below: dict[str, set[str]] = {}
        for path in files:
            text = path.read_text()
            for name, size in re.findall(r'node: \{ title: "([^"]+)" label: "[^"]*?\\n(\d+) bytes', text):
                self.frame[name] = int(size)
            for name, target in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
                self.below.setdefault(name, set()).add(target)

    def deepest(self, name: str, above: tuple[str, ...] = ()) -> tuple[int, list[str]]:
        """Bytes and functions of the deepest path. ValueError: a function calls itself, or through a pointer."""
        if name in above or name == "__indirect_call":
            raise ValueError(f"{' > '.join((*above, name))}: no bound")
        paths = [self.deepest(target, (*above, name)) for target in sorted(self.below.get(name, ()))]
        size, path = max(paths, default=(0, []), key=lambda found: found[0])
        return self.frame.get(name, 0) + size, [name, *path]

    def unknown(self, name: str) -> set[str]:
        """Functions of libraries below a function: nobody knows their frames."""
        found = set().union(*map(self.unknown, self.below.get(name, ())))
        return found if name in self.frame else found | {name}


# ---- result ----------------------------------------------------------------------------------------------------------


def result(text: str) -> tuple[list[str], dict[str, int]]:
    """Lines of the estimates, and the numbers of the last line."""
    *estimates, last = text.splitlines()
    names = ("frames", "rows", "estimates", "ticks", "worst", "stack", "state")
    return estimates, dict(zip(names, (int(word, 16) for word in last.split()), strict=True))


def run_target() -> str:
    (RUN / "estimates").unlink(missing_ok=True)
    done = subprocess.run([*QEMU, "-kernel", BUILD / "firmware.elf"], cwd=RUN, timeout=900)
    if done.returncode != 0:
        sys.exit(f"m7: the program ended with status {done.returncode}: 1 no estimate, 2 input, 3 fault, 4 assertion")
    return (RUN / "estimates").read_text()


def main() -> int:
    """Print the table; 1 if a line fails."""
    prepare()
    with (RUN / "tape").open("rb") as tape:
        native = subprocess.run([BUILD / "workstation"], stdin=tape, capture_output=True, text=True, check=True).stdout
    own, _ = result(native)
    target, numbers = result(run_target())
    calls = Calls(sorted(BUILD.rglob("*.ci")))
    depth, path = max((calls.deepest(root) for root in ROOTS), key=lambda found: found[0])
    depth += calls.frame["main"]
    libraries = sorted(set().union(*map(calls.unknown, ROOTS)))
    interrupt = calls.deepest(INTERRUPT)[0] + EXCEPTION_FRAME
    symbols = subprocess.run(
        ["arm-none-eabi-nm", BUILD / "firmware.elf"], capture_output=True, text=True, check=True
    ).stdout
    heap = re.findall(r"\b_?(?:malloc|calloc|realloc|free|sbrk)(?:_r)?\b", symbols)
    sizes = subprocess.run(
        ["arm-none-eabi-size", BUILD / "firmware.elf"], capture_output=True, text=True, check=True
    ).stdout
    differing = sum(a != b for a, b in zip(own, target, strict=False)) + abs(len(own) - len(target))
    per_row = PER_TICK * numbers["ticks"] / numbers["rows"]
    lines = [
        (f"estimates that differ in a bit from x86-64, of {len(target)}", differing, differing == 0 and bool(target)),
        (
            f"instructions per row, {numbers['rows']} rows, allowed {PER_ROW_MAX}",
            round(per_row),
            per_row <= PER_ROW_MAX,
        ),
        ("instructions of the longest call of ipe_pipeline_step", PER_TICK * numbers["worst"], True),
        (
            f"bytes of stack by call graph, interrupt included, allowed {STACK_MAX}",
            depth + interrupt,
            depth + interrupt <= STACK_MAX,
        ),
        (f"bytes of stack used in the run, allowed {STACK_MAX}", numbers["stack"], numbers["stack"] <= STACK_MAX),
        (f"bytes of state, allowed {STATE_MAX}", numbers["state"], numbers["state"] <= STATE_MAX),
        ("allocating functions in the program", len(heap), not heap),
        ("bytes of code and constants", int(sizes.splitlines()[1].split()[0]), True),
    ]
    print("Cortex-M7 (QEMU mps2-an500), the demo's log; instructions, not time; never on a board:")
    for what, value, is_good in lines:
        print(f"  {'ok  ' if is_good else 'FAIL'} {value:>9}  {what}")
    told = f"deepest path: {' > '.join(path)}; not in it: the C library's {', '.join(libraries)}"
    print(textwrap.fill(told, 118, initial_indent="  ", subsequent_indent="  "))
    return 0 if all(is_good for _, _, is_good in lines) else 1


if __name__ == "__main__":
    sys.exit(main())
