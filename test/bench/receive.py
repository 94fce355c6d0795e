# SPDX-License-Identifier: Apache-2.0
"""Receive a bus without loss: inertiad (decode, estimate, record) beside candump -l, python-can's logger and, as what
any reader of such a socket pays at least, drain, which throws everything away.

Each receives alone what flood sends, at rates that double until it loses a frame or flood cannot send as fast. CPU time
is the process's own from when it listens until it has read everything, so that no start-up counts; what it wrote tells
what it received. All get the same receive buffer, python-can's logger, which has no option for it, by a patch. Then the
daemon's own latencies, with sensors at 1 kHz, and four full buses at once.
Only the standard library: an emulated guest takes long to load more. Absolute numbers mean little there, ratios do.

Usage: tools/vcan python3 -S test/bench/receive.py [SECONDS of each step], after test/bench/flood.py: on real vcans;
       python3 test/bench/receive.py --over-udp [SECONDS]: as fast as this machine is, where its kernel has no CAN. The
       same programs use UDP sockets on loopback instead (test/host/can_over_udp.c).
"""

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
FLOOD = TOP / "build/bench/flood"
CAN_OVER_UDP = TOP / "build/bench/can_over_udp.so"
OUT = Path("received")  # in a temporary folder
BUS = "vcan0"
RATES = [1000 * 2**k for k in range(1, 8)]  # frames/s
LATENCY_RATE = 3000  # frames/s of three sensors at 1 kHz
BUSES, BUS_RATE = 4, 21000  # a classical bus at 1 Mbit/s carries as many frames without data
IDLE = 0.02  # of one processor: a receiver with nothing to do
PATIENCE = 120.0  # s
PYTHON_CAN = f"""
import sys
sys.path.append("site")
sys.modules["asammdf"] = None  # for another format, and it loads pandas
sys.argv = ["can_logger", "-i", "socketcan", "-c", "{BUS}", "--fd", "-f", "python-can.log"]
import can.interfaces.socketcan.socketcan as socketcan
import can.logger
create = socketcan.create_socket
def create_with_buffer():
    s = create()
    s.setsockopt(1, 33, 8 << 20)  # SO_RCVBUFFORCE
    return s
socketcan.create_socket = create_with_buffer
can.logger.main()
"""
INERTIAD = [TOP / "build/bin/inertiad", "-v", "--config", FLOOD / "timed/robot.cfg", "--bus", f"socketcan:{BUS}"]
RECEIVERS = {
    "inertiad": [*INERTIAD, "--lcm", "none", "--record", "run.lcmlog"],
    "candump -l": ["candump", "-r", str(8 << 20), "-l", BUS],
    "python-can": [sys.executable, "-S", "-c", PYTHON_CAN],
    "drain": [TOP / "build/test/bench/drain", BUS, "0.005"],
}


@dataclass
class Step:
    sent: int
    rate: float
    received: int
    cpu_us: float

    @property
    def is_whole(self) -> bool:
        return self.received == self.sent


def is_listening() -> bool:
    if "LD_PRELOAD" in os.environ:
        return re.search(r"^ *\d+: 0100007F:733D ", Path("/proc/net/udp").read_text(), re.M) is not None
    return any(re.search(f"^ +{BUS} ", p.read_text(), re.M) for p in Path("/proc/net/can").glob("rcvlist_*"))


def cpu_s(process: subprocess.Popen[str]) -> float:
    """time on a processor so far, all threads"""
    return 1e-9 * sum(int(p.read_text().split()[0]) for p in Path(f"/proc/{process.pid}/task").glob("*/schedstat"))


def settle(process: subprocess.Popen[str]) -> float:
    """CPU time when it has nothing left to do."""
    now, used = cpu_s(process), IDLE
    while used >= IDLE:
        time.sleep(1.0)
        now, used = cpu_s(process), cpu_s(process) - now
    return now


def start(name: str, command: list[object]) -> subprocess.Popen[str]:
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir()
    (OUT / "site").symlink_to(FLOOD / "site")
    with (OUT / "stderr").open("w") as errors:
        process = subprocess.Popen(
            [str(c) for c in command], cwd=OUT, stdout=subprocess.DEVNULL, stderr=errors, text=True
        )
    end = time.monotonic() + PATIENCE
    while not is_listening():
        if process.poll() is not None or time.monotonic() > end:
            sys.exit(f"{name} does not listen: {(OUT / 'stderr').read_text()}")
        time.sleep(0.1)
    return process


def stop(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGINT)
    process.wait()


def counters() -> dict[str, int]:
    return {k: int(v) for k, v in re.findall(r"^inertiad: (\S+) +(\d+)$", (OUT / "stderr").read_text(), re.M)}


def count_received(name: str) -> int:
    """Frames of which nothing got lost on the way to the disk."""
    if name == "drain":
        return int((OUT / "stderr").read_text())
    if name != "inertiad":
        return sum(line.startswith("(") for path in OUT.glob("*.log") for line in path.open())
    c = counters()
    return 0 if c["record.dropped"] else c["decode.frames"]


