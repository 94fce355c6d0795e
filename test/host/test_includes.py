# SPDX-License-Identifier: Apache-2.0
"""The firmware's files lie on levels: core below io below app, and no file includes itself by way of others."""

import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from conftest import TOP

FOLDERS = ("core", "io", "app")  # each includes from itself and from those before it
APP_MAY_CALL = {
    "inertiad": {"options", "open", "loop", "close"},
    "open": {"loop", "output_files"},
    "output_files": set(),
    "loop": {"command_handler", "data_path", "monitor"},
    "close": {"result", "data_path", "monitor", "health"},
    "command_handler": {"data_path", "health"},
    "data_path": {"monitor", "health"},
    "monitor": {"health"},
    "result": {"health"},
    "health": set(),
    "daemon": {"options"},
    "options": set(),
}  # beside daemon, which all may call


def includes(path: Path) -> set[str]:
    """Names of the project's own headers that a file includes."""
    return {Path(name).name for name in re.findall(r'^\s*#include "([^"]+)"', path.read_text(), re.MULTILINE)}


def files(firmware: Path) -> dict[str, tuple[str, set[str]]]:
    """Folder and included headers of every source file, by file name; headers that are generated are left out."""
    found = {p.name: (folder, includes(p)) for folder in FOLDERS for p in sorted((firmware / folder).glob("*.[ch]"))}
    return {name: (folder, headers & found.keys()) for name, (folder, headers) in found.items()}


def upward(sources: dict[str, tuple[str, set[str]]]) -> list[str]:
    level = {name: FOLDERS.index(folder) for name, (folder, _) in sources.items()}
    return [f"{a} includes {b}" for a, (_, headers) in sources.items() for b in headers if level[b] > level[a]]


def circle(sources: dict[str, tuple[str, set[str]]]) -> list[str]:
    """One circle of parts, a part being name.c with name.h; empty if there is none."""
    graph: dict[str, set[str]] = {}
    for name, (_, headers) in sources.items():
        part = Path(name).stem
        graph.setdefault(part, set()).update({Path(h).stem for h in headers} - {part})
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


@pytest.fixture(scope="module")
def sources():
    return files(TOP / "firmware")


def test_no_folder_includes_from_one_above_it(sources):
    assert len(sources) > 100
    assert upward(sources) == []


def test_no_part_includes_itself_by_way_of_others(sources):
    assert circle(sources) == []


def test_daemon_parts_call_only_those_below_them(sources):
    app = {name for name, (folder, _) in sources.items() if folder == "app"}
    assert {Path(name).stem for name in app} == set(APP_MAY_CALL)
    for name in sorted(app):
        part = Path(name).stem
        used = {Path(h).stem for h in sources[name][1] if h in app} - {part, "daemon"}
        assert used <= APP_MAY_CALL[part], name


def test_circles_and_upward_includes_are_found(tmp_path):
    for folder in FOLDERS:
        (tmp_path / folder).mkdir()
    (tmp_path / "core/a.h").write_text('#include "b.h"\n')
    (tmp_path / "core/b.c").write_text('#include "a.h"\n#include "c.h"\n')
    (tmp_path / "core/b.h").write_text("")
    (tmp_path / "io/c.h").write_text("")
    sources = files(tmp_path)
    assert upward(sources) == ["b.c includes c.h"]
    assert set(circle(sources)) == {"a", "b"}
