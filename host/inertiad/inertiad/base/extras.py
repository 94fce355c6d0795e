# SPDX-License-Identifier: Apache-2.0
"""Python packages that only some commands need: which extra of inertiad brings each."""

import importlib
import re
import sys
from importlib import metadata
from importlib.util import find_spec
from typing import Any, Final

from inertiad.base import installation
from inertiad.base.error import InputError

EXTRA: Final = {
    "asammdf": "export",
    "clarabel": "optimise",
    "foxglove_schemas_protobuf": "export",
    "h5py": "export",
    "matplotlib": "plot",
    "mcap": "export",
    "mcap_protobuf": "export",
    "plotly": "plot",
    "pyarrow": "export",
    "rosbags": "export",
}
"""by the name that is imported; [project.optional-dependencies] of pyproject.toml has their versions"""


def is_optional(name: str | None) -> bool:
    """Whether a module belongs to a package that an installation may lack."""
    return (name or "").partition(".")[0] in EXTRA


def remedy(extra: str) -> str:
    """The line that installs an extra into this kind of installation."""
    if installation.SOURCE_TREE is not None:
        return "make setup"
    if (installation.PACKAGE / "bin/inertiad").exists():  # a wheel
        return f"pip install 'inertiad[{extra}]'"
    wanted = [r.split(";")[0].strip() for r in metadata.requires("inertiad") or [] if _is_of(r, extra)]
    return f"{sys.executable} -m pip install --target {installation.PACKAGE.parent} {' '.join(wanted)}"


def _is_of(requirement: str, extra: str) -> bool:
    return re.search(rf"extra == ['\"]{extra}['\"]", requirement) is not None


def missing(name: str, purpose: str = "") -> InputError:
    """The error that names the package of a module and the line that installs it. purpose: what needs it."""
    root = name.partition(".")[0]
    head = f"{purpose}: needs" if purpose else "needs"
    return InputError(f"{head} the Python package {root}; run {remedy(EXTRA[root])}")


def has(name: str) -> bool:
    """Whether a package is installed."""
    return find_spec(name) is not None


def require(name: str, purpose: str) -> None:
    """InputError: the package is not installed. For work that takes long before it needs the package."""
    if not has(name):
        raise missing(name, purpose)


def load(name: str, purpose: str) -> Any:
    """A module of an optional package. InputError: it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise missing(name, purpose) from None
