# SPDX-License-Identifier: Apache-2.0
"""An hour of three sensors at 1 kHz as fast as a pipe carries it: resident memory and losses.

The daemon decodes, estimates, saves checkpoints and records to rotated files, all but the latest of which are deleted
meanwhile. Memory counts from WARM_UP on, when each of these has happened: code is resident once it has run.
Usage: soak.py [SECONDS OF DATA]. Exit 1: memory that is not a file's changed by a
page, or something was lost.
"""

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
FLOOD = TOP / "build/bench/flood"
SENSORS, RATE = 3, 1000.0  # Hz each
WARM_UP = 6.0  # s; the first checkpoint is saved after 5
PERIOD = 0.05  # s between samples of memory


def resident_kb(process: subprocess.Popen[str]) -> tuple[int, int]:
    """All, and what is not pages of a file. Counted page by page: the kernel's quick sums are off by some dozens."""
    text = Path(f"/proc/{process.pid}/smaps_rollup").read_text()
    rss, anonymous = (re.search(rf"^{name}: +(\d+) kB", text, re.M) for name in ("Rss", "Anonymous"))
    if rss is None or anonymous is None:
        sys.exit("soak: the daemon ended early")
    return int(rss[1]), int(anonymous[1])


def watch(source: subprocess.Popen[bytes], process: subprocess.Popen[str], folder: Path) -> tuple[list[int], list[int]]:
    """Both kinds of resident kB, from WARM_UP until there is no more data: code to end with is not resident before."""
    samples = []
    begin = time.monotonic()
    while source.poll() is None:
        if time.monotonic() > begin + WARM_UP:
            samples.append(resident_kb(process))
        for old in folder.glob("run.lcmlog.*"):
            old.unlink()
        time.sleep(PERIOD)
    return [rss for rss, _ in samples], [anonymous for _, anonymous in samples]


def main(seconds: float) -> int:
    frame_rate = SENSORS * RATE
    source = [TOP / "build/test/bench/flood", FLOOD / "run/can.log", "-", str(frame_rate), str(seconds)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        daemon = [
            TOP / "build/bin/inertiad",
            "-v",
            "--config",
            FLOOD / "timed/robot.cfg",
            "--bus",
            "file:-",
            "--lcm",
            "none",
        ]
        outputs = ["--record", f"{folder}/run.lcmlog?rotate_mb=16", "--checkpoint", folder / "run.ckp"]
        begin = time.monotonic()
        with subprocess.Popen(source, stdout=subprocess.PIPE) as log:
            process = subprocess.Popen([*daemon, *outputs], stdin=log.stdout, stderr=subprocess.PIPE, text=True)
            kb, anonymous = watch(log, process, folder)
            text = process.communicate()[1]
        took = time.monotonic() - begin
    c = {key: int(value) for key, value in re.findall(r"^inertiad: (\S+) +(\d+)$", text, re.M)}
    if len(kb) < 2:
        sys.exit(
            f"soak: it was over after {took:.1f} s, and only counts from {WARM_UP:g} s on; give more seconds of data"
        )
    n, n_rows = int(frame_rate * seconds), round(RATE * seconds)
    n_lost = n - c["decode.decoded"] + c["record.dropped"] + c["record.errors"]
    print(f"Soak, {seconds:g} s of {SENSORS} sensors at {RATE:g} Hz in {took:.1f} s, {seconds / took:.0f} x real time:")
    print(f"  {n} frames sent, {c['decode.decoded']} decoded; {n_rows} samples, {c['window.rows']} rows used")
    print(f"  {c['rls.updates']} updates, {c['record.bytes']} bytes recorded; {n_lost} lost")
    for name, found in (("resident", kb), ("of it not pages of files", anonymous)):
        print(f"  {name}: {found[0]} kB after {WARM_UP:g} s, {found[-1]} kB at the end, "
              f"{min(found)} to {max(found)} kB in all {len(found)} samples")  # fmt: skip
    # The first row has no force and position before it.
    return 0 if n_lost == 0 and min(anonymous) == max(anonymous) and c["window.rows"] >= n_rows - 1 else 1


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 3600.0))
