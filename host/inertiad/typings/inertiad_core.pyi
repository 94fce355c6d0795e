# SPDX-License-Identifier: Apache-2.0
"""
The inertiad C core: cable lines, wrench, regressor, weak form, filter, consistency, pipeline.
"""

from collections.abc import Sequence
from typing import Annotated, overload

import numpy
from numpy.typing import NDArray


QUANTITIES: dict = ...

class Config:
    """A checked robot configuration, from the bytes of robot.cfg."""

    def __init__(self, data: bytes) -> None:
        """
        ValueError, with the reason, if the bytes are damaged, of another version or out of range.
        """

    @property
    def n_cables(self) -> int: ...

def cable_geometry(config: Config, p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)]) -> tuple:
    """
    (u [N,m,3] unit vectors in W from the attachment to the leave point, free length [N,m], length with arc [N,m]), for positions p [N,3] in W and rotations R [N,3,3] P to W. ValueError where a cable has no direction. cable.h
    """

def wrench_matrix(config: Config, p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], point: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]) -> tuple:
    """
    (W [N,6,m], sag [N,6]) with wrench = W f + sag about the body point [3], P axes. wrench.h
    """

def regressor(s: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], w: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], alpha: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """
    Y [N,6,10] from specific force, rate and angular acceleration [N,3] at the reference point. regressor.h
    """

def cable_inertia(config: Config, s: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], w: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], alpha: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """
    Wrench [N,6] at the IMU, P axes, of the cables' own inertia in motions of the IMU point. cable_inertia.h
    """

def shift(theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], d: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')]:
    """theta [10] about the point (old - d [3]). body.h"""

def body(theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], P: Annotated[NDArray[numpy.float64], dict(shape=(10, 10), order='C')]) -> dict:
    """
    dict of mass, cog, inertia_cog and their _std. ValueError if the mass is not positive. body.h
    """

def body_jacobian(theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(10, 10), order='C')]:
    """d(mass, cog, inertia_cog)/d(theta) [10,10]. body.h"""

def pseudo_inertia(theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(4, 4), order='C')]:
    """[4,4]. consistency.h"""

def nearest_body(theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], P: Annotated[NDArray[numpy.float64], dict(shape=(10, 10), order='C')]) -> tuple:
    """
    (q [10], Mahalanobis distance squared): the nearest that a body can have. ValueError: none found. consistency.h
    """

def is_consistent(theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')]) -> bool:
    """Can a body with these parameters exist? consistency.h"""

def averages(config: Config, t_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', writable=False)], s: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], w: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], y: Annotated[NDArray[numpy.float64], dict(shape=(None, 6), order='C', device='cpu', writable=False)]) -> dict:
    """
    dict of t [M], s, w, alpha [M,3], ww, y [M,6] and length: the weak form's windows of N rows. window.h
    """

def planned_windows(config: Config, rate: float, s: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], w: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], f: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')]) -> tuple:
    """
    (H [M,6,21+2m], rate and angular acceleration [M,6], window length): the filter's equations [Y, -X] of the windows that a motion sampled at rate [Hz] will be averaged to; s, w [N,3] at the IMU, P axes; p [N,3], R [N,3,3] pose of P; tensions f [N,m]; theta [10] about the IMU. window.h, systematic.h
    """

def planned_instants(config: Config, s: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], w: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], alpha: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], velocity: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], f: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')]) -> NDArray[numpy.float64]:
    """[Y, -X] [N,6,34+2m] of single instants. systematic.h"""

def rehearse(config: Config, rate: float, s: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], w: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], f: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], y: Annotated[NDArray[numpy.float64], dict(shape=(None, 6), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float64], dict(shape=(10, 10), order='C')]:
    """
    Covariance [10,10] of mass, CoG and inertia that the daemon's estimator publishes after a motion given as to planned_windows(), whose windows' wrenches are y [M,6]; the first ones are lost while the attitude settles. estimator.h, motion.h
    """

def published_covariance(config: Config, theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], P: Annotated[NDArray[numpy.float64], dict(shape=(10, 10), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(10, 10), order='C')]:
    """
    Covariance [10,10] of mass, CoG and inertia about P, as published for theta [10] with covariance P [10,10], both about the IMU. ValueError: no physically consistent body is near theta. estimate.h
    """

def counter_table() -> list:
    """
    [{name, is_rejected, is_bad}] of every counter of the pipeline, in its order. counter_table.h
    """

def decode_raw(data: bytes, start: int, length: int, big_endian: bool, is_signed: bool) -> int:
    """Raw bits of a signal, extended to 64 bits. decode.h"""

