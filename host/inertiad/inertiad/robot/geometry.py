# SPDX-License-Identifier: Apache-2.0
"""Plausibility of a robot description: values that are allowed, but that no robot or bus is likely to have."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.finding import Finding, lines
from inertiad.base.table import Array
from inertiad.robot import configuration
from inertiad.robot.description import Robot
from inertiad.robot.template import example_geometry

FAR: Final = 20.0
"""times the usual distance of the others from the middle"""
REACH_MAX: Final = 1000.0
"""m: anchors beyond this are more likely in mm"""
POINT: Final = 1e-3
"""m: places nearer to each other are one"""
RANK: Final = 1e-6
"""share of the largest singular value below which one counts as zero"""
BITRATES: Final = (
    *(5_000, 10_000, 20_000, 33_333, 40_000, 47_619, 50_000, 62_500, 80_000, 83_333, 95_238, 100_000, 125_000),
    *(200_000, 250_000, 400_000, 500_000, 666_667, 800_000, 1_000_000),
)
"""bit/s that controllers and CiA 301 or the makers' documents name"""
DATA_BITRATE_MAX: Final = 10_000_000
DIRECTIONS: Final = ("force along x", "force along y", "force along z")
TURNS: Final = ("moment about x", "moment about y", "moment about z")


def box(robot: Robot) -> Array:
    """The usual workspace: least and greatest x y z [6] of P, m: a quarter of the anchors' reach about their middle,
    27 to 50 % of their height.

    Heights count from the world's z = 0, or from the lowest anchor where that is below it.
    """
    anchor = np.array([cable.anchor for cable in robot.cable])
    low, high = anchor.min(axis=0), anchor.max(axis=0)
    middle, reach = 0.5 * (low + high), 0.125 * (high - low)
    floor, top = min(0.0, low[2]), low[2]
    z = (floor + 0.27 * (top - floor), floor + 0.5 * (top - floor)) if top > floor else (high[2] + 1.0, high[2] + 2.0)
    return np.array([*(middle - reach)[:2], z[0], *(middle + reach)[:2], z[1]])


def _outliers(points: Array) -> list[tuple[int, float, float]]:
    """(number, its distance from the median place, the greatest of the others) of places far from all others."""
    if len(points) < 4:
        return []
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    found = []
    for i, far in enumerate(distance):
        others = np.delete(distance, i)
        if far > FAR * max(float(np.median(others)), POINT):
            found.append((i, float(far), float(others.max())))
    return found


def _size(points: Array) -> float:
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())


def _places(robot: Robot) -> Iterator[Finding]:
    for key, what in (("anchor", "anchors"), ("attachment", "attachments")):
        points = np.array([getattr(cable, key) for cable in robot.cable])
        for i, far, others in _outliers(points):
            yield Finding(
                f"far_{key}",
                "care",
                f"cable[{i + 1}].{key} is {far:.4g} m from the middle of the {what}, no other more than {others:.3g} m",
                "check the cable's numbers: m, not mm; sign; order of x y z",
                {"cable": i + 1, "distance": far, "others": others},
            )
    anchors = np.array([cable.anchor for cable in robot.cable])
    attachments = np.array([cable.attachment for cable in robot.cable])
    if len(anchors) > 1 and _size(anchors) > REACH_MAX and not _outliers(anchors):
        yield Finding(
            "huge_robot", "care", f"the anchors reach {_size(anchors):.4g} m from their middle", "are they in mm?"
        )
    if len(anchors) > 1 and _size(attachments) > _size(anchors) and not _outliers(attachments):
        yield Finding(
            "huge_platform",
            "care",
            f"the attachments reach {_size(attachments):.3g} m from their middle, the anchors only "
            f"{_size(anchors):.3g} m: the platform would be larger than the robot",
            "give attachments in the platform frame P, in m, not in the world frame or in mm",
        )
    from_p = float(np.linalg.norm(attachments.mean(axis=0)))
    if len(anchors) > 1 and _size(attachments) <= _size(anchors) and from_p > _size(anchors):
        yield Finding(
            "far_platform_frame",
            "care",
            f"the attachments are {from_p:.3g} m from the origin of P, the robot reaches only {_size(anchors):.3g} m",
            "give attachments in the platform frame P, not in the world frame",
        )
    for key, (name, place) in {
        "imu.position": ("IMU", robot.imu.position),
        "tracker.target": ("tracked point", robot.tracker.target),
        "nominal.cog": ("nominal CoG", robot.nominal.cog if robot.nominal else [0.0, 0.0, 0.0]),
    }.items():
        away, reach = float(np.linalg.norm(place)), float(np.linalg.norm(attachments, axis=1).max())
        if away > 3.0 * reach + 1.0:
            yield Finding(
                "far_sensor",
                "care",
                f"{key}: the {name} is {away:.3g} m from P, the attachments at most {reach:.3g} m",
                "give it in the platform frame P, in m",
            )


