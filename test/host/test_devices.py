# SPDX-License-Identifier: Apache-2.0
"""Real sensors' DBC files: against their documents, against cantools bit for bit, and in the daemon on two buses."""

import json
import struct
import subprocess
from pathlib import Path

import cantools
import devices
import pytest
from conftest import TOP
from hypothesis import given, settings
from hypothesis import strategies as st

import inertiad_core
from inertiad.base import quantity
from inertiad.robot import configuration, dbc, description
from inertiad.robot.dbc import Binding
from inertiad.run import canlog

DATABASES = {
    (name, bus): cantools.database.load_file(devices.DEVICES / f"{file}.dbc")
    for name, buses in devices.BUSES.items()
    for bus, (file, _) in enumerate(buses)
}
MESSAGES = [(*place, message) for place, database in DATABASES.items() for message in database.messages]
ROBOTS = {name: description.load(devices.DEVICES / f"{name}.toml") for name in devices.BUSES}
BINDINGS = {name: dbc.bind(robot, name) for name, robot in ROBOTS.items()}
CONFIGS = {name: inertiad_core.Config(configuration.compile_robot(robot, name)) for name, robot in ROBOTS.items()}

DOCUMENTED = {  # identifier -> what the device's document says of its bytes, and the value of one count
    ("xsens_gsv4", 0x005): (">I", 1e-6),
    ("xsens_gsv4", 0x021): (">4h", 1 / 32767),
    ("xsens_gsv4", 0x032): (">3h", 2**-9),
    ("xsens_gsv4", 0x034): (">3h", 2**-8),
    ("xsens_gsv4", 0x610): (">4H", 0.16),
    ("xsens_gsv4", 0x620): (">4H", 0.16),
    ("sbg_canopen", 0x120): ("<IHh", 1e-6),
    ("sbg_canopen", 0x121): ("<3h", 1e-2),
    ("sbg_canopen", 0x122): ("<3h", 1e-3),
    ("sbg_canopen", 0x131): ("<4h", 1 / 32767),
    **{("sbg_canopen", 0x280 + node): ("<fh", 1.0) for node in range(1, 9)},
}


def bound(name: str, bus: int, can_id: int) -> list[Binding]:
    return [b for b in BINDINGS[name] if (b.bus, b.can_id) == (bus, can_id)]


def bits(signal: cantools.database.can.Signal, raw: float) -> int:
    """A raw value of cantools as the 64 bits that our decoder gives."""
    if not signal.is_float:
        return int(raw) % (1 << 64)
    return int.from_bytes(struct.pack("<f", raw), "little")


@settings(max_examples=60, deadline=None)
@pytest.mark.parametrize(("name", "bus", "message"), MESSAGES, ids=lambda x: getattr(x, "name", str(x)))
@given(data=st.data())
def test_random_bytes_decode_as_by_cantools(name, bus, message, data):
    payload = data.draw(st.binary(min_size=message.length, max_size=message.length))
    raw = message.decode(payload, decode_choices=False, scaling=False)
    physical = message.decode(payload, decode_choices=False)
    for s in message.signals:
        big_endian, is_signed = s.byte_order == "big_endian", s.is_signed and not s.is_float
        found = inertiad_core.decode_raw(payload, s.start, s.length, big_endian, is_signed)
        assert found == bits(s, raw[s.name]) or raw[s.name] != raw[s.name]  # one NaN is as good as another
    values = inertiad_core.decode_frame(CONFIGS[name], bus, message.frame_id, payload)
    for b in bound(name, bus, message.frame_id):
        value, place = physical[b.signal.name], quantity.QUANTITIES[b.quantity]
        inside = b.minimum == b.maximum or (abs(value) < float("inf") and b.minimum <= raw_si(b, raw) <= b.maximum)
        assert (place in values) == inside
        if inside:
            assert values[place] == raw_si(b, raw)
            factor = {"us": 1e-6, "count": 0.16}.get(b.signal.unit or "", 1.0)
            sense = -1.0 if b.quantity in ("q_w", "q_y") and name == "sbg_canopen" else 1.0
            if b.quantity not in quantity.COUNTER:
                assert values[place] == pytest.approx(value * factor * sense, rel=1e-12, abs=1e-12)


def raw_si(binding: Binding, raw: dict) -> float:
    """SI from cantools' raw value, operation by operation as the core does it."""
    return float(raw[binding.signal.name]) * binding.scale + binding.offset


