# SPDX-License-Identifier: Apache-2.0
"""T1, T3, T4, T5, T12 (noise), T14, T15: the core by itself, against other people's code, over time, on bad data."""

import re
import subprocess

import numpy as np
import scenes
from scenes import COGIRO, TOP
from verdict import FIRST, Verdict, program, scratch

import inertiad_core
from inertiad.robot import configuration, description

CABLES = 8
DAY_RATE, REST_RATE, BAD_RATE = 100.0, 20.0, 100.0  # Hz; 20 Hz: the fewest rows that make a window


def t1(n: int = 1000) -> Verdict:
    """The regressor against pinocchio's."""
    import pinocchio

    dice = np.random.default_rng(FIRST)
    worst = 0.0
    order = [0, 1, 2, 3, 4, 6, 9, 8, 7, 5]  # ours xx yy zz yz xz xy from pinocchio's xx xy yy xz yz zz
    for _ in range(n):
        s, w, alpha = dice.standard_normal((3, 3)) * 5.0
        Y = inertiad_core.regressor(s[None], w[None], alpha[None])[0]
        other = pinocchio.bodyRegressor(pinocchio.Motion(np.zeros(3), w), pinocchio.Motion(s, alpha))[:, order]
        worst = max(worst, float(np.abs(Y - other).max()))
    what = "regressor and order against pinocchio"
    return Verdict("T1", what, n, "states", "<= 1e-12", f"{worst:.1e}", worst <= 1e-12)


def t3(n: int = 1_000_000) -> list[Verdict]:
    """The recursion against QR in long double, theta alone and with all states that the platform carries."""
    found = []
    for n_others in (0, 20 + 2 * CABLES):
        worst = program("recursion", n, n_others, FIRST)["difference"]
        what = f"UD filter, {10 + n_others} states, against QR batch"
        found.append(Verdict("T3", what, n, "windows", "<= 1e-10", f"{worst:.1e}", worst <= 1e-10))
    text = "the core has no float build: all state is double"
    return [*found, Verdict("T3", "UD filter in float", 0, "windows", "<= 1e-4 at 1e7", text, None)]


def _random_rows(n: int) -> tuple[np.ndarray, np.ndarray]:
    dice = np.random.default_rng(FIRST)
    Y = inertiad_core.regressor(*(dice.standard_normal((n, 3)) * k for k in (5.0, 1.0, 1.0)))
    return Y, Y @ np.arange(1.0, 11.0) + 0.1 * dice.standard_normal((n, 6))


def t4(n: int = 500) -> list[Verdict]:
    """The recursion against padasip and filterpy."""
    import padasip
    from filterpy.kalman import KalmanFilter

    Y, y = _random_rows(n)
    ours = inertiad_core.Rls(np.zeros(10), np.eye(10) * 1e4)
    rls = padasip.filters.FilterRLS(10, mu=1.0, eps=1e-4, w=np.zeros(10))
    kalman = KalmanFilter(dim_x=10, dim_z=6)
    kalman.x, kalman.P, kalman.R = np.zeros(10), np.eye(10) * 1e4, np.eye(6)
    for Y_k, y_k in zip(Y, y, strict=True):
        ours.update(Y_k, y_k, np.eye(6))
        kalman.update(y_k, H=Y_k)
        for h, value in zip(Y_k, y_k, strict=True):
            rls.adapt(value, h)
    found = []
    for name, other in (("padasip", rls.w), ("filterpy", kalman.x)):
        worst = float(np.abs(ours.x / other - 1.0).max())
        found.append(Verdict("T4", f"same rows as {name}", n, "windows", "<= 1e-10", f"{worst:.1e}", worst <= 1e-10))
    return found


def _endure(what: str, n: int, rate: float, blind: bool = False, seed: int = FIRST) -> dict[str, float]:
    """What test/accept/endure.cpp prints: modern sensors on CoGiRo, two Fourier motions one after the other."""
    rows, config = scratch(f"{what}_{seed}.rows"), scratch(f"{what}_{seed}.cfg")
    scenes.quiet_rows("modern", rate, seed, [scenes.fourier(seed), scenes.fourier(seed + 500)]).tofile(rows)
    robot = description.load(COGIRO)
    imu = robot.imu.model_copy(update={"rate": rate})
    robot = robot.model_copy(update={"imu": imu} | ({"nominal": None} if blind else {}))
    configuration.write(config, robot, str(COGIRO))
    return program("endure", what, config, rows, rate, n, seed, *scenes.noise_of("modern", rate))