def decode_frame(config: Config, bus: int, can_id: int, data: bytes) -> dict:
    """{quantity number: SI value}. decode.h"""

class Rls:
    """Recursive least squares, P = U D U^T. rls.h"""

    def __init__(self, theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], P: Annotated[NDArray[numpy.float64], dict(shape=(10, 10), order='C')], xi_std: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] = ...) -> None: ...

    def update(self, H: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], y: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], L: Annotated[NDArray[numpy.float64], dict(shape=(6, 6), order='C')]) -> float:
        """Fold in y [6] = H [6,n] x + e, cov(e) = L L^T; returns NIS."""

    @property
    def x(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """[n]"""

    @property
    def P(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]:
        """[n,n]"""

class Clock:
    """A device's clock against the host's, by the lower convex hull. clock.h"""

    def __init__(self, wrap: float = 0.0) -> None:
        """wrap [s]: device time starts again at 0 after this; 0: never."""

    def map(self, device: float, host_ns: int) -> int:
        """Learn from one pair; host time [ns] of the device's instant [s]."""

    def at(self, device: float) -> int:
        """
        Host time [ns] of a device time [s] near the last one mapped, nothing learnt.
        """

    @property
    def is_settled(self) -> bool: ...

    @property
    def n_steps(self) -> int: ...

class Pipeline:
    """CAN frames and positions in, estimate out. pipeline.h"""

    def __init__(self, config: Config) -> None: ...

    def push_frame(self, t_ns: int, bus: int, can_id: int, data: bytes, flags: int = 0) -> int:
        """Status of one CAN frame: 0 taken, > 0 nothing for us, < 0 refused."""

    def push_position(self, t_ns: int, position: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]) -> int: ...

    def step(self) -> int:
        """
        Use one aligned row: 0 new estimate, 2 used, 1 none ready, < 0 refused. A used row is kept for Windows.
        """

    def drain(self) -> None:
        """Step until no row is ready; the rows are kept for Windows."""

    def flush(self) -> None: ...

    def freeze(self, is_frozen: bool) -> None:
        """Stop learning from windows, or resume it."""

    def reset(self) -> None:
        """Start the estimator again from its prior."""

    def set_gyro_bias(self, bias: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]) -> None:
        """Use this gyro bias [3], I axes, rad/s, from the next row on."""

    def expect(self, t_ns: int, numbers: Annotated[NDArray[numpy.float64], dict(shape=(20), order='C')]) -> None:
        """
        Expect a payload at a host time; numbers [20] of expectation_t. ValueError: no such body. announcement.h
        """

    @property
    def estimate(self) -> dict: ...

    @property
    def counters(self) -> dict: ...

class Windows:
    """
    The weak equations y = Y theta - X xi + noise of the rows a Pipeline kept. window.h, systematic.h
    """

    @overload
    def __init__(self, config: Config, run: Pipeline) -> None: ...

    @overload
    def __init__(self, config: Config, run: Rows) -> None: ...

    @property
    def t(self) -> NDArray[numpy.float64]:
        """[M] s since the first"""

    @property
    def Y(self) -> NDArray[numpy.float64]:
        """[M,6,10]"""

    @property
    def y(self) -> NDArray[numpy.float64]:
        """[M,6]"""

    @property
    def R(self) -> NDArray[numpy.float64]:
        """[M,3,3] P to W in the windows' middles"""

    @property
    def has_failed(self) -> NDArray[numpy.bool_]:
        """[M,m] bool: the cable's force sensor has failed within the window"""

    def X(self, theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')]) -> NDArray[numpy.float64]:
        """[M,6,32+3m]"""

def systematic_std(config: Config) -> NDArray[numpy.float64]:
    """One sigma [32+3m] of each systematic parameter. systematic.h"""

def systematic_table(n_cables: int) -> list[tuple[str, str, int, int, bool]]:
    """
    (name, SI unit, first index, count, whether per cable) of each kind of systematic parameter, in the order of xi. systematic.h
    """

def linear_parameters(n_cables: int) -> list[int]:
    """
    Indices of xi in which the equations are linear: X xi adds to y, no calibration has them. calibrated.hpp
    """

class Rows:
    """Aligned rows of a run, as measured: ipe_row_t in types.h."""

    def __init__(self, t_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], acc: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], gyro: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], position: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], f: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], derives_force: bool = False, derives_rate: bool = False) -> None: ...

    def __len__(self) -> int: ...

    @property
    def t(self) -> NDArray[numpy.float64]:
        """[N] s"""

    @property
    def acc(self) -> NDArray[numpy.float64]:
        """[N,3] I axes, m/s2"""

    @property
    def gyro(self) -> NDArray[numpy.float64]:
        """[N,3] I axes, rad/s"""

    @property
    def q(self) -> NDArray[numpy.float64]:
        """[N,4] w x y z, I to W"""

    @property
    def position(self) -> NDArray[numpy.float64]:
        """[N,3] tracked point, W, m"""

    @property
    def f(self) -> NDArray[numpy.float64]:
        """[N,m] N"""

    @property
    def has_failed(self) -> NDArray[numpy.bool_]:
        """[N,m] bool: the cable's force sensor has failed, f is no measurement"""

    @property
    def derives_force(self) -> bool:
        """True: acc comes from positions and attitude, derived.hpp"""

    @property
    def derives_rate(self) -> bool:
        """True: gyro comes from attitude"""

