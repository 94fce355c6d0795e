# SPDX-License-Identifier: Apache-2.0
"""The documentation's site: its commands run, its reference is complete, its pages open without a network."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import Browser, browser
from conftest import ISOLATED, TOP

import inertiad_core
from inertiad.robot import reference as keys

sys.path[:0] = [str(TOP / "host/docs")]
import headers  # noqa: E402
import reference  # noqa: E402
import sessions  # noqa: E402

EXAMPLES = TOP / "host/examples"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site; every command of its pages has run and ended with 0."""
    output = tmp_path_factory.mktemp("docs") / "site"
    done = subprocess.run([sys.executable, TOP / "host/docs/build.py", output], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return output


def text(page: Path) -> str:
    """A page's words."""
    return re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8"))


@pytest.mark.slow
def test_commands_print_below_themselves(site: Path):
    assert re.search(r"PASS: (\d+) of \1 passed", text(site / "start/bench.html"))
    assert "unknown key; did you mean" in text(site / "start/robot.html")
    assert "mass: " in text(site / "start/examples.html")


@pytest.mark.slow
def test_examples_stand_on_their_page_with_source_and_output(site: Path):
    page = text(site / "start/examples.html")
    for file in EXAMPLES.glob("*.py"):
        assert f"host/examples/{file.name}" in page
        assert file.read_text(encoding="utf-8").split("def main")[1][:60].split("(")[0] in page
    assert "verdict: good" in page and re.search(r"^(-?\d+\.\d+ ){5}-?\d+\.\d+$", page, re.MULTILINE)  # a wrench


def pages(site: Path) -> Iterator[Path]:
    return (page for page in sorted(site.rglob("*.html")) if "made" not in page.parts and page.name != "404.html")


@pytest.fixture(scope="module")
def opened(site: Path) -> Iterator[Browser]:
    with browser() as found:
        yield found


def show(opened: Browser, page: Path) -> None:
    opened.call("Page.navigate", url=page.as_uri())
    opened.wait("document.readyState === 'complete'")


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 400])
def test_pages_fit_the_screen_and_ask_the_network_for_nothing(site: Path, opened: Browser, width: int):
    opened.show(width, 900)
    for page in pages(site):
        show(opened, page)
        assert opened.ask("document.documentElement.scrollWidth") <= width, page
        assert opened.ask("[...document.images].every(image => image.naturalWidth > 0)"), page
    assert not opened.complaints
    assert not [url for url in opened.requests if not url.startswith(("file:", "data:", "about:"))]


@pytest.mark.slow
def test_search_works_on_files(site: Path, opened: Browser):
    opened.show(1280, 900)
    show(opened, site / "index.html")
    x, y = opened.ask(
        "(b => [b.x + b.width / 2, b.y + b.height / 2])"
        "(document.querySelector('.md-search__form').getBoundingClientRect())"
    )
    for kind in ("mousePressed", "mouseReleased"):
        opened.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    opened.wait("typeof __index !== 'undefined'")
    opened.call("Input.insertText", text="pulley_radius")
    opened.ask("document.querySelector('.md-search__input').dispatchEvent(new KeyboardEvent('keyup'))")
    opened.wait("document.querySelectorAll('.md-search-result__item').length > 0")


@pytest.mark.slow
def test_headers_and_docstrings_are_on_their_pages(site: Path):
    for page, folder, ending in (("c", "firmware/core", "h"), ("cpp", "host/eigen/include/inertiad", "hpp")):
        shown = text(site / f"api/{page}.html")
        assert all(file.name in shown for file in (TOP / folder).glob(f"*.{ending}"))
    core = text(site / "api/core.html")
    public = [name for name, one in vars(inertiad_core).items() if not name.startswith("_") and callable(one)]
    assert [name for name in public if name not in core] == []
    assert "ipe_pipeline_step" in text(site / "api/c.html")
    assert "inertiad.identify.fit" in text(site / "api/package.html")


# ---- reference, without building -----------------------------------------------------------------------------------


def test_every_command_has_its_options(inertiactl):
    page = reference.commands()
    listed = re.findall(r"^│ ([a-z]+)  ", inertiactl("-h").stdout, re.MULTILINE)
    assert len(listed) > 15
    assert [name for name in listed if f"\n## {name}\n" not in page] == []
    assert "<code>--payload KG@S</code>" in page and "&#91;nominal] out" in page


def test_every_key_is_there():
    page, schema = reference.robot_keys(), keys.schema()
    names = [*schema["properties"], *(n for table in schema["$defs"].values() for n in table["properties"])]
    assert [name for name in names if name not in page] == []


