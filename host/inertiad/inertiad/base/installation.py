# SPDX-License-Identifier: Apache-2.0
"""Where the package runs from: a source tree, a wheel that carries the daemon, or an installation below a prefix."""

from pathlib import Path
from typing import Final

from inertiad.base.error import InputError

PACKAGE: Final = Path(__file__).resolve().parents[1]
_TREE: Final = PACKAGE.parents[2]
SOURCE_TREE: Final = _TREE if (_TREE / "host/inertiad/pyproject.toml").is_file() else None
"""None: installed"""


def _place(in_tree: str, in_wheel: str, below_prefix: str | None = None) -> Path | None:
    """The file of the first kind of installation that has it. below_prefix: None: in the package as in a wheel."""
    if SOURCE_TREE is not None:
        return SOURCE_TREE / in_tree if (SOURCE_TREE / in_tree).exists() else None
    places = [PACKAGE / in_wheel]
    if below_prefix is not None:
        places.append(PACKAGE.parents[2] / below_prefix)  # PREFIX/lib/inertiad/inertiad
    return next((path for path in places if path.exists()), None)


def daemon() -> Path:
    """The program inertiad that belongs to this package. InputError: there is none."""
    path = _place("build/bin/inertiad", "bin/inertiad", "bin/inertiad")
    if path is None:
        remedy = "install the daemon" if SOURCE_TREE is None else "run make build"
        raise InputError(f"inertiad: not found; {remedy}")
    return path


def feed_forward_model() -> Path:
    """The library that an FMU of the feed-forward holds. InputError: it was not built."""
    name = "inertiad_feed_forward.so"
    path = _place(f"build/lib/{name}", f"lib/{name}")
    if path is None:
        remedy = "install inertiad again" if SOURCE_TREE is None else "run make fmu"
        raise InputError(f"{name}: not found; {remedy}")
    return path


def example_robot() -> Path:
    """robot.toml of CoGiRo, the robot of the paper. InputError: not installed."""
    cogiro = "robots/cogiro/robot.toml"
    path = _place(f"firmware/{cogiro}", cogiro, f"share/inertiad/{cogiro}")
    if path is None:
        raise InputError(f"{cogiro}: not found; install inertiad again")
    return path
