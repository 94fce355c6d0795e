# SPDX-License-Identifier: Apache-2.0
"""The version of the project: that of host/inertiad/pyproject.toml, which the daemon is built with, too."""

import tomllib
from importlib import metadata

from inertiad.base.installation import SOURCE_TREE


def version() -> str:
    """Of the installed package, or of the source tree it runs from."""
    if SOURCE_TREE is None:
        return metadata.version("inertiad")
    data = tomllib.loads((SOURCE_TREE / "host/inertiad/pyproject.toml").read_text(encoding="utf-8"))
    return str(data["project"]["version"])
