# SPDX-License-Identifier: Apache-2.0
"""A run folder: made, with the robot's description and DBC files in it."""

import shutil
from pathlib import Path
from typing import Any

from inertiad.base.error import InputError
from inertiad.base.text_files import to_toml
from inertiad.robot import dbc
from inertiad.robot.description import Robot


def write_robot(folder: Path, robot: Robot, data: dict[str, Any], bitrate: float | None = None) -> None:
    """Write the robot's description and DBC files into a run folder.

    data holds the keys of robot.toml (robot.read_data()); bitrate, if given, replaces that of every bus.
    """
    data = {key: value for key, value in data.items() if key not in ("bus", "signals")}
    if robot.bus:
        buses = [
            _copied_bus(folder, bus.files, number) | bus.model_dump(exclude={"dbc"})
            for number, bus in enumerate(robot.bus)
        ]
        signals: dict[str, Any] = robot.model_dump(include={"signals"})["signals"]
    else:
        text, signals = dbc.generate(robot)
        (folder / dbc.GENERATED_NAME).write_text(text, encoding="cp1252")
        buses = [{"dbc": dbc.GENERATED_NAME}]
    if bitrate is not None:
        buses = [bus | {"bitrate": bitrate} for bus in buses]
    text = to_toml(data | {"bus": buses, "signals": signals})
    (folder / "robot.toml").write_text(text, encoding="utf-8")


def _copied_bus(folder: Path, files: list[Path], number: int) -> dict[str, Any]:
    """Copy a bus's DBC files into the folder; names taken by another bus's get the bus number in front."""
    names = []
    for path in files:
        target = folder / path.name
        if target.exists() and target.read_bytes() != path.read_bytes() and number > 0:
            target = folder / f"bus{number}_{path.name}"
        if target.resolve() != path.resolve():
            shutil.copyfile(path, target)
        names.append(target.name)
    return {"dbc": names[0] if len(names) == 1 else names}


def open_run(folder: Path) -> Path:
    """Create a run folder; InputError if it cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}") from None
    return folder
