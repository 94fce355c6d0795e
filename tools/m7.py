# SPDX-License-Identifier: Apache-2.0
"""Run two logs through the core on an emulated Cortex-M7 and judge it (make m7 has built both programs).

The demo's log, and one of the paper's sensors on a platform that takes up 20 kg: its estimates are no bodies at first
and a contest of two bodies runs, so its calls take longer.

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
ROBOT = "firmware/robots/cogiro/robot.toml"
DEMO = ("--faults", "modern", "--seed", "1")
PAYLOAD = ("--faults", "paper", "--seed", "3", "--plant", "rigid", "--payload", "20@15")
QEMU = ("qemu-system-arm", "-M", "mps2-an500", "-nographic", "-monitor", "none", "-serial", "none")
QEMU += ("-icount", "shift=0", "-semihosting-config", "enable=on,target=native")
ITEM = np.dtype(
    [("t_ns", "<i8"), ("id", "<u4"), ("kind", "u1"), ("length", "u1"), ("spare", "u1", 2), ("content", "u1", 24)]
)
FRAME, POSITION = 1, 2
PER_TICK = 40  # instructions: 1 ns each, the timer at 25 MHz
PER_ROW_MAX = 48_000
"""instructions: a tenth of what a Cortex-M7 of 480 MHz does in 1 ms at one instruction per cycle"""
CALL_MAX = 800_000
"""instructions of one call: under 2 ms of such a processor, in which a bus of 1 Mbit/s fills a quarter of the ring"""
STACK_MAX = 16 * 1024  # bytes
STATE_MAX = 64 * 1024  # bytes
EXCEPTION_FRAME = 112  # bytes that the processor pushes, registers of the FPU included, aligned
ROOTS = ("ipe_pipeline_push_frame", "ipe_pipeline_push_position", "ipe_pipeline_step_part", "ipe_pipeline_flush")
INTERRUPT = "board_interrupt"


# ---- input -----------------------------------------------------------------------------------------------------------


def write_tape(run: Path) -> None:
    """Configuration, then frames and positions by their stamps; at equal stamps the tracker's comes last."""
    config = (run / "robot.cfg").read_bytes()
    log = canlog.read(run / "can.log")
    rows = np.loadtxt(run / "tracker.csv", delimiter=",", skiprows=1, usecols=(0, 1, 2, 3))
    frames, positions = np.zeros(len(log.t_ns), ITEM), np.zeros(len(rows), ITEM)
    frames["t_ns"], frames["id"], frames["kind"], frames["length"] = log.t_ns, log.can_id, FRAME, log.length
    frames["content"][:, :8] = log.data[:, :8]
    positions["t_ns"], positions["kind"] = np.rint(1e9 * rows[:, 0]).astype(np.int64), POSITION
    positions["content"] = np.ascontiguousarray(rows[:, 1:]).view("u1").reshape(-1, 24)
    items = np.concatenate([frames, positions])
    items = items[np.argsort(items["t_ns"], kind="stable")]
    (run / "tape").write_bytes(len(config).to_bytes(4, "little") + config + items.tobytes())


def prepare(run: Path, options: tuple[str, ...]) -> None:
    """A simulated run, as the input of both programs."""
    run.mkdir(parents=True, exist_ok=True)
    tool = (sys.executable, "-m", "inertiad")
    for command in (
        ("simulate", ROBOT, *options, "-o", run),
        ("compile", run / "robot.toml", "--blind", "-o", run / "robot.cfg"),
    ):
        subprocess.run([*tool, *map(str, command)], cwd=TOP, check=True, capture_output=True)
    write_tape(run)


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


def run_target(run: Path) -> str:
    (run / "estimates").unlink(missing_ok=True)
    done = subprocess.run([*QEMU, "-kernel", BUILD / "firmware.elf"], cwd=run, timeout=900)
    if done.returncode != 0:
        sys.exit(f"m7: the program ended with status {done.returncode}: 1 no estimate, 2 input, 3 fault, 4 assertion")
    return (run / "estimates").read_text()


Line = tuple[str, int, bool]
"""what, its value, whether that is allowed"""


def compare(name: str, options: tuple[str, ...]) -> list[Line]:
    """The table's lines of one log; those of the mean row and of the state for the demo's only."""
    run = BUILD / name
    prepare(run, options)
    with (run / "tape").open("rb") as tape:
        native = subprocess.run([BUILD / "workstation"], stdin=tape, capture_output=True, text=True, check=True).stdout
    own, _ = result(native)
    target, numbers = result(run_target(run))
    differing = sum(a != b for a, b in zip(own, target, strict=False)) + abs(len(own) - len(target))
    longest = PER_TICK * numbers["worst"]
    lines = [
        (f"estimates that differ in a bit from x86-64, of {len(target)}", differing, differing == 0 and bool(target)),
        (f"instructions of the longest call, allowed {CALL_MAX}", longest, longest <= CALL_MAX),
        (f"bytes of stack used in the run, allowed {STACK_MAX}", numbers["stack"], numbers["stack"] <= STACK_MAX),
    ]
    if options == DEMO:
        per_row = round(PER_TICK * numbers["ticks"] / numbers["rows"])
        what = f"instructions per row, {numbers['rows']} rows, allowed {PER_ROW_MAX}"
        lines.append((what, per_row, per_row <= PER_ROW_MAX))
        what = f"bytes of state, allowed {STATE_MAX}"
        lines.append((what, numbers["state"], numbers["state"] <= STATE_MAX))
    return lines


def output_of(tool: str) -> str:
    command = [f"arm-none-eabi-{tool}", BUILD / "firmware.elf"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def inspect() -> tuple[list[Line], str]:
    """Lines of the program itself, and its deepest path of calls in words."""
    calls = Calls(sorted(BUILD.rglob("*.ci")))
    depth, path = max((calls.deepest(root) for root in ROOTS), key=lambda found: found[0])
    depth += calls.frame["main"] + calls.deepest(INTERRUPT)[0] + EXCEPTION_FRAME
    libraries = sorted(set().union(*map(calls.unknown, ROOTS)))
    heap = re.findall(r"\b_?(?:malloc|calloc|realloc|free|sbrk)(?:_r)?\b", output_of("nm"))
    lines = [
        (f"bytes of stack by call graph, interrupt included, allowed {STACK_MAX}", depth, depth <= STACK_MAX),
        ("allocating functions in the program", len(heap), not heap),
        ("bytes of code and constants", int(output_of("size").splitlines()[1].split()[0]), True),
    ]
    return lines, f"deepest path: {' > '.join(path)}; not in it: the C library's {', '.join(libraries)}"


def main() -> int:
    """Print the table; 1 if a line fails."""
    of_program, told = inspect()
    tables = {
        "the demo's log": compare("demo", DEMO),
        "the paper's sensors, a payload taken up": compare("payload", PAYLOAD),
        "the program": of_program,
    }
    print("Cortex-M7 (QEMU mps2-an500); instructions, not time; never on a board.")
    for title, lines in tables.items():
        print(f"{title}:")
        for what, value, is_good in lines:
            print(f"  {'ok  ' if is_good else 'FAIL'} {value:>9}  {what}")
    print(textwrap.fill(told, 118, initial_indent="  ", subsequent_indent="  "))
    return 0 if all(is_good for lines in tables.values() for _, _, is_good in lines) else 1


if __name__ == "__main__":
    sys.exit(main())
