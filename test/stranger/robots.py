# SPDX-License-Identifier: Apache-2.0
"""Seven cable robots, from a 3 kg desk copy to a 2 t facade platform: geometry, body, sensors, declared uncertainty.

SI units. W: world frame, z up; P: platform frame. Nothing here is taken from the product.
"""

from dataclasses import dataclass, field

import numpy as np

G = 9.81


@dataclass(frozen=True)
class Robot:
    """A robot as its laboratory describes it, plus what the simulation needs to move it."""

    name: str
    anchor: np.ndarray
    """m, W [m, 3]: where a cable enters its pulley"""
    attachment: np.ndarray
    """m, P [m, 3]"""
    axis: np.ndarray
    """unit, W [m, 3]: swivel axis, the cable's travel at the anchor"""
    pulley_radius: float
    weight_per_length: float
    """N/m"""
    tension: tuple[float, float]
    """N: limits written into robot.toml"""
    mass: float
    cog: tuple[float, float, float]
    size: tuple[float, float, float]
    """m: edges of the box that holds the platform's masses"""
    home: tuple[float, float, float]
    reach: tuple[float, float, float, float, float, float]
    """amplitude of x y z [m], roll, pitch, yaw [rad]"""
    pace: float
    """Hz: the fundamental of periodic motions; rest-to-rest moves take about 1 / pace"""
    reference_tension: float = 0.0
    """N: tensions are distributed as close to it as the wrench allows"""
    imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    imu_orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rate: float = 200.0
    """Hz of IMU and force sensors"""
    tracker_rate: float = 120.0
    tracker_noise: float = 5e-4
    force_noise: float = 1.0
    """N, one sigma per sample"""
    acc_noise: float = 0.02
    """m/s2, one sigma per sample"""
    gyro_noise: float = 1e-3
    """rad/s, one sigma per sample"""
    std: dict[str, float] = field(default_factory=dict)
    """[std] of robot.toml: what the laboratory declares, and what is drawn"""
    has_nominal: bool = False
    force_at: str = "platform"
    is_elastic: bool = False
    """the pose follows from forces: fewer than six cables"""
    stiffness: float = 2e5
    """N: EA of a cable in the elastic plant"""

    @property
    def n_cables(self) -> int:
        return len(self.anchor)


DECLARED = {
    "acc_bias": 0.02,
    "gyro_bias": 1.75e-4,
    "attitude": 5.2e-3,
    "world_yaw": 8.7e-3,
    "imu_alignment": 3.5e-3,
    "imu_position": 1e-3,
    "force_offset": 5.0,
    "force_gain": 5e-3,
    "force_delay": 1e-3,
    "position_delay": 5e-3,
    "geometry": 1e-3,
    "attitude_wander": 1.75e-3,
}


def _corners(x: float, y: float, z: float) -> np.ndarray:
    """Eight anchors in pairs at four posts, one of each pair turned a little around the corner."""
    rows = []
    for sx, sy in ((-1, -1), (-1, 1), (1, 1), (1, -1)):
        rows.append((sx * x, sy * (y - 0.025 * x), z))
        rows.append((sx * (x + 0.012 * x), sy * (y - 0.06 * x), z + 0.002 * z))
    return np.array(rows)


def _crossed(x: float, y: float, z: float) -> np.ndarray:
    """Eight attachments of a suspended cuboid: bottom and top edges, each cable crossing to the other side."""
    rows = []
    for sx, sy in ((-1, -1), (-1, 1), (1, 1), (1, -1)):
        rows.append((-sx * x, sy * 0.95 * y, 0.0))
        rows.append((sx * x, -sy * 0.7 * y, z))
    return np.array(rows)


def _up(n: int, sign: float = 1.0) -> np.ndarray:
    return np.tile([0.0, 0.0, sign], (n, 1))


def _triangle(radius: float, z: float, turn: float) -> np.ndarray:
    """Six points in pairs at the corners of a triangle."""
    angle = np.deg2rad([-8, 8, 112, 128, 232, 248]) + turn
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(6, z)])


_AROUND = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)])


def _ring(x: float, y: float, z: float, order: tuple[int, ...] = (0, 1, 2, 3)) -> np.ndarray:
    """Four corners of a rectangle at a height."""
    return np.column_stack([_AROUND * [x, y], np.full(4, z)])[list(order)]


_COS45 = float(np.sqrt(0.5))

