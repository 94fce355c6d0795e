# SPDX-License-Identifier: Apache-2.0
"""The Python package's folders lie on levels: a module imports from its own folder and from those above it only."""

import ast
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from conftest import TOP

PACKAGE = TOP / "host/inertiad/inertiad"
LEVELS = (
    ("base",),
    ("robot",),
    ("run",),
    ("model",),
    ("identify", "simulate", "live", "exchange"),  # none of these imports another
    ("excite",),
    ("check",),
    ("control",),
    ("report",),
    ("cli",),
)
LINES_MAX = 450
LEVEL = {folder: level for level, folders in enumerate(LEVELS) for folder in folders}
MODULES = {path.relative_to(PACKAGE).with_suffix("").parts: path for path in sorted(PACKAGE.rglob("*.py"))}


def imported(path: Path, modules=MODULES) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Line and name of each module of the package that a file imports, also within functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import; write the whole name"
            module = (node.module or "").split(".")
            if module[0] == "inertiad":
                for alias in node.names:
                    whole = (*module[1:], alias.name)
                    yield node.lineno, whole if whole in modules else tuple(module[1:])
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "inertiad":
                    yield node.lineno, tuple(alias.name.split(".")[1:])


def misplaced(name: tuple[str, ...], path: Path, modules=MODULES) -> list[str]:
    """Imports of a module that its folder may not make, each as one line."""
    own, found = LEVEL[name[0]], []
    for line, target in imported(path, modules):
        if target[0] != name[0] and LEVEL[target[0]] >= own:
            found.append(f"{path}:{line}: {name[0]} imports {'.'.join(target)}")
    return found


def order(graph: dict[tuple[str, ...], set[tuple[str, ...]]]) -> list[tuple[str, ...]]:
    """Modules, each after those it imports. CycleError: there is no such order."""
    return list(TopologicalSorter(graph).static_order())


def test_every_folder_is_installed():
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    folders = {f"inertiad.{path.parent.name}" for path in PACKAGE.glob("*/__init__.py")}
    assert set(project["tool"]["setuptools"]["packages"]) == folders | {"inertiad"}


def test_every_folder_has_a_level():
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders == set(LEVEL)
    assert {name for name in MODULES if len(name) == 1} == {("__init__",), ("__main__",)}


@pytest.mark.parametrize("name", [name for name in MODULES if len(name) > 1], ids=".".join)
def test_imports_go_to_folders_above(name):
    assert not misplaced(name, MODULES[name])


def test_no_module_imports_itself_through_others():
    order({name: {target for _, target in imported(path)} for name, path in MODULES.items()})


@pytest.mark.parametrize("name", list(MODULES), ids=".".join)
def test_module_is_not_too_long(name):
    assert len(MODULES[name].read_text(encoding="utf-8").splitlines()) <= LINES_MAX


def test_upward_and_sideways_imports_are_found(tmp_path: Path):
    file = tmp_path / "module.py"
    file.write_text("from inertiad.base import table\n\n\ndef lazy():\n    from inertiad.simulate import simulator\n")
    modules = {("base", "table"), ("simulate", "simulator")}
    assert [len(misplaced((folder, "module"), file, modules)) for folder in ("model", "identify", "excite")] == [
        1,
        1,
        0,
    ]


def test_cycle_is_found():
    with pytest.raises(CycleError):
        order({("a",): {("b",)}, ("b",): {("c",)}, ("c",): {("a",)}})
