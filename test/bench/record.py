# SPDX-License-Identifier: Apache-2.0
"""inertiactl record from the emulator of every protocol over real sockets: sent, received, lost, lateness.

All protocols at once, in a network of its own, so that the recorders share the machine as they would not in a lab.
Usage: record.py [SECONDS]. Exit 1: something was lost.
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROUTE = 'ip link set lo up multicast on; ip route add 224.0.0.0/4 dev lo; exec "$@"'
TOOL = str(Path(__file__).resolve().parents[2] / "build/bin/inertiactl")
RATES = (238.0, 1000.0)
WAYS = {
    "text": ("udp:{port}", "udp:127.0.0.1:{port}", []),
    "text, TCP server": ("tcp-listen:{port}", "tcp:127.0.0.1:{port}", []),
    "struct": ("tcp:127.0.0.1:{port}", "tcp-listen:{port}", ["--struct", "<Id3d", "--columns", "frame,t,x,y,z"]),
    "spatialanalyzer": ("udp:{port}", "udp:127.0.0.1:{port}", []),
    "emscon": ("tcp:127.0.0.1:{port}", "tcp-listen:{port}", []),
    "dtrack": ("udp:{port}", "udp:127.0.0.1:{port}", []),
    "natnet": ("udp:{port}", "udp:127.0.0.1:{port}", []),
}
"""where the recorder listens, where the emulator sends, the recorder's options"""


def write_run(folder: Path, rate: float, seconds: float) -> Path:
    t = 100.0 + np.arange(int(rate * seconds)) / rate
    xyz = np.column_stack([np.sin(t), np.cos(t), 2.0 + 0.1 * np.sin(3.0 * t)])
    folder.mkdir()
    np.savetxt(folder / "tracker.csv", np.column_stack([t, xyz]), "%.9f", ",", header="t,x,y,z", comments="")
    return folder


def wait_for(path: Path, recorder: subprocess.Popen) -> None:
    while not path.exists():
        time.sleep(0.1)
        if recorder.poll() is not None:
            sys.exit(f"a recorder ended by itself: {recorder.communicate()[1]}")


def measure(rate: float, seconds: float, folder: Path) -> bool:
    """Run all ways at once and print a line for each. True: nothing was lost."""
    run = write_run(folder / f"run{rate:g}", rate, seconds)
    recorders, players = {}, {}
    for port, (name, (source, _, options)) in enumerate(WAYS.items(), 5100):
        form, out = name.split(",")[0], folder / f"{port}_{rate:g}"
        command = [TOOL, "record", "--from", source.format(port=port), "--format", form, "-o", str(out)]
        command += [*options, "--prefix", f"P{port}_"]
        recorders[name] = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        wait_for(out / "header.json", recorders[name])
    for port, (name, (_, sink, _)) in enumerate(WAYS.items(), 5100):
        command = [TOOL, "replay", str(run), "--tracker", f"{name.split(',')[0]}={sink.format(port=port)}"]
        players[name] = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        return judge(rate, recorders, players)
    finally:
        for process in (*recorders.values(), *players.values()):
            process.kill()


def judge(rate: float, recorders: dict[str, subprocess.Popen], players: dict[str, subprocess.Popen]) -> bool:
    """Print a line for each way when its player is done. True: nothing was lost."""
    good = True
    for name, player in players.items():
        said = player.communicate()[1]
        time.sleep(1.0)
        recorders[name].send_signal(signal.SIGINT)
        summary = recorders[name].communicate()[1]
        sent, counts = re.search(r"(\d+) sent", said), re.search(r"(\d+) received, (\d+) published", summary)
        if sent is None or counts is None:
            sys.exit(f"{name} at {rate:g} Hz: {said} {summary}")
        n_sent, n_received, n_published = map(int, (sent[1], *counts.groups()))
        late = re.search(r"late: .*?(\d+) us \(p50\), (\d+) us \(p99\)", summary)
        delay = f"{late[1]:>8} {late[2]:>8}" if late else f"{'-':>8} {'-':>8}"
        good &= n_sent == n_received == n_published
        print(f"{name:18}{rate:6g} Hz {n_sent:8} {n_received:9} {n_sent - n_published:6}  {delay}", flush=True)
    return good


def main(seconds: float) -> int:
    print(f"record, {len(WAYS)} at once for {seconds:g} s; late: from the earliest possible arrival by device time")
    print(f"{'':18}{'rate':>9} {'sent':>8} {'received':>9} {'lost':>6}  {'p50 us':>8} {'p99 us':>8}")
    with tempfile.TemporaryDirectory() as folder:
        n_good = sum(measure(rate, seconds, Path(folder)) for rate in RATES)
    return 0 if n_good == len(RATES) else 1


if __name__ == "__main__":
    if os.environ.get("INERTIAD_ISOLATED") is None:
        command = ["unshare", "-rn", "sh", "-c", ROUTE, "-", sys.executable, *sys.argv]
        sys.exit(subprocess.run(command, env={**os.environ, "INERTIAD_ISOLATED": "1"}).returncode)
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0))
