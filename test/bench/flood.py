# SPDX-License-Identifier: Apache-2.0
"""Make what soak.py and vcan.py use, into build/bench/flood: a robot whose three CAN FD messages, IMU, forces and
position, carry counter and device time, its run, and python-can alone with what it needs, because a guest's file system
takes minutes to search a whole environment."""

import shutil
import sys
from importlib.metadata import distribution
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
OUT = TOP / "build/bench/flood"
PYTHON_CAN = ("python-can", "packaging", "typing_extensions", "wrapt")

sys.path.append(str(TOP / "test/vcan"))
import scenarios  # noqa: E402


def copy_package(name: str, site: Path) -> None:
    package = distribution(name)
    for file in package.files or []:
        source = Path(str(package.locate_file(file)))
        if ".." not in file.parts and file.suffix != ".pyc" and source.is_file():
            (site / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, site / file)


if __name__ == "__main__":
    shutil.rmtree(OUT, ignore_errors=True)
    scenarios.simulate(OUT)
    for package in PYTHON_CAN:
        copy_package(package, OUT / "site")
