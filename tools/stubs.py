# SPDX-License-Identifier: Apache-2.0
"""Write the type stubs of the Python bindings into host/inertiad/typings: what mypy knows of them.

Usage: stubs.py
"""

from pathlib import Path

from nanobind.stubgen import StubGen

TYPINGS = Path(__file__).resolve().parents[1] / "host/inertiad/typings"
MODULES = ("inertiad_core", "inertiad_replay")
LICENCE = "# SPDX-License-Identifier: Apache-2.0\n"


def stub(module: str) -> str:
    """The stub file of a built binding."""
    generator = StubGen(__import__(module))
    generator.put(generator.module)
    return LICENCE + generator.get()


def main() -> None:
    TYPINGS.mkdir(exist_ok=True)
    for module in MODULES:
        (TYPINGS / f"{module}.pyi").write_text(stub(module), encoding="utf-8")


if __name__ == "__main__":
    main()
