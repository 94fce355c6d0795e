# SPDX-License-Identifier: Apache-2.0
"""The version of the project: that of host/inertiad/pyproject.toml, which the daemon is built with, too."""

import tomllib
from importlib import metadata

from inertiad.base.source_tree import TOP


def version() -> str:
    """Of the installed package, or of the source tree it runs from."""
    try:
        return metadata.version("inertiad")
    except metadata.PackageNotFoundError:
        data = tomllib.loads((TOP / "host/inertiad/pyproject.toml").read_text(encoding="utf-8"))
        return str(data["project"]["version"])
