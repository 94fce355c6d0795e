# SPDX-License-Identifier: Apache-2.0
"""Build the site: run the commands of its pages, make the pages of reference and the figures, render all with mkdocs.

.venv/bin/python host/docs/build.py [OUTPUT]      default: build/docs
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import api
import figures
import reference
import sessions

TOP = Path(__file__).resolve().parents[2]
HERE = TOP / "host/docs"
ORDER = ("bench", "robot", "recordings", "live", "examples")
"""of the pages with commands"""
PACKAGE = ("base", "robot", "run", "model", "identify", "simulate", "live", "exchange", "excite")
EXAMPLES = TOP / "host/examples"


def _typed_pages(pages: Path, runs: Path) -> None:
    """Quick start: every command is run, its output put below it."""
    for name in ORDER:
        print(f"  start/{name}.md: run its commands", flush=True)
        page = pages / "start" / f"{name}.md"
        text = page.read_text(encoding="utf-8")
        page.write_text(sessions.with_outputs(text, runs / name, TOP, page.name), encoding="utf-8")


def _made_pages(pages: Path) -> None:
    """Reference and programming interfaces."""
    core, include = TOP / "firmware/core", TOP / "host/eigen/include/inertiad"
    made = {
        "reference/commands.md": reference.commands(),
        "reference/daemon.md": reference.daemon(TOP / "build/bin/inertiad"),
        "reference/keys.md": reference.robot_keys(),
        "reference/robot.schema.json": reference.robot_schema(),
        "reference/messages.md": reference.messages(TOP / "lcm_types"),
        "reference/counters.md": reference.counter_page(TOP / "firmware"),
        "api/c.md": api.c_page(core),
        "api/cpp.md": api.cpp_page(include),
        "api/core.md": api.core_page(TOP / "host/inertiad/typings"),
        "api/package.md": api.package_page(TOP / "host/inertiad/inertiad", PACKAGE),
    }
    for name, text in made.items():
        (pages / name).parent.mkdir(exist_ok=True)
        (pages / name).write_text(text, encoding="utf-8")


def _pictures(pages: Path, runs: Path) -> None:
    """Figures of the first quick start's run, and pages that the commands made."""
    figures.write(runs / "bench/run", pages / "figures")
    for picture in (runs / "bench/figures").glob("*.png"):
        shutil.copy(picture, pages / "figures")
    (pages / "made").mkdir()
    for name in ("bench/report.html", "robot/robot.html", "recordings/sync.html"):
        shutil.copy(runs / name, pages / "made")


def _sources(pages: Path) -> None:
    """Each example's source below its place in the page of examples."""
    page = pages / "start/examples.md"
    text = page.read_text(encoding="utf-8")
    for file in sorted(EXAMPLES.glob("*.py")):
        source = file.read_text(encoding="utf-8").rstrip()
        text = text.replace(f"<!-- {file.name} -->", f"```python\n{source}\n```")
    page.write_text(text, encoding="utf-8")


def build(output: Path) -> None:
    """Write the site. sessions.SessionError: a command of a page failed; what it left is in OUTPUT-work."""
    work = output.with_name(f"{output.name}-work")
    shutil.rmtree(work, ignore_errors=True)
    pages, runs = work / "pages", work / "runs"
    shutil.copytree(HERE / "pages", pages)
    _typed_pages(pages, runs)
    _made_pages(pages)
    _sources(pages)
    _pictures(pages, runs)
    shutil.copy(HERE / "mkdocs.yml", work)
    shutil.rmtree(output, ignore_errors=True)
    print("  render", flush=True)
    command = [sys.executable, "-m", "mkdocs", "build", "-q", "-f", work / "mkdocs.yml", "-d", output]
    subprocess.run(command, check=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"})
    shutil.rmtree(work)


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else TOP / "build/docs"
    try:
        build(target.resolve())
    except sessions.SessionError as error:
        sys.exit(f"docs: {error}")
    print(f"{target}/index.html")