def start_flood(rate: float, seconds: float, bus: str = BUS) -> subprocess.Popen[str]:
    command = [TOP / "build/test/bench/flood", FLOOD / "run/can.log", bus, str(rate), str(seconds)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def end_flood(process: subprocess.Popen[str]) -> tuple[int, float]:
    """Frames sent, and their rate."""
    said = process.communicate()[0].split()
    if process.returncode != 0:
        sys.exit("flood failed")
    return int(said[0]), int(said[0]) / float(said[3])


def measure(name: str, rate: float, seconds: float) -> Step:
    process = start(name, RECEIVERS[name])
    before = settle(process)
    sent, real_rate = end_flood(start_flood(rate, seconds))
    cpu = settle(process) - before
    stop(process)
    return Step(sent, real_rate, count_received(name), 1e6 * cpu / sent)


def climb(seconds: float) -> dict[str, list[Step]]:
    """Steps of each up to the first with loss, or at which the sender is the slower one; at each rate one after the
    other, so that a busy machine is busy for all."""
    found: dict[str, list[Step]] = {name: [] for name in RECEIVERS}
    climbing = list(RECEIVERS)
    for rate in RATES:
        for name in list(climbing):
            step = measure(name, rate, seconds)
            found[name].append(step)
            lost = "nothing lost" if step.is_whole else f"{step.sent - step.received} of {step.sent} lost"
            print(f"  {name:12}{step.rate:9.0f} frames/s {step.cpu_us:9.2f} us CPU per frame   {lost}", flush=True)
            if not step.is_whole or step.rate < 0.9 * rate:
                climbing.remove(name)
    return found


def ratios(ours: list[Step], theirs: list[Step]) -> str:
    return ", ".join(f"{a.rate:.0f}/s {b.cpu_us / a.cpu_us:.2f}" for a, b in zip(ours, theirs, strict=False))


def compare(found: dict[str, list[Step]]) -> None:
    """Print the highest rate without loss, >= where flood was the slower one, and the ratios of CPU time."""
    print("Highest rate without loss, and CPU per frame as a multiple of inertiad's, at each rate that both bear:")
    whole = {name: [s for s in steps if s.is_whole] for name, steps in found.items()}
    for name, steps in found.items():
        best = max((s.rate for s in whole[name]), default=0.0)
        bound = ">= " if steps[-1].is_whole else ""
        print(f"  {name:12}{bound:>4}{best:7.0f} frames/s   {ratios(whole['inertiad'], whole[name])}")


def print_latencies() -> None:
    for line in re.findall(r"^inertiad: latency\.(.*)$", (OUT / "stderr").read_text(), re.M):
        print(f"  {line}")


def latency(seconds: float, collect: str) -> None:
    process = start("inertiad", [*INERTIAD, "--record", "run.lcmlog", "--collect", collect])
    settle(process)
    end_flood(start_flood(LATENCY_RATE, seconds))
    settle(process)
    stop(process)
    print(f"Latency from the kernel's stamp, three sensors at {LATENCY_RATE // 3} Hz, recorded, --collect {collect}:")
    print_latencies()


def several_buses(seconds: float) -> None:
    """The sensors are on the first bus; of the others every frame is recorded."""
    others = [f"vcan{i}" for i in range(1, BUSES)]
    options = [text for bus in others for text in ("--bus", f"socketcan:{bus}?filter=off")]
    process = start("inertiad", [*RECEIVERS["inertiad"], *options])
    before = settle(process)
    sent = [end_flood(f) for f in [start_flood(BUS_RATE, seconds, bus) for bus in (BUS, *others)]]
    cpu = settle(process) - before
    stop(process)
    n, rate = sum(count for count, _ in sent), sum(rate for _, rate in sent)
    print(f"{BUSES} buses together, {rate:.0f} frames/s: {n - count_received('inertiad')} of {n} frames lost,", end=" ")
    print(f"{1e6 * cpu / n:.2f} us CPU per frame, {100 * cpu / seconds:.0f} % of one processor")
    print_latencies()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seconds", nargs="?", type=float, default=5.0, help="of each step (default %(default)s)")
    parser.add_argument("--over-udp", action="store_true", help="UDP sockets in place of CAN")
    o = parser.parse_args()
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # ignored, as in a shell's background, python-can would, too
    if o.over_udp:
        os.environ["LD_PRELOAD"] = str(CAN_OVER_UDP)
    where = "UDP sockets in place of CAN" if o.over_udp else BUS
    print(f"CAN FD frames of 20 to 48 bytes, all decoded, {where}, {o.seconds:g} s at each rate:")
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        compare(climb(o.seconds))
        for collect in ("0.005", "0"):
            latency(o.seconds, collect)
        if o.over_udp:
            several_buses(o.seconds)
        os.chdir(TOP)


if __name__ == "__main__":
    main()
