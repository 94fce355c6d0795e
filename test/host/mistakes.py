# SPDX-License-Identifier: Apache-2.0
"""Mistakes of a lab, made on purpose in a copy of a simulated run: wiring, units, mounting, a sensor at its end."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

Edit = Callable[[Path], None]


def _replace(folder: Path, name: str, pattern: str, by: str) -> None:
    file = folder / name
    text, n = re.subn(pattern, by, file.read_text())
    assert n > 0, f"{name}: nothing like {pattern}"
    file.write_text(text)


def _exchange_channels(folder: Path) -> None:
    """The plugs of cables 3 and 4 are exchanged."""
    _replace(folder, "robot.toml", r"f_3 = (.*)\nf_4 = (.*)\n", r"f_3 = \2\nf_4 = \1\n")


def _unit(factor: float) -> Edit:
    """The force transmitter sends another unit than its DBC says: newtons are read as N * factor."""

    def edit(folder: Path) -> None:
        by = f"({0.1 * factor:.9g},{-200.0 * factor:.9g}) [{-199.9 * factor:.9g}|{6353.4 * factor:.9g}]"
        _replace(folder, "platform.dbc", r"( SG_ f_\d .*?)\(0\.1,-200\) \[[^]]*\]", rf"\g<1>{by}")

    return edit


def _turn_imu(orientation: str) -> Edit:
    """robot.toml says the IMU is mounted like this."""

    def edit(folder: Path) -> None:
        _replace(folder, "robot.toml", r"(?s)(\[imu\].*?orientation = )\[[^]]*\]", rf"\g<1>[{orientation}]")

    return edit


def _gravity_sign(folder: Path) -> None:
    """The IMU reports acceleration with the opposite sign."""
    _replace(folder, "platform.dbc", r"(SG_ acc_. .*?)\(0\.002,0\)", r"\g<1>(-0.002,0)")


def _tracker_in_mm(folder: Path) -> None:
    data = np.loadtxt(folder / "tracker.csv", delimiter=",", skiprows=1)
    data[:, 1:4] *= 1e3
    np.savetxt(folder / "tracker.csv", data, delimiter=",", header="t,x,y,z", comments="", fmt="%.9f")


def _pulley_radius(radius: float) -> Edit:
    """robot.toml has pulleys of another size."""

    def edit(folder: Path) -> None:
        _replace(folder, "robot.toml", r"pulley_radius = [\d.]+", f"pulley_radius = {radius:g}")

    return edit


def _force_code(first: Callable[[np.ndarray], np.ndarray]) -> Edit:
    """The codes of f_1, message 0x20, are changed all along the log."""

    def edit(folder: Path) -> None:
        lines = (folder / "can.log").read_text().splitlines()
        at = [i for i, line in enumerate(lines) if " 020#" in line]
        data = [bytearray.fromhex(lines[i].split("#")[1]) for i in at]
        codes = first(np.array([d[0] | d[1] << 8 for d in data])).astype(int)
        for i, d, code in zip(at, data, codes, strict=True):
            d[0:2] = int(code).to_bytes(2, "little")
            lines[i] = lines[i].split("#")[0] + "#" + d.hex().upper()
        (folder / "can.log").write_text("\n".join(lines) + "\n")

    return edit


def _slack(codes: np.ndarray) -> np.ndarray:
    """A tenth of the time at 5 N, give or take the amplifier's noise."""
    part = slice(len(codes) // 2, len(codes) * 6 // 10)
    codes[part] = 2050 + codes[part] % 5
    return codes


def _clipped(codes: np.ndarray) -> np.ndarray:
    """An amplifier that ends where a tenth of the samples are."""
    return np.minimum(codes, int(np.quantile(codes, 0.9)))


MISTAKES: dict[str, Edit] = {
    "channels exchanged": _exchange_channels,
    "forces in kN": _unit(1e-3),
    "forces in kg": _unit(1.0 / 9.80665),
    "IMU upside down": _turn_imu("0, 1, 0, 0"),
    "IMU turned": _turn_imu("0.7071067811865476, 0, 0, 0.7071067811865476"),
    "gravity sign": _gravity_sign,
    "tracker in mm": _tracker_in_mm,
    "pulley forgotten": _pulley_radius(0.0),
    "pulley's diameter": _pulley_radius(0.1),
    "slack cable": _force_code(_slack),
    "saturated sensor": _force_code(_clipped),
}


def make(name: str, run: Path, folder: Path) -> Path:
    """A copy of the run with the mistake in it."""
    shutil.copytree(run, folder)
    MISTAKES[name](folder)
    return folder