def read_run(config: Config, logs: Sequence[str], interfaces: Sequence[str], tracker: str) -> Pipeline:
    """
    Pipeline that has read candump logs, one per bus (interface name, or "" for all), and a tracker CSV (or "").
    """

def rows_of(pipeline: Pipeline) -> Rows:
    """The rows a Pipeline kept."""

def align_signals(config: Config, t_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], imu: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], f: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], position_t_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], position: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], derives_force: bool = False, derives_rate: bool = False) -> Rows:
    """
    Rows of imu [N,10] (acc, gyro, q w x y z), f [N,m] at t_ns [N] and position [K,3] at position_t_ns [K]. align.h
    """

def track(config: Config, rows: Rows) -> dict:
    """
    dict of t [K] s, value and std [K,10] of mass, CoG, inertia, nis [K], n_changes [K], sigma_factor [K] and is_misfit [K] (estimate.h), restored_force [K,m] N of failed sensors, else NaN: every estimate that the platform's filter makes of the rows. pipeline.h
    """

def undelayed(rows: Rows, position_delay: float, force_delay: float) -> Rows:
    """Rows as if position and forces had come that much [s] earlier."""

def corrected_rows(config: Config, rows: Rows, xi: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Rows:
    """
    Rows for the configuration with corrections xi [32+3m]: delays taken out, derived motion as attitude has it.
    """

def calibrated(config: Config, xi: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Config:
    """The configuration with corrections xi [32+3m]."""

def batch(config: Config, runs: Sequence[Rows], group: Sequence[int], payload: Sequence[float], is_payload_known: bool = False, payload_std: float = 0.01, is_free: Sequence[bool] = [], theta_prior: float = 1.0, is_weight_learnt: bool = True) -> dict:
    """
    Damped Gauss-Newton over theta of each group and the free systematic parameters. ValueError: no solution. batch.hpp
    """

def forward(truth: Config, believed: Config, theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], theta_believed: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], payload: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], v: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], a: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], omega: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], alpha: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], lengths: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], tilt: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], step: float, steps_per_control: int, EA: float, damping_time: float, winch_rate: float, control_rate: float, swing_damping: float, swings: bool, holds_length: bool) -> dict:
    """
    dict of p, v, a, R, omega, alpha, f [N,..] at every step, n_infeasible, first_infeasible (control instant) and stopped (why it ended early, ""), of the robot `truth` with theta [10] about P, whose controller believes other things, along references [K,..] at the instants of control; payload [J,12]: t, ramp, change of theta; lengths [K,m] unstrained, where held; tilt [2,m] rad, swing at the start. plant.hpp
    """

def cable_mass_wrench(config: Config, p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], v: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], a: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], omega: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], alpha: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """
    Wrench [N,6] about P, P axes, of the mass of straight cables on a platform in motion: p, v, a [N,3] in W, R [N,3,3] P to W, omega, alpha [N,3] in P. ValueError where a cable has no direction. cable_mass.hpp
    """

def distribute(W: Annotated[NDArray[numpy.float64], dict(shape=(None, 6, None), order='C', device='cpu', writable=False)], wrench: Annotated[NDArray[numpy.float64], dict(shape=(None, 6), order='C', device='cpu', writable=False)], pull: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], low: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], high: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple:
    """
    (f [N,m] closest to pull [m] with W [N,6,m] f = wrench [N,6] and low <= f <= high, list of k where there is none). distribution.hpp
    """

def arbitrate(release: Sequence[float], priority: Sequence[int], took: Sequence[float]) -> list[float]:
    """
    Ends [N] s of frames on a bus, from when they wait [N] s, priority [N] (less is first), how long they take [N] s. arbitration.hpp
    """

