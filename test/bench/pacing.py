# SPDX-License-Identifier: Apache-2.0
"""How well a replayed log keeps its spacing on a bus: inertiactl replay beside canplayer, same log, same bus, by turns.

Frames are stamped by the kernel where they arrive, so how fast this reader reads does not matter. Only the standard
library: it runs where vcan is, which may be an emulated guest, whose absolute numbers mean little and whose ratios do.
Usage: tools/vcan python pacing.py
"""

import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
RATE, SECONDS, ROUNDS = 5000, 2.0, 2
SO_RCVBUFFORCE, SO_TIMESTAMPNS = 33, 35
PLAYERS = {
    "inertiactl replay": lambda log: [str(TOP / "build/bin/inertiactl"), "replay", log, "--bus", "socketcan:vcan0"],
    "canplayer": lambda log: ["canplayer", "-I", log, "vcan0=can0"],
}


def write_log(path: Path) -> list[float]:
    """RATE frames a second, unevenly spaced; their stamps, s."""
    stamps = [100.0 + round(1e6 * (k + 0.4 * (k % 3)) / RATE) / 1e6 for k in range(int(RATE * SECONDS))]
    path.write_text("".join(f"({t:017.6f}) can0 {k % 0x700:03X}#{k:016X}\n" for k, t in enumerate(stamps)))
    return stamps


def listener() -> socket.socket:
    link = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    link.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 16 << 20)
    link.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    link.bind(("vcan0",))
    link.settimeout(1.0)
    return link


def received(link: socket.socket) -> list[tuple[int, float]]:
    """Number in the frame and kernel stamp [s] of everything that waits."""
    found = []
    while True:
        try:
            data, control, _, _ = link.recvmsg(16, 128)
        except TimeoutError:
            return found
        s, ns = struct.unpack("qq", control[0][2][:16])
        found.append((int.from_bytes(data[8:16], "big"), s + 1e-9 * ns))


def errors(log: Path, stamps: list[float], command: list[str]) -> list[float]:
    """us by which each frame came later than its spacing in the log asks, from the earliest."""
    with listener() as link:
        subprocess.run(command, check=True, capture_output=True)
        time.sleep(0.5)
        frames = received(link)
    if [number for number, _ in frames] != list(range(len(stamps))):
        sys.exit(f"{command[0]}: {len(frames)} of {len(stamps)} frames came, or out of order")
    late = [t - stamp for (_, t), stamp in zip(frames, stamps, strict=True)]
    return [1e6 * (v - min(late)) for v in late]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "can.log"
        stamps = write_log(log)
        found: dict[str, list[float]] = {name: [] for name in PLAYERS}
        for _ in range(ROUNDS):
            for name, command in PLAYERS.items():
                found[name] += errors(log, stamps, command(str(log)))
    print(
        f"Spacing of {RATE} frames/s over vcan, {ROUNDS} x {SECONDS:g} s each, by turns; us late of the log's spacing:"
    )
    own: tuple[float, ...] = ()
    for name, late in found.items():
        cuts = statistics.quantiles(late, n=100)
        numbers = cuts[49], cuts[98], max(late)
        own = own or numbers
        times = ", ".join(f"{a / b:.1f}" for a, b in zip(numbers, own, strict=True))
        text = "".join(f"{n:10.0f} ({word})" for n, word in zip(numbers, ("p50", "p99", "max"), strict=True))
        print(f"  {name:20}{text}   {times} x ours")


if __name__ == "__main__":
    main()
