# SPDX-License-Identifier: Apache-2.0
"""Packages that not every installation has."""

import importlib
from typing import Any

from inertiad.base.error import InputError


def package(name: str, form: str) -> Any:
    """A package that not every installation has. InputError: it is not there."""
    try:
        return importlib.import_module(name)
    except ImportError:
        root = name.partition(".")[0]
        raise InputError(f"{form}: needs the Python package {root}; run pip install 'inertiad[export]'") from None