@pytest.mark.parametrize("file", sorted(devices.RECORDINGS.glob("*.log")), ids=lambda path: path.stem)
def test_recording_reads_as_the_documents_say(file: Path):
    log = canlog.read(file)
    name = next(n for n, buses in devices.BUSES.items() if file.stem in [dbc_file for dbc_file, _ in buses])
    bus = [dbc_file for dbc_file, _ in devices.BUSES[name]].index(file.stem)
    n_read = 0
    for can_id, length, payload in zip(log.can_id.tolist(), log.length.tolist(), log.data, strict=True):
        payload = payload[:length].tobytes()
        found = inertiad_core.decode_frame(CONFIGS[name], bus, can_id, payload)
        if (name, can_id) not in DOCUMENTED:
            assert not found  # in the DBC, but nothing is bound to it
            continue
        layout, per_count = DOCUMENTED[name, can_id]
        counts = struct.unpack(layout, payload)
        for b in bound(name, bus, can_id):
            count = counts[[s.name for s in b.message.signals].index(b.signal.name)]
            expected = (count - 32768 if layout == ">4H" else count) * per_count
            if b.quantity in quantity.COUNTER:
                expected = count
            if name == "sbg_canopen" and b.quantity in ("q_w", "q_y"):
                expected = -expected
            assert found[quantity.QUANTITIES[b.quantity]] == pytest.approx(expected, rel=1e-12, abs=1e-12)
            n_read += 1
    assert n_read >= 80


def test_recordings_are_what_the_emulators_make(tmp_path: Path):
    made = dict(devices.recordings(tmp_path))
    assert sorted(made) == sorted(path.name for path in devices.RECORDINGS.iterdir())
    for (name, bus), database in DATABASES.items():
        file = f"{devices.BUSES[name][bus][0]}.log"
        kept = [line.split()[2].split("#") for line in (devices.RECORDINGS / file).read_text().splitlines()]
        again = [line.split()[2].split("#") for line in made[file].splitlines()]
        assert [can_id for can_id, _ in kept] == [can_id for can_id, _ in again]
        for (can_id, old), (_, new) in zip(kept, again, strict=True):
            message = database.get_message_by_frame_id(int(can_id, 16))
            a, b = (message.decode(bytes.fromhex(text), scaling=False) for text in (old, new))
            assert a == pytest.approx(b, rel=1e-6, abs=1.001)  # another machine's rounding: one count


@pytest.mark.parametrize("seed", [1000, 1001])
@pytest.mark.parametrize("name", sorted(devices.BUSES))
def test_daemon_reads_the_devices_on_two_buses_and_finds_the_truth(name: str, seed: int, tmp_path: Path):
    # given: what the emulated devices sent on two buses, encoded by cantools
    devices.record(name, tmp_path, seed=seed)
    config, estimate = tmp_path / "robot.cfg", tmp_path / "estimate.json"
    robot = description.load(tmp_path / "robot.toml").model_copy(update={"nominal": None})  # the daemon is not told
    configuration.write(config, robot, "robot.toml")
    # when: the daemon reads both
    command = [TOP / "build/bin/inertiad", "-v", "--config", config, "--lcm", "none", "--estimate", estimate]
    for bus in range(2):
        command += ["--bus", f"file:{tmp_path / 'can.log'}?interface=can{bus}"]
    command += ["--tracker", f"file:{tmp_path / 'tracker.csv'}"]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=60, check=True)
    rows = [line.removeprefix("inertiad: ").split() for line in done.stderr.splitlines()]
    counted = {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}
    # then: every frame is accounted for, every sample whole, and the body is the true one
    sent = [line.split()[2].split("#")[0] for line in (tmp_path / "can.log").read_text().splitlines()]
    ours = [can_id for can_id in sent if (name, int(can_id, 16)) in DOCUMENTED]
    assert counted["bus0.frames"] + counted["bus1.frames"] == len(sent)
    assert counted["decode.decoded"] == len(ours)
    assert counted["decode.unknown_id"] == len(sent) - len(ours)
    n_imu = sent.count(sent[0])
    for sensor in ("imu", "force"):
        assert counted[f"group.{sensor}.complete"] == n_imu
        assert counted[f"group.{sensor}.incomplete"] == counted[f"group.{sensor}.duplicate_frames"] == 0
    assert counted["clock.imu.steps"] == 0
    found, truth = json.loads(estimate.read_text()), json.loads((tmp_path / "truth.json").read_text())
    assert found["consistent"]
    for key in ("mass", "cog", "inertia_cog"):
        values, stds, true = ([x] if key == "mass" else x for x in (*found[key].values(), truth[key]))
        for value, std, expected in zip(values, stds, true, strict=True):
            assert abs(value - expected) <= 3.0 * std, f"{key}: {value} +- {std}, true {expected}"
    assert found["mass"]["std"] < 1.0


def test_wrong_tick_of_the_device_clock_is_counted(tmp_path: Path):
    devices.record("xsens_gsv4", tmp_path, rate=50.0, hold=0.2)
    file = tmp_path / "robot.toml"
    right = 'imu_time = "MTI_SAMPLE_TIME.time"'
    text = file.read_text()
    assert right in text
    for tick, is_right in ((1e-6, True), (1e-4, False)):
        file.write_text(text.replace(right, f'imu_time = {{ signal = "MTI_SAMPLE_TIME.time", scale = {tick} }}'))
        config = inertiad_core.Config(configuration.compile_robot(description.load(file), "robot.toml"))
        log = str(tmp_path / "can.log")
        run = inertiad_core.read_run(config, [log, log], ["can0", "can1"], str(tmp_path / "tracker.csv"))
        assert (run.counters["clock.imu.steps"] == 0) == is_right
