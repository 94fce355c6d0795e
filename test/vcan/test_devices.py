# SPDX-License-Identifier: Apache-2.0
"""Real sensors' frames on two real buses at once: an Xsens MTi 600 on vcan0, two GSV-4, which have no clock, on vcan1.

Only the standard library is imported: Python starts slowly in an emulated guest.
"""

import json
import signal
import subprocess
import time
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
RUN = TOP / "build/vcan/devices"
URL = "udpm://239.255.76.67:7667?ttl=0"
PATIENCE = 60.0  # s; an emulated guest is slow
UNBOUND = {"006", "011", "022"}  # counter, status and Euler angles of the MTi: in its DBC, but nobody asked for them


def assert_is_the_truth(found: dict, truth: dict) -> None:
    assert found["consistent"]
    for key in ("mass", "cog", "inertia_cog"):
        values, stds, true = ([x] if key == "mass" else x for x in (found[key]["value"], found[key]["std"], truth[key]))
        for value, std, expected in zip(values, stds, true, strict=True):
            assert abs(value - expected) <= 3.0 * std, f"{key}: {value} +- {std}, true {expected}"
    assert found["mass"]["std"] < 2.0  # learnt


def test_imu_and_two_amplifiers_on_two_buses_are_all_taken_and_tell_the_truth(tmp_path: Path):
    # given: the daemon on both buses
    frames = [line.split()[1:] for line in (RUN / "can.log").read_text().splitlines()]
    n = {bus: sum(name == f"can{bus}" for name, _ in frames) for bus in range(2)}
    buses = ["--bus", "socketcan:vcan0?filter=off", "--bus", "socketcan:vcan1?filter=off"]
    command = [TOP / "build/bin/inertiad", "-v", "--config", RUN / "robot.cfg", *buses, "--lcm", URL]
    command += ["--estimate", tmp_path / "estimate.json"]
    daemon = subprocess.Popen([str(c) for c in command], stderr=subprocess.PIPE, text=True)
    try:
        time.sleep(5.0)  # it has no other sign of life than LCM
        # when: both buses are played at their time
        player = ["canplayer", "-I", str(RUN / "can.log"), "vcan0=can0", "vcan1=can1"]
        subprocess.run(player, check=True, timeout=300)
        time.sleep(2.0)
        daemon.send_signal(signal.SIGTERM)
        _, text = daemon.communicate(timeout=PATIENCE)
    finally:
        daemon.kill()
    # then: nothing is lost on either bus, every bound frame decoded, every sample whole or counted
    lines = [line.removeprefix("inertiad: ").split() for line in text.splitlines()]
    counted = {row[0]: int(row[1]) for row in lines if len(row) == 2 and row[1].isdigit()}
    assert daemon.returncode == 0, text
    for bus in range(2):
        assert counted[f"bus{bus}.frames"] == n[bus]
        assert counted[f"bus{bus}.dropped_by_kernel"] == 0
    n_unbound = sum(frame.split("#")[0] in UNBOUND for _, frame in frames)
    assert counted["decode.unknown_id"] == n_unbound
    assert counted["decode.decoded"] == len(frames) - n_unbound
    for sensor, n_samples in (("imu", n[0] // 7), ("force", n[1] // 2)):
        whole, torn = counted[f"group.{sensor}.complete"], counted[f"group.{sensor}.incomplete"]
        assert n_samples <= whole + torn <= 1.2 * n_samples  # a machine that stalls tears some in two
        assert whole >= 0.7 * n_samples
    assert_is_the_truth(*(json.loads(path.read_text()) for path in (tmp_path / "estimate.json", RUN / "truth.json")))
