# SPDX-License-Identifier: Apache-2.0
"""No test here reads MF4, and python-can's import of the package for it takes a minute in an emulated guest."""

import os
import sys
from pathlib import Path

WITHOUT = str(Path(__file__).parent / "without")
sys.path.insert(0, WITHOUT)
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (WITHOUT, os.environ.get("PYTHONPATH"))))