def test_every_counter_has_a_meaning(inertiactl, tmp_path: Path):
    page = reference.counter_page(TOP / "firmware")
    rows = dict(re.findall(r"^\| `([\w.]+)` \| (.*?) \|", page, re.MULTILINE))
    assert [name for name, meaning in rows.items() if not meaning] == []
    assert "busN.dropped_by_kernel" in rows
    log = TOP / "test/host/logs/estimate_v1"
    inertiactl("compile", log / "robot.toml", "-o", tmp_path / "robot.cfg")
    command = [*ISOLATED, TOP / "build/bin/inertiad", "-v", "--config", tmp_path / "robot.cfg"]
    command += ["--bus", f"file:{log}/can.log", "--tracker", f"file:{log}/tracker.csv"]
    command += ["--record", tmp_path / "run.lcmlog", "--checkpoint", tmp_path / "checkpoint"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    counted = [name.replace("bus0", "busN") for name in re.findall(r"^inertiad: ([\w.]+) +\d+$", printed, re.MULTILINE)]
    assert len(counted) > len(inertiad_core.counter_table()) + 30
    assert [name for name in counted if name not in rows] == []


def test_counters_mean_what_their_declarations_say():
    firmware = TOP / "firmware"
    found = dict(re.findall(r"^\| `([\w.]+)` \| (.*?) \|", reference.counter_page(firmware), re.MULTILINE))
    assert found["lcm.tracker_unused"].startswith("TRACKER messages not used")
    assert found["busN.bad_stamp"] == 'lines: no "(seconds.fraction)"'
    assert found["position.lateness_max_us"] == "largest lateness of a sample taken in, us"
    assert found["record.dropped"] == "messages lost since open, for any reason"


def test_make_help_lists_every_target_that_has_a_description():
    files = (TOP / "Makefile", TOP / "tools/install.mk", TOP / "firmware/ports/m7.mk", TOP / "tools/fmu.mk")
    described = [t for file in files for t in re.findall(r"^## .*\n([\w-]+):", file.read_text(), re.MULTILINE)]
    listed = subprocess.run(["make", "help"], cwd=TOP, capture_output=True, text=True, check=True).stdout
    assert "m7" in described and re.findall(r"^  make (\S+)", listed, re.MULTILINE) == described


def test_every_message_type_is_there():
    page = reference.messages(TOP / "lcm_types")
    assert [file.stem for file in (TOP / "lcm_types").glob("*.lcm") if f"### {file.stem}\n" not in page] == []


def test_every_finding_is_in_troubleshooting():
    page = (TOP / "host/docs/pages/troubleshooting.md").read_text(encoding="utf-8")
    host = "".join(
        file.read_text(encoding="utf-8")
        for folder in ("identify", "robot")
        for file in (TOP / "host/inertiad/inertiad" / folder).glob("*.py")
    )
    platform = (TOP / "firmware/io/findings.c").read_text(encoding="utf-8")
    names = {
        *re.findall(r'Finding\(\s*"(\w+)"', host),
        *re.findall(r'^\s+name = "(\w+)"', host, re.MULTILINE),
        *re.findall(r'Mistake\(\s*"(\w+)"', host),
        *re.findall(r'add\(found, "(\w+)"', platform),
    }
    names.remove("none")  # what a search for mistakes compares with
    assert len(names) > 25
    assert sorted(name for name in names if f"`{name}`" not in page) == []


# ---- how pages are made ----------------------------------------------------------------------------------------------

HEADER = """// SPDX-License-Identifier: Apache-2.0
/// What the file is.
#pragma once
namespace inertiad {

/// A gate.
class Gate {
public:
    /// Throws.
    explicit Gate(int n) : n_{n}, m_(2) { if (n < 0) { throw 1; } }
    int n() const noexcept { return n_; }

private:
    int n_, m_;
};

/// Adds.
///   a  first
inline int add(int a, int b) { return a + b; }

}  // namespace inertiad
"""


def test_header_without_bodies_and_private_members(tmp_path: Path):
    (tmp_path / "gate.hpp").write_text(HEADER)
    found = headers.read(tmp_path / "gate.hpp")
    assert found.comment == "What the file is."
    gate, add = found.declarations
    assert (gate.name, gate.comment, add.name, add.comment) == ("Gate", "A gate.", "add", "Adds.\n  a  first")
    assert "explicit Gate(int n);" in gate.code and "int n() const noexcept;" in gate.code
    assert "n_" not in gate.code and "throw" not in gate.code
    assert add.code == "inline int add(int a, int b);"


def test_outputs_stand_below_commands(tmp_path: Path):
    page = "a\n```console\n$ x=3; echo one\n$ echo $x \\\n    two\n```\nb\n"
    shown = sessions.with_outputs(page, tmp_path / "run", TOP, "page")
    assert shown == "a\n```console\n$ x=3; echo one\none\n$ echo $x \\\n    two\n3 two\n```\nb\n"


@pytest.mark.parametrize(("typed", "said"), [("false", "exit code 1"), ("exit 3", "ended early")])
def test_command_that_fails_ends_the_build(tmp_path: Path, typed: str, said: str):
    with pytest.raises(sessions.SessionError, match=said):
        sessions.with_outputs(f"```console\n$ echo a\n$ {typed}\n```\n", tmp_path / "run", TOP, "page")


# ---- examples --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fit_and_print.py", "nowhere"], "robot.toml: not found"),
        (["judge_own_csv.py", "firmware/robots/cogiro/robot.toml", "nowhere.csv", "{}"], "nowhere.csv"),
    ],
)
def test_example_names_what_it_cannot_read(tmp_path: Path, words: list[str], said: str):
    command = [sys.executable, EXAMPLES / words[0], *(word.format(tmp_path / "run") for word in words[1:])]
    done = subprocess.run(command, capture_output=True, text=True, cwd=TOP)
    assert done.returncode == 2 and said in done.stderr and "Traceback" not in done.stderr, done.stderr


def test_example_that_hears_nobody_ends_with_1():
    command = [*ISOLATED, sys.executable, EXAMPLES / "follow_estimate.py", "--seconds", "0.3"]
    assert subprocess.run(command, capture_output=True, cwd=TOP).returncode == 1
