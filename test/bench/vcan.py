# SPDX-License-Identifier: Apache-2.0
"""Receive a bus without loss: inertiad (decode, estimate, record) beside candump -l and a python-can logger.

Each receives alone what flood sends, at rates that double until it loses a frame or flood cannot send as fast. CPU time
is the process's own from when it listens until it has read everything, so that no start-up counts; what it wrote tells
what it received. All get the same receive buffer. Then the daemon's own latencies, with sensors at 1 kHz. Only the
standard library: in an emulated guest absolute numbers mean little, ratios do.
Usage: tools/vcan python3 -S test/bench/vcan.py [SECONDS of each step], after test/bench/flood.py
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
FLOOD = TOP / "build/bench/flood"
OUT = Path("/tmp/bench")
BUS = "vcan0"
RATES = [1000 * 2**k for k in range(9)]  # frames/s
LATENCY_RATE = 3000  # frames/s of three sensors at 1 kHz
TICK = os.sysconf("SC_CLK_TCK")
IDLE = 0.05  # of one processor
PATIENCE = 120.0  # s
PYTHON_CAN = f"""
import sys
sys.path.append("{OUT}/site")
sys.modules["asammdf"] = None  # for another format, and it loads pandas
import can
with can.Bus(channel="{BUS}", interface="socketcan", fd=True) as bus, can.Logger("{OUT}/python-can.log") as log:
    bus.socket.setsockopt(1, 33, 8 << 20)  # SO_RCVBUFFORCE, as the others do
    notifier = can.Notifier(bus, [log])
    sys.stdin.read()
    notifier.stop()
"""
INERTIAD = [TOP / "build/bin/inertiad", "--config", FLOOD / "timed/robot.cfg", "--bus", f"socketcan:{BUS}"]
RECEIVERS = {
    "inertiad": [*INERTIAD, "--lcm", "none", "--record", OUT / "run.lcmlog"],
    "candump -l": ["candump", "-r", str(8 << 20), "-l", BUS],
    "python-can": [sys.executable, "-S", "-c", PYTHON_CAN],
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
    return any(re.search(f"^ +{BUS} ", p.read_text(), re.M) for p in Path("/proc/net/can").glob("rcvlist_*"))


def cpu_s(process: subprocess.Popen[str]) -> float:
    """user and system time so far, all threads"""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def settle(process: subprocess.Popen[str]) -> float:
    """CPU time when it has nothing left to do."""
    now, used = cpu_s(process), IDLE
    while used >= IDLE:
        time.sleep(1.0)
        now, used = cpu_s(process), cpu_s(process) - now
    return now


def start(name: str, command: list[object]) -> subprocess.Popen[str]:
    shutil.rmtree(OUT, ignore_errors=True)
    shutil.copytree(FLOOD / "site", OUT / "site")
    with (OUT / "stderr").open("w") as errors:
        process = subprocess.Popen([str(c) for c in command], cwd=OUT, stdin=subprocess.PIPE, stderr=errors, text=True)
    end = time.monotonic() + PATIENCE
    while not is_listening():
        if process.poll() is not None or time.monotonic() > end:
            sys.exit(f"{name} does not listen: {(OUT / 'stderr').read_text()}")
        time.sleep(0.1)
    return process


def stop(process: subprocess.Popen[str]) -> None:
    """What ends each of them: the end of its input, or a signal."""
    if "python" not in process.args[0]:
        process.send_signal(signal.SIGINT)
    process.communicate()


def counters() -> dict[str, int]:
    return {k: int(v) for k, v in re.findall(r"^inertiad: (\S+) +(\d+)$", (OUT / "stderr").read_text(), re.M)}


def count_received(name: str) -> int:
    """Frames of which nothing got lost on the way to the disk."""
    if name != "inertiad":
        return sum(line.startswith("(") for path in OUT.glob("*.log") for line in path.open())
    c = counters()
    return 0 if c["record.dropped"] else c["decode.decoded"]


def flood(rate: float, seconds: float) -> tuple[int, float]:
    """Frames sent, and their rate."""
    command = [TOP / "build/test/bench/flood", FLOOD / "run/can.log", BUS, str(rate), str(seconds)]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return int(said[0]), int(said[0]) / float(said[3])


def measure(name: str, rate: float, seconds: float) -> Step:
    process = start(name, RECEIVERS[name])
    before = settle(process)
    sent, real_rate = flood(rate, seconds)
    cpu = settle(process) - before
    stop(process)
    return Step(sent, real_rate, count_received(name), 1e6 * cpu / sent)


def climb(name: str, seconds: float) -> list[Step]:
    """Steps up to the first with loss, or at which the sender is the slower one."""
    steps: list[Step] = []
    for rate in RATES:
        step = measure(name, rate, seconds)
        steps.append(step)
        lost = "nothing lost" if step.is_whole else f"{step.sent - step.received} of {step.sent} lost"
        print(f"  {name:12}{step.rate:9.0f} frames/s {step.cpu_us:9.2f} us CPU per frame   {lost}", flush=True)
        if not step.is_whole or step.rate < 0.9 * rate:
            break
    return steps


def compare(found: dict[str, list[Step]]) -> None:
    """Print the highest rate without loss, >= where flood was the slower one, and the ratios of CPU time."""
    best = {
        name: (">= " if steps[-1].is_whole else "") + f"{max((s.rate for s in steps if s.is_whole), default=0.0):.0f}"
        for name, steps in found.items()
    }
    whole = {name: [s for s in steps if s.is_whole] for name, steps in found.items()}
    n_common = min(len(steps) for steps in whole.values())
    if n_common == 0:
        sys.exit("vcan: one of them lost frames even at the lowest rate")
    print(f"{'':14}{'highest without loss':>24}{'CPU per frame at':>20}{whole['inertiad'][n_common - 1].rate:7.0f}/s")
    for name, steps in whole.items():
        cpu, ours = steps[n_common - 1].cpu_us, whole["inertiad"][n_common - 1].cpu_us
        text = f"{cpu:15.2f} us {cpu / ours:7.2f} x inertiad's"
        print(f"  {name:12}{best[name]:>15} frames/s{text}")
    ours, theirs = whole["inertiad"], whole["candump -l"]
    ratios = (f"{a.rate:.0f}/s {b.cpu_us / a.cpu_us:.2f}" for a, b in zip(ours, theirs, strict=False))
    print(f"  CPU per frame, candump's / inertiad's, at each rate that both bear: {', '.join(ratios)}")


def latency(seconds: float) -> None:
    process = start("inertiad", [*INERTIAD, "--record", OUT / "run.lcmlog"])
    settle(process)
    flood(LATENCY_RATE, seconds)
    settle(process)
    stop(process)
    print(f"Latency from the kernel's stamp, three sensors at {LATENCY_RATE // 3} Hz, recorded and published:")
    for line in re.findall(r"^inertiad: latency\.(.*)$", (OUT / "stderr").read_text(), re.M):
        print(f"  {line}")


def main(seconds: float) -> None:
    print(f"CAN FD frames of 20 to 48 bytes, all decoded, on {BUS}, {seconds:g} s at each rate:")
    compare({name: climb(name, seconds) for name in RECEIVERS})
    latency(seconds)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)
