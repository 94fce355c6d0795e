# SPDX-License-Identifier: Apache-2.0
"""The cables' own inertia against a chain of masses that is driven at one end: where it holds and where it stops."""

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
    """CoGiRo with the first cable alone, straight up from the IMU."""
    robot = cogiro()
    robot.n_cables = 1
    cable = robot.cable[0]
    cable.anchor, cable.attachment, cable.pulley_radius = [0.0, 0.0, length], [0.0, 0.0, 0.0], 0.0
    cable.weight_per_length = WEIGHT
    robot.imu_position = [0.0, 0.0, 0.0]
    return checked(robot)


def force_of_the_core(length, omega):
    """The same amplitude by cable_inertia.h: acceleration -omega^2 per metre across the cable."""
    s = np.array([[-(omega**2), 0.0, GRAVITY]])
    zero, R = np.zeros((1, 3)), np.eye(3)[None]
    return core.cable_inertia(one_cable(length), s, zero, zero, zero, R)[0, 0]


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