def _examples(robot: Robot) -> Iterator[Finding]:
    example = example_geometry(robot.n_cables)
    same = [k + 1 for k, c in enumerate(robot.cable) if (c.anchor, c.attachment) == example[k]]
    if same:
        yield Finding(
            "example_places",
            "care",
            f"cables {', '.join(map(str, same))} are at the example places of inertiactl init",
            "replace anchor and attachment of each by your robot's",
            {"cables": same},
        )


def _coincident(robot: Robot) -> Iterator[Finding]:
    n = robot.n_cables
    for key, where in (("attachment", "attached to the platform at one point"), ("anchor", "anchored at one point")):
        points = np.array([getattr(cable, key) for cable in robot.cable])
        if n > 1 and _size(points) < POINT:
            yield Finding(
                f"one_{key}",
                "care",
                f"all {n} cables are {where}: they give no moment that tells CoG and inertia",
                f"give each cable its own {key}",
            )
    both = np.array([[*cable.anchor, *cable.attachment] for cable in robot.cable])
    for i in range(n):
        for j in range(i):
            if np.linalg.norm(both[i] - both[j]) < POINT:
                yield Finding(
                    "same_cable",
                    "care",
                    f"cables {j + 1} and {i + 1} have the same anchor and attachment",
                    "remove one",
                )


def _poses(robot: Robot) -> tuple[Array, Array]:
    """The middle of the usual box, level, and three more places and attitudes within it."""
    edges = box(robot)
    middle, size = 0.5 * (edges[:3] + edges[3:]), edges[3:] - edges[:3]
    shift = np.array([[0.0, 0.0, 0.0], [0.31, -0.17, 0.23], [-0.29, 0.41, -0.37], [0.13, 0.37, 0.41]])
    turn = np.array([[0.0, 0.0, 0.0], [0.21, -0.13, 0.17], [-0.11, 0.19, -0.23], [0.17, 0.07, 0.29]])
    return middle + shift * size, Rotation.from_rotvec(turn).as_matrix()


def _lost(U: Array, rank: int) -> str:
    """The coordinate of the wrench nearest to the directions beyond a rank of its left singular vectors [6, 6]."""
    return (DIRECTIONS + TURNS)[int(np.argmax(np.linalg.norm(U[:, rank:], axis=1)))]


def _mechanics(robot: Robot, config: inertiad_core.Config) -> Iterator[Finding]:
    p, R = _poses(robot)
    try:
        W, _ = inertiad_core.wrench_matrix(config, p, R, np.zeros(3))
    except ValueError as error:
        yield Finding("no_direction", "care", f"in the middle of the robot: {error}", "check anchors and attachments")
        return
    scale = np.repeat([1.0, 1.0 / configuration.platform_size(robot)], 3)
    U, singular, _ = np.linalg.svd(W * scale[:, None])
    ranks = (singular > RANK * singular[:, :1]).sum(axis=1)
    full = min(robot.n_cables, 6)
    if ranks[0] < full:
        where = "in every pose" if ranks.max() < full else "level in the middle of the robot"
        yield Finding(
            "rank",
            "care",
            f"the wrenches of {robot.n_cables} cables span only {ranks[0]} of {full} dimensions {where}: tensions give "
            f"no {_lost(U[0], int(ranks[0]))}",
            "check anchors and attachments: cables in one plane, or all through one line",
            {"rank": int(ranks[0]), "greatest_rank": int(ranks.max())},
        )
    if not any(nnls(W[k, :3], R[k].T @ [0.0, 0.0, 1.0])[1] < 0.5 for k in range(len(W))):
        yield Finding(
            "cannot_lift",
            "care",
            "in the middle of the robot no pulling cables carry a weight: every cable leads down or sideways",
            "check the anchors' heights: z of W points up",
        )


def _buses(robot: Robot) -> Iterator[Finding]:
    for number, bus in enumerate(robot.bus, start=1):
        rate = bus.bitrate
        nearest = min(BITRATES, key=lambda known: abs(known - rate))
        if rate > 0.0 and abs(rate - nearest) > 0.001 * nearest:
            yield Finding(
                "bitrate",
                "care",
                f"bus[{number}].bitrate = {rate:.9g}: no CAN bus has this bit rate",
                f"did you mean {nearest}? 0, if the stamps are those of samples",
                {"bitrate": rate},
            )
        elif rate > 0.0 and not rate <= bus.data_bitrate <= DATA_BITRATE_MAX:
            yield Finding(
                "data_bitrate",
                "care",
                f"bus[{number}].data_bitrate = {bus.data_bitrate:.9g}: no CAN FD bus has this bit rate",
                f"from bitrate = {rate:.9g} to {DATA_BITRATE_MAX}",
                {"data_bitrate": bus.data_bitrate},
            )


def compiled(robot: Robot, source: str) -> tuple[bytes, list[Finding]]:
    """Contents of robot.cfg, and what is allowed in the description but most likely wrong.

    InputError: see configuration.compile_robot(); what is most likely wrong follows, as it may be the cause.
    """
    found = [*_examples(robot), *_places(robot), *_coincident(robot), *_buses(robot)]
    try:
        data = configuration.compile_robot(robot, source)
    except InputError as error:
        raise InputError(*error.lines, *lines(found)[1:]) from None
    return data, [*found, *_mechanics(robot, inertiad_core.Config(data))]
