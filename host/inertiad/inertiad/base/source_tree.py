# SPDX-License-Identifier: Apache-2.0
"""The source tree that the package runs from."""

from pathlib import Path
from typing import Final

TOP: Final = Path(__file__).resolve().parents[4]