HALL = Robot(
    name="hall",
    anchor=_corners(7.2, 5.4, 5.4),
    attachment=_crossed(0.5, 0.5, 1.0),
    axis=_up(8),
    pulley_radius=0.05,
    weight_per_length=0.628,
    tension=(50.0, 5000.0),
    mass=160.0,
    cog=(0.0, -0.05, -0.1),
    size=(1.3, 1.5, 1.0),
    home=(0.0, 0.0, 2.0),
    reach=(1.0, 1.0, 0.5, 0.28, 0.28, 0.4),
    pace=0.12,
    reference_tension=600.0,
    imu_position=(0.10, -0.15, 0.30),
    imu_orientation=(_COS45, 0.0, 0.0, _COS45),
    target=(0.20, 0.10, 0.50),
    force_noise=1.5,
    std=DECLARED,
    has_nominal=True,
    stiffness=4e5,
)

DESK = Robot(
    name="desk",
    anchor=_corners(0.90, 0.68, 0.70),
    attachment=_crossed(0.065, 0.065, 0.12),
    axis=_up(8),
    pulley_radius=0.006,
    weight_per_length=0.004,
    tension=(1.0, 80.0),
    mass=3.0,
    cog=(0.002, -0.006, -0.012),
    size=(0.16, 0.18, 0.12),
    home=(0.0, 0.0, 0.27),
    reach=(0.13, 0.12, 0.06, 0.28, 0.28, 0.4),
    pace=0.35,
    reference_tension=11.0,
    imu_position=(0.015, 0.01, 0.03),
    target=(0.03, 0.02, 0.06),
    tracker_noise=1e-4,
    force_noise=0.02,
    std=DECLARED | {"force_offset": 0.1, "geometry": 3e-4, "imu_position": 1e-3},
    stiffness=5e3,
)

HEXA = Robot(
    name="hexa",
    anchor=_triangle(3.0, 4.0, 0.0),
    attachment=np.roll(_triangle(0.62, 0.10, np.pi / 3.0), 1, axis=0),
    axis=_up(6),
    pulley_radius=0.04,
    weight_per_length=0.1,
    tension=(5.0, 1500.0),
    mass=40.0,
    cog=(0.02, 0.01, -0.12),
    size=(0.9, 0.8, 0.5),
    home=(0.0, 0.0, 1.6),
    reach=(0.28, 0.28, 0.25, 0.12, 0.12, 0.25),
    pace=0.22,
    imu_position=(0.05, 0.20, -0.05),
    target=(-0.30, 0.1, 0.15),
    rate=200.0,
    force_noise=0.3,
    std=DECLARED | {"force_offset": 1.0},
    force_at="platform",
    stiffness=1.5e5,
)

FRAME = Robot(
    name="frame",
    anchor=np.vstack([_ring(2.2, 1.7, 0.0), _ring(2.2, 1.7, 3.0)]),
    attachment=np.vstack([_ring(0.22, 0.20, 0.18, (0, 2, 1, 3)), _ring(0.22, 0.20, -0.18, (3, 1, 2, 0))]),
    axis=np.vstack([_up(4, -1.0), _up(4)]),
    pulley_radius=0.03,
    weight_per_length=0.08,
    tension=(20.0, 2500.0),
    mass=25.0,
    cog=(0.01, -0.02, 0.015),
    size=(0.55, 0.5, 0.45),
    home=(0.0, 0.0, 1.5),
    reach=(0.4, 0.3, 0.35, 0.35, 0.35, 0.4),
    pace=0.3,
    reference_tension=450.0,
    imu_position=(-0.08, 0.05, 0.1),
    imu_orientation=(0.0, 1.0, 0.0, 0.0),
    target=(0.1, 0.1, 0.22),
    force_noise=0.5,
    std=DECLARED | {"force_offset": 2.0, "geometry": 5e-4},
    has_nominal=True,
    stiffness=3e4,
)

FACADE = Robot(
    name="facade",
    anchor=np.vstack([_ring(11.0, 3.0, 19.0), _ring(10.0, 2.2, 19.3)]),
    attachment=np.vstack([_ring(1.2, 1.0, 0.0, (0, 2, 1, 3)), _ring(1.32, 1.0, 1.9, (1, 3, 0, 2))]),
    axis=_up(8),
    pulley_radius=0.12,
    weight_per_length=10.0,
    tension=(300.0, 40000.0),
    mass=2000.0,
    cog=(0.1, -0.05, 0.5),
    size=(4.2, 1.6, 2.0),
    home=(0.0, 0.0, 7.5),
    reach=(2.5, 0.3, 2.5, 0.06, 0.06, 0.06),
    pace=0.07,
    reference_tension=4500.0,
    imu_position=(0.5, 0.2, 1.0),
    target=(1.0, -0.7, 1.8),
    rate=100.0,
    tracker_rate=60.0,
    tracker_noise=1e-3,
    force_noise=6.0,
    std=DECLARED | {"force_offset": 30.0, "geometry": 3e-3, "imu_position": 5e-3},
    has_nominal=True,
    stiffness=4e6,
)

