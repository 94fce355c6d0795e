# SPDX-License-Identifier: Apache-2.0
"""Measure the core beside what else one would use, on the same data in the same run. Prints tables, asserts nothing."""

import shutil
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import can
import cantools
import numpy as np
import padasip
from filterpy.kalman import KalmanFilter
from statsmodels.regression.recursive_ls import RecursiveLS

import inertiad_core as core

TOP = Path(__file__).resolve().parents[2]
RUN = TOP / "build/bench/run"
COGIRO = TOP / "firmware/robots/cogiro/robot.toml"


def program(*command):
    """What a program of the project prints."""
    return subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True, cwd=TOP).stdout


def best(n, action):
    """Seconds of the fastest of n."""
    times = []
    for _ in range(n):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def simulate():
    """The paper's experiment on CoGiRo, modern sensors, 1 kHz."""
    shutil.rmtree(RUN, ignore_errors=True)
    RUN.parent.mkdir(parents=True, exist_ok=True)
    program(TOP / "build/bin/inertiactl", "simulate", COGIRO, "--faults", "modern", "--seed", 1, "-o", RUN)
    program(TOP / "build/bin/inertiactl", "compile", RUN / "robot.toml", "-o", RUN / "robot.cfg")


def core_step():
    print(program(TOP / "build/test/bench/step", RUN / "robot.cfg", RUN / "can.log", RUN / "tracker.csv"))


def whitened_rows(n_blocks):
    """Blocks [n, 6, 11] of regressor rows and right-hand sides of a moving body, unit noise."""
    rng = np.random.default_rng(1)
    s, w, alpha = rng.normal(0, 2, (3, n_blocks, 3))
    s[:, 2] += 9.81
    H = core.regressor(s, w, alpha)
    theta = np.array([161.0, -0.2, -12.4, -19.0, 98.2, 91.1, 32.6, 2.7, -0.1, -0.4])
    return np.concatenate([H, (H @ theta + rng.normal(size=(n_blocks, 6)))[:, :, None]], axis=2)


def by_padasip(rows):
    peer = padasip.filters.FilterRLS(10, mu=1.0, eps=1e-4, w=np.zeros(10))
    for h in rows.reshape(-1, 11):
        peer.adapt(h[10], h[:10])
    return peer.w


def by_filterpy(rows):
    peer = KalmanFilter(dim_x=10, dim_z=6)
    peer.x, peer.P, peer.R = np.zeros(10), 1e4 * np.eye(10), np.eye(6)
    for block in rows:
        peer.update(block[:, 10], H=block[:, :10])
    return peer.x


def by_statsmodels(rows):
    """RecursiveLS starts diffuse and wants all rows at once; its filter is the update, row by row."""
    flat = rows.reshape(-1, 11)
    model = RecursiveLS(flat[:, 10], flat[:, :10])
    return model.fit().recursive_coefficients.filtered[:, -1]


def update():
    rows, few = whitened_rows(20_000), 300
    file = RUN.parent / "rows.bin"
    rows.tofile(file)
    ours = dict(line.split(maxsplit=1) for line in program(TOP / "build/test/bench/update", file).splitlines())
    eigen = ours.pop("eigen_version").split()[0]
    found = {name: tuple(float(v) for v in value.split()) for name, value in ours.items()}

    reference = core.Rls(np.zeros(10), 1e4 * np.eye(10))
    for block in rows[:few]:
        reference.update(block[:, :10], block[:, 10], np.eye(6))
    table = [
        ("core: P = U D U^T, C", *found["core"]),
        (f"Eigen {eigen}: P [10x10], row by row", *found["scalar_rows"]),
        (f"Eigen {eigen}: P [10x10], six rows at once", *found["kalman"]),
    ]
    peers = {"filterpy": by_filterpy, "padasip": by_padasip, "statsmodels": by_statsmodels}
    for name, peer in ((f"{package} {version(package)}", peer) for package, peer in peers.items()):
        seconds = best(3, lambda peer=peer: peer(rows[:few]))
        difference = np.abs(peer(rows[:few]) - reference.x).max() / np.abs(reference.x).max()
        table.append((name, 1e9 * seconds / few, difference))
    print("Update by 6 rows, 10 parameters, same rows; difference of the result from the core's:")
    for name, ns, difference in table:
        print(f"  {name:42} {1e-3 * ns:9.3f} us {ns / found['core'][0]:8.2f} x the time   {difference:.0e}")
    print()


def by_inertiad():
    program(TOP / "build/bin/inertiad", "-v", "--config", RUN / "robot.cfg", "--bus", f"file:{RUN}/can.log",
            "--tracker", f"file:{RUN}/tracker.csv", "--lcm", "none", "--estimate", RUN / "estimate.json")  # fmt: skip


def by_python(parts):
    """python-can reads, cantools decodes, numpy brings forces and position to the IMU's time; no estimate yet."""
    database = cantools.database.load_file(RUN / "platform.dbc")
    columns = {}
    start = time.perf_counter()
    for message in can.LogReader(RUN / "can.log"):
        values = database.decode_message(message.arbitration_id, message.data, decode_choices=False)
        columns.setdefault(message.arbitration_id, []).append((message.timestamp, *values.values()))
    parts["read and decode"] = time.perf_counter() - start
    arrays = [np.array(rows) for _, rows in sorted(columns.items())]
    t = arrays[0][:, 0]
    tracker = np.loadtxt(RUN / "tracker.csv", delimiter=",", skiprows=1)
    for table in (*arrays[1:], tracker):
        for column in table.T[1:]:
            np.interp(t, table[:, 0], column)
    parts["numpy"] = time.perf_counter() - start - parts["read and decode"]


def file_to_estimate():
    with (RUN / "can.log").open() as log:
        frames = sum(1 for _ in log)
    parts = {}
    ours, theirs = best(5, by_inertiad), best(1, lambda: by_python(parts))
    print(f"File to estimate, {frames} frames (candump log, speed=0, start of the process included):")
    peers = f"python-can {can.__version__} + cantools {cantools.__version__} + numpy {np.__version__}"
    for name, seconds in (("inertiad, to estimate.json", ours), (f"{peers}, aligned rows only", theirs)):
        print(f"  {name:70} {frames / seconds:10.0f} frames/s {seconds / ours:7.1f} x the time")
    print("  of which " + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in parts.items()))


if __name__ == "__main__":
    simulate()
    core_step()
    update()
    file_to_estimate()
    sys.exit(0)