def t5(n: int = 10_000_000) -> list[Verdict]:
    """A long rest: nothing wears down, nothing grows."""
    found = _endure("rest", n, REST_RATE)
    finite = found["is_finite"] == 1 and found["n_refused"] == 0
    text = f"largest eigenvalue of P in P0's metric {found['share_of_prior']:.6f}, {found['n_changes']:.0f} alarms"
    moved = f"{found['moved_per_day']:.3f} kg m2; {found['moved_altogether']:.3f} in {found['days']:.3g} days"
    good = finite and found["share_of_prior"] <= 1.0 + 1e-9
    unit, limit = "windows", "< 0.5 kg m2 per 24 h"
    return [
        Verdict("T5", "rest, then motion: finite, P <= P0", n, unit, "finite, eigenvalue <= 1", text, good),
        Verdict("T5", "inertia moved at rest", n, unit, limit, moved, found["moved_per_day"] < 0.5),
    ]


def t12_noise(hours: float = 24.0, n: int = 2) -> Verdict:
    """Motion without any change of payload: every alarm is a false one."""
    runs = [_endure("noise", round(hours * 36_000), DAY_RATE, seed=FIRST + i) for i in range(n)]
    alarms, held = (sum(run[key] for run in runs) for key in ("n_changes", "n_held"))
    text = f"{alarms:.0f} alarms, {held:.0f} windows held back"
    return Verdict("T12", f"{hours:g} h of motion, no change", n, "runs", "no alarm", text, alarms == 0)


def t14(n: int = 1_000_000) -> list[Verdict]:
    """Noise up to 300 times the sensors': the published body exists; broken values leave the filter alone."""
    found = _endure("bad", n, BAD_RATE, blind=True)
    body = f"{found['n_impossible']:.0f} impossible; {found['n_projected']:.0f} had to be projected"
    kept = f"{found['n_disturbed']:.0f} changed the state, {found['n_taken']:.0f} were taken as good"
    inputs = int(found["bad_inputs"])
    good = found["n_disturbed"] == 0 and found["n_taken"] == 0
    return [
        Verdict("T14", "published body exists, P > 0", n, "estimates", "all", body, found["n_impossible"] == 0),
        Verdict("T14", "NaN, Inf, full scale: state unchanged", inputs, "inputs", "all", kept, good),
    ]


def state_bytes() -> tuple[int, int, int]:
    """Bytes of the filter's state that ever held a number for eight cables, of the whole pipeline's, and its limit."""
    found = _endure("noise", 600, DAY_RATE)
    return int(found["filter_bytes"]), int(found["pipeline_bytes"]), int(found["pipeline_limit"])


def t15() -> list[Verdict]:
    """What the object files call, what the state takes, and the same log on another processor."""
    library = ["nm", str(TOP / "build/lib/libinertiad_core.a")]
    symbols = subprocess.run(library, capture_output=True, text=True, check=True).stdout
    update = next(part for part in symbols.split("\n\n") if part.lstrip().startswith("rls.o:"))
    roots = re.findall(r" U (sqrt\w*|pow\w*)$", update, re.M)
    in_use, whole, limit = state_bytes()
    heap = re.findall(r" U (malloc|calloc|realloc|free|aligned_alloc|posix_memalign)$", symbols, re.M)
    return [
        Verdict("T15", "no heap in the core", 1, "library", "none", ", ".join(heap) or "none called", not heap),
        Verdict("T15", "no root in the update", 1, "library", "none", ", ".join(roots) or "none called", not roots),
        Verdict("T15", "filter's state in use, 8 cables", 1, "robot", "< 6144 B", f"{in_use} B", in_use < 6144),
        Verdict("T15", "state of the whole pipeline", 1, "robot", f"<= {limit} B", f"{whole} B", whole <= limit),
    ]


def t15_targets() -> Verdict:
    """A run of the modern sensors, replayed by the native core and by one for aarch64 under qemu."""
    folder = scenes.run(FIRST, "modern", 200.0, "fourier")
    config = scratch("replay.cfg")
    configuration.write(config, description.load(folder / "robot.toml"), str(folder))
    files = [str(config), str(folder / "can.log"), str(folder / "tracker.csv")]
    native, other = (
        np.array([[float(v) for v in line.split()] for line in out.splitlines()])
        for out in (
            subprocess.run([*command, *files], capture_output=True, text=True, check=True).stdout
            for command in (
                [str(TOP / "build/test/accept/replay")],
                ["qemu-aarch64", str(TOP / "build/aarch64/replay")],
            )
        )
    )
    scale = np.abs(native).max(axis=0)
    worst = float((np.abs(native - other) / np.where(scale > 0.0, scale, 1.0)).max()) if len(native) else np.inf
    what = "same log on x86-64 and aarch64"
    return Verdict("T15", what, len(native), "estimates", "<= 1e-12", f"{worst:.1e}", worst <= 1e-12)