FOUR = Robot(
    name="four",
    anchor=np.array([(-2.8, -2.6, 3.6), (-2.8, 2.6, 3.6), (2.8, 2.6, 3.6), (2.8, -2.6, 3.6)]),
    attachment=np.array([(-0.28, -0.22, 0.16), (-0.28, 0.22, 0.16), (0.28, 0.22, 0.16), (0.28, -0.22, 0.16)]),
    axis=_up(4),
    pulley_radius=0.03,
    weight_per_length=0.0,
    tension=(2.0, 400.0),
    mass=15.0,
    cog=(0.01, 0.005, -0.04),
    size=(0.6, 0.5, 0.35),
    home=(0.0, 0.0, 1.4),
    reach=(0.6, 0.5, 0.3, 0.10, 0.10, 0.12),
    pace=0.16,
    imu_position=(0.05, 0.03, -0.05),
    target=(0.1, -0.1, 0.2),
    force_noise=0.1,
    std=DECLARED | {"force_offset": 1.0},
    is_elastic=True,
    stiffness=4e4,
)

LAB = Robot(
    name="lab",
    anchor=np.array([(1.05, -1.15, 1.85), (1.05, 1.15, 1.85), (-1.05, 1.15, 1.85), (-1.05, -1.15, 1.85)]),
    attachment=np.array([(0.08, -0.08, 0.27), (0.08, 0.08, 0.27), (-0.08, 0.08, 0.27), (-0.08, -0.08, 0.27)]),
    axis=np.array([(1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)]),
    pulley_radius=0.03,
    weight_per_length=0.0,
    tension=(1.0, 400.0),
    mass=13.0,
    cog=(0.002, 0.003, 0.17),
    size=(0.25, 0.32, 0.25),
    home=(0.0, 0.0, 0.7),
    reach=(0.3, 0.3, 0.2, 0.12, 0.12, 0.12),
    pace=0.20,
    imu_position=(0.03, 0.0, 0.1),
    target=(0.0, 0.0, 0.0),
    rate=100.0,
    tracker_rate=100.0,
    force_noise=0.15,
    std=DECLARED | {"force_offset": 8.0, "force_gain": 0.03},
    force_at="winch",
    is_elastic=True,
    stiffness=3e4,
)

ROBOTS = {r.name: r for r in (HALL, DESK, HEXA, FRAME, FACADE, FOUR, LAB)}


@dataclass(frozen=True)
class Body:
    """Point masses [kg] at points [m, P]: a rigid body without a formula for its inertia."""

    mass: np.ndarray
    point: np.ndarray

    def moments(self) -> dict[str, object]:
        """mass, cog, inertia_cog (xx yy zz yz xz xy, matrix entries) summed over the points."""
        m = float(self.mass.sum())
        c = self.mass @ self.point / m
        x, y, z = (self.point - c).T
        w = self.mass
        entries = [
            w @ (y * y + z * z), w @ (x * x + z * z), w @ (x * x + y * y), -w @ (y * z), -w @ (x * z), -w @ (x * y)
        ]  # fmt: skip
        return {"mass": m, "cog": c.tolist(), "inertia_cog": [float(v) for v in entries]}

    def scaled(self, factor: float) -> "Body":
        return Body(self.mass * factor, self.point)

    def with_load(self, mass: float, at: np.ndarray, edge: float) -> "Body":
        """The body with eight equal masses at the corners of a cube around a point."""
        corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.5 * edge
        return Body(np.r_[self.mass, np.full(8, mass / 8.0)], np.vstack([self.point, at + corners]))


def design_body(robot: Robot) -> Body:
    """The body as drawn: fourteen masses in the platform's box."""
    dice = np.random.default_rng(sum(robot.name.encode()))
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.38
    point = np.vstack([corners, dice.uniform(-0.35, 0.35, (6, 3))]) * robot.size
    mass = dice.uniform(0.5, 1.5, len(point))
    mass *= robot.mass / mass.sum()
    return Body(mass, point - mass @ point / robot.mass + robot.cog)


def built_body(robot: Robot, dice: np.random.Generator) -> Body:
    """The body as built: masses 8 % and places 2 % of the size off the design."""
    design = design_body(robot)
    mass = design.mass * (1.0 + 0.08 * dice.standard_normal(len(design.mass))) * (1.0 + 0.05 * dice.standard_normal())
    shift = 0.02 * np.array(robot.size) * dice.standard_normal((len(mass), 3))
    return Body(mass, design.point + shift)