class GateLimits:
    """What a gate demands of an estimate. parameter_gate.h"""

    def __init__(self) -> None: ...

    @property
    def mass_std(self) -> float: ...

    @mass_std.setter
    def mass_std(self, arg: float, /) -> None: ...

    @property
    def cog_std(self) -> float: ...

    @cog_std.setter
    def cog_std(self, arg: float, /) -> None: ...

    @property
    def inertia_std(self) -> float: ...

    @inertia_std.setter
    def inertia_std(self, arg: float, /) -> None: ...

    @property
    def verdict_max(self) -> int: ...

    @verdict_max.setter
    def verdict_max(self, arg: int, /) -> None: ...

    @property
    def age_max(self) -> float: ...

    @age_max.setter
    def age_max(self, arg: float, /) -> None: ...

    @property
    def transition_time(self) -> float: ...

    @transition_time.setter
    def transition_time(self, arg: float, /) -> None: ...

    @property
    def change_time(self) -> float: ...

    @change_time.setter
    def change_time(self, arg: float, /) -> None: ...

    @property
    def step_sigmas(self) -> float: ...

    @step_sigmas.setter
    def step_sigmas(self, arg: float, /) -> None: ...

    @property
    def n_return(self) -> int: ...

    @n_return.setter
    def n_return(self, arg: int, /) -> None: ...

    @property
    def keep_last_good(self) -> bool: ...

    @keep_last_good.setter
    def keep_last_good(self, arg: bool, /) -> None: ...

def gate_reason(reason: int) -> str:
    """What an offer's outcome means, in words; 0: taken. parameter_gate.h"""

class ParameterGate:
    """The parameters that a control loop may use. parameter_gate.h"""

    def __init__(self, nominal: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], limits: GateLimits = ...) -> None: ...

    def offer(self, sequence: int, t_ns: int, n_changes: int, theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], covariance: Annotated[NDArray[numpy.float64], dict(shape=(10, 10), order='C')], observable: Sequence[bool], verdict: int, provisional: bool, now_ns: int) -> int:
        """
        Offer an estimate, the fields of ESTIMATE, at host time now_ns; what became of it: gate_reason()
        """

    def read(self, now_ns: int) -> dict:
        """
        dict of theta [10], source, sequence, age [s], is_moving at host time now_ns
        """

def feed_forward(theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], R: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C')], a: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], omega: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], alpha: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], gravity: float) -> Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')]:
    """
    Wrench [6] about P, P axes, N and N m, that gives a body theta [10] the acceleration a (W, m/s2) at rate omega and angular acceleration alpha (P axes), in attitude R [3,3] (P to W). feed_forward.hpp
    """

class PoseSensors:
    """The pose that a controller gets from sensors. pose_observer.hpp"""

    def __init__(self, imu_t: Sequence[float], imu_arrival: Sequence[float], attitude_error: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], gyro_error: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], acc_error: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], alignment: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C')], yaw: float, tracker_t: Sequence[float], tracker_error: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], tracker_delay: float, target: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], observer_rate: float) -> None: ...

class ControlLoop:
    """
    A platform under a controller with parameters of a source: arm 0 nominal, 1 live through the gate, 2 exact, 3 adaptive. control_loop.hpp
    """

    def __init__(self, truth: Config, believed: Config, theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], nominal: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], payload: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], p: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], v: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], a: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], omega: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], alpha: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], tilt: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], arm: int, limits: GateLimits, start_ns: int, sensors: PoseSensors | None, step: float, steps_per_control: int, EA: float, damping_time: float, winch_rate: float, control_rate: float, swing_damping: float, swings: bool) -> None: ...

    def advance(self, n: int) -> bool:
        """Go on by n periods of control; False: the motion is over"""

    def offer(self, sequence: int, t_ns: int, n_changes: int, theta: Annotated[NDArray[numpy.float64], dict(shape=(10), order='C')], covariance: Annotated[NDArray[numpy.float64], dict(shape=(10, 10), order='C')], observable: Sequence[bool], verdict: int, provisional: bool, now_ns: int) -> int:
        """As ParameterGate.offer()"""

    def states(self, first: int, last: int) -> NDArray[numpy.float64]:
        """
        Rows [N, 19 + m] of the integration: p, v, q (w x y z), omega, a, alpha, f
        """

    def trace(self) -> dict:
        """
        dict of a row per control instant: e_p [K,3] m, e_R rad, tension_norm, tension_step and beyond N, theta [K,10], source, sequence, is_cut (1: the command is cut off at the limits). control_loop.hpp
        """
