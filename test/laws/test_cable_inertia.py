# SPDX-License-Identifier: Apache-2.0
"""The cables' own inertia: the core's against a chain of masses that is driven at one end, where it holds and where it
stops; the simulator's against Newton's law for the pieces of a straight cable that is paid out."""

import numpy as np
import pytest
from robots import checked, cogiro

import inertiad_core as core

GRAVITY = 9.81
WEIGHT, TENSION, N_MASSES = 2.5, 500.0, 60


def first_frequency(length):
    """Hz of the first transverse mode of a taut string."""
    return np.sqrt(TENSION * GRAVITY / WEIGHT) / (2.0 * length)


def force_of_a_chain(length, omega):
    """Steady amplitude [N m^-1] of the transverse force on the end of a chain of masses, driven by 1 m at omega.

    Masses on a taut massless thread, the first fixed, the last driven: the dynamic stiffness of the chain, solved as
    linear equations, minus that of the thread without masses.
    """
    step = length / N_MASSES
    mass = WEIGHT / GRAVITY * step
    k = TENSION / step
    A = np.diag(np.full(N_MASSES - 1, 2.0 * k - omega**2 * mass))
    A += np.diag(np.full(N_MASSES - 2, -k), 1) + np.diag(np.full(N_MASSES - 2, -k), -1)
    drive = np.zeros(N_MASSES - 1)
    drive[-1] = k
    y = np.linalg.solve(A, drive)
    end = -k * (1.0 - y[-1]) + 0.5 * mass * omega**2
    return end + TENSION / length


def one_cable(length):
    """CoGiRo with the first cable alone, straight up from the IMU, not compiled yet."""
    robot = cogiro()
    robot.n_cables = 1
    cable = robot.cable[0]
    cable.anchor, cable.attachment, cable.pulley_radius = [0.0, 0.0, length], [0.0, 0.0, 0.0], 0.0
    cable.weight_per_length = WEIGHT
    robot.imu_position = [0.0, 0.0, 0.0]
    return robot


def force_of_the_core(length, omega):
    """The same amplitude by cable_inertia.h: acceleration -omega^2 per metre across the cable."""
    s = np.array([[-(omega**2), 0.0, GRAVITY]])
    zero, R = np.zeros((1, 3)), np.eye(3)[None]
    return core.cable_inertia(checked(one_cable(length)), s, zero, zero, zero, R)[0, 0]


@pytest.mark.parametrize("length", [3.0, 8.0, 30.0])
@pytest.mark.parametrize(("share", "tolerance"), [(0.05, 0.005), (0.25, 0.05), (0.5, 0.25)])
def test_a_third_of_the_mass_is_what_a_chain_drags(length, share, tolerance, measured):
    omega = 2.0 * np.pi * share * first_frequency(length)
    chain, core_ = force_of_a_chain(length, omega), force_of_the_core(length, omega)
    assert chain > 0.0
    assert core_ == pytest.approx(chain, rel=tolerance)
    if length == 8.0:
        measured(f"cable inertia at {share:g} of the first mode: {100.0 * (core_ / chain - 1.0):+.1f} % of a chain's")


def test_near_the_first_mode_it_does_not_hold():
    omega = 2.0 * np.pi * 0.9 * first_frequency(8.0)
    assert force_of_the_core(8.0, omega) < 0.5 * force_of_a_chain(8.0, omega)


def path_of_the_end(t):
    """Attachment B [N, 3] of a cable from the origin: it swings sideways and is paid out."""
    return np.stack([1.0 + 0.8 * np.sin(1.3 * t), 0.6 * np.cos(0.9 * t), -6.0 - 1.1 * np.sin(0.7 * t)], axis=-1)


def moments_of_the_pieces(t0, h=1e-3, n=4000):
    """Force across the line [3] that the end needs, and what the pull along it grows by from winch to end, in N.

    Pieces of cable keep their place from the end, as an inextensible cable has it, and lie on the line from the origin.
    Their accelerations are second differences of their positions.
    """
    B = path_of_the_end(t0 + h * np.array([-1.0, 0.0, 1.0]))
    L = np.linalg.norm(B, axis=1)
    e = B / L[:, None]
    from_end = (np.arange(n) + 0.5) * L[1] / n
    place = (L[:, None] - from_end)[:, :, None] * e[:, None, :]
    force = WEIGHT / GRAVITY * L[1] / n * (place[2] - 2.0 * place[1] + place[0]) / h**2
    along = force @ e[1]
    across = ((L[1] - from_end) / L[1]) @ (force - along[:, None] * e[1])
    return across, along.sum(), e[1]


@pytest.mark.parametrize("force_at", ["platform", "winch"])
@pytest.mark.parametrize("t", [0.3, 1.7, 4.2])
def test_simulated_cable_is_its_pieces(t, force_at):
    robot = one_cable(1.0)
    cable = robot.cable[0]
    cable.anchor, cable.force_at = [0.0, 0.0, 0.0], ["platform", "winch"].index(force_at)
    h = 1e-4
    before, B, after = path_of_the_end(t + h * np.array([-1.0, 0.0, 1.0]))
    rows = [B, (after - before) / (2 * h), (after - 2.0 * B + before) / h**2, np.eye(3), np.zeros(3), np.zeros(3)]
    wrench = core.cable_mass_wrench(checked(robot), *(np.ascontiguousarray(x)[None] for x in rows))[0]
    across, along, e = moments_of_the_pieces(t)
    expected = -across + (along * -e if force_at == "winch" else 0.0)
    assert np.linalg.norm(across) > 0.1
    assert np.allclose(wrench[:3], expected, atol=2e-4 * np.linalg.norm(expected))
    assert np.allclose(wrench[3:], 0.0, atol=1e-9)
