# SPDX-License-Identifier: Apache-2.0
"""python-can, on which cantools stands, without its wait for MF4.

python-can imports asammdf and with it pandas as it starts: half a second of each command, for one format of logs.
"""

import importlib
import sys
from pathlib import Path
from typing import Any


def load() -> Any:
    """Import python-can without asammdf. Its own classes for MF4 then say that asammdf is missing; see mf4_reader()."""
    if "can" not in sys.modules and "asammdf" not in sys.modules:
        sys.modules["asammdf"] = None  # type: ignore[assignment]  # an import of it raises ImportError
        try:
            importlib.import_module("can")
        finally:
            del sys.modules["asammdf"]
    return importlib.import_module("can")


def mf4_reader(path: Path) -> Any:
    """python-can's reader of an MF4 file, for `with`. ImportError or its own errors where it cannot be read."""
    load()
    return importlib.reload(importlib.import_module("can.io.mf4")).MF4Reader(path)
