# SPDX-License-Identifier: Apache-2.0
"""The Python bindings refuse arrays of wrong sizes and numbers out of range, each with a line; none crashes."""

import numpy as np
import pytest
from conftest import COGIRO

import inertiad_core
import inertiad_replay
from inertiad.robot import description
from inertiad.run import reader

N = 20
T = np.arange(N, dtype=np.int64) * 10_000_000


@pytest.fixture(scope="module")
def config():
    return reader.config_of(description.load(COGIRO / "robot.toml"), "robot.toml")


def zeros(*shape: int) -> np.ndarray:
    return np.zeros(shape)


@pytest.mark.parametrize(
    ("release", "priority", "took"),
    [
        ([0.0, 1.0, 2.0], [1], [1.0, 1.0, 1.0]),
        ([0.0, 1.0, 2.0], [1, 2, 3], []),
        ([], [1], [1.0]),
        ([0.0, float("nan")], [1, 2], [1.0, 1.0]),
        ([0.0, 1.0], [1, 2], [float("nan"), 1.0]),
        ([0.0, float("inf")], [1, 2], [1.0, 1.0]),
    ],
)
def test_arbitrate(release, priority, took):
    with pytest.raises(ValueError, match=r"priority|took|release"):
        inertiad_core.arbitrate(release, priority, took)


@pytest.mark.parametrize(
    ("t", "imu", "f", "t_position", "position"),
    [
        (T, zeros(N - 1, 10), zeros(N, 8), T, zeros(N, 3)),
        (T, zeros(N, 10), zeros(1, 8), T, zeros(N, 3)),
        (T, zeros(N, 10), zeros(N, 8), T, zeros(2, 3)),
        (T, zeros(N, 9), zeros(N, 8), T, zeros(N, 3)),
        (T, zeros(N, 10), zeros(N, 7), T, zeros(N, 3)),
        (T - 2 * 10**17, zeros(N, 10), zeros(N, 8), T, zeros(N, 3)),
        (T + 2**62 + 2**61, zeros(N, 10), zeros(N, 8), T + (2**63 - 2**40), zeros(N, 3)),
    ],
)
def test_align_signals(config, t, imu, f, t_position, position):
    with pytest.raises(ValueError):
        inertiad_core.align_signals(config, t, imu, f, t_position, position)


@pytest.mark.parametrize("t_ns", [-(2**63), -1, 9 * 10**18, 2**63 - 1])
def test_pipeline_refuses_stamps_out_of_range(config, t_ns):
    pipeline = inertiad_core.Pipeline(config)
    assert pipeline.push_frame(t_ns, 0, 0x120, bytes(8)) < 0
    assert pipeline.push_position(t_ns, zeros(3)) < 0
    assert pipeline.counters["decode.frames"] == 0 and pipeline.counters["align.position.samples"] == 0


@pytest.mark.parametrize(
    "call",
    [
        lambda c: inertiad_core.calibrated(c, zeros(3)),
        lambda c: inertiad_core.calibrated(c, np.full(len(inertiad_core.systematic_std(c)), np.nan)),
        lambda c: inertiad_core.decode_raw(bytes(8), -1, 8, False, False),
        lambda c: inertiad_core.decode_raw(bytes(8), 0, 65, False, False),
        lambda c: inertiad_core.decode_raw(bytes(8), 512, 8, False, False),
        lambda c: inertiad_core.decode_frame(c, 8, 1, bytes(8)),
        lambda c: inertiad_core.systematic_table(17),
        lambda c: inertiad_core.linear_parameters(-1),
        lambda c: inertiad_core.Clock(float("nan")),
        lambda c: inertiad_core.Clock().map(float("nan"), 0),
        lambda c: inertiad_core.Clock().map(0.0, 2**63 - 1),
        lambda c: inertiad_core.averages(c, T - 2 * 10**17, zeros(N, 3), zeros(N, 3), zeros(N, 6)),
        lambda c: inertiad_core.Rows(T - 2 * 10**17, zeros(N, 3), zeros(N, 3), zeros(N, 4), zeros(N, 3), zeros(N, 8)),
        lambda c: inertiad_replay.play(
            np.zeros(1, np.uint8), np.array([0, 1]), np.array([2**63 - 1]), np.zeros(1, np.uint8), [1], 0, 0
        ),
        lambda c: inertiad_replay.play(
            np.zeros(1, np.uint8), np.array([0, 2]), np.zeros(1, np.int64), np.zeros(1, np.uint8), [1], 0, 0
        ),
    ],
)
def test_values_out_of_range(config, call):
    with pytest.raises(ValueError):
        call(config)


def test_a_device_time_that_no_clock_shows_stays_in_range():
    clock = inertiad_core.Clock()
    clock.map(0.0, 10**18)
    for device in (1e300, -1e300, 1e18, -1e18):
        assert -(10**17) <= clock.map(device, 10**18 + 1) <= 9 * 10**18
        assert -(10**17) <= clock.at(device) <= 9 * 10**18
