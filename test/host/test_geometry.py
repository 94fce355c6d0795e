# SPDX-License-Identifier: Apache-2.0
"""Descriptions that are allowed and most likely wrong: compile and view say so; all mistakes of a file at once."""

import json
import re

import pytest
from browser import browser
from conftest import COGIRO, TOP, minimal_toml

from inertiad.base.error import InputError
from inertiad.report import view
from inertiad.robot import configuration, description, geometry, template
from inertiad.robot.template import example_geometry

ROBOTS = [*COGIRO.glob("robot*.toml"), *(TOP / "firmware/robots/devices").glob("*.toml")]


def findings(path):
    robot = description.load(path)
    return geometry.compiled(robot, "x")[1]


def new_text(n):
    return template.text(template.Start("new", n))


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_nothing_is_wrong_with_real_robots(path):
    assert findings(path) == []


@pytest.mark.parametrize("n", range(1, 17))
def test_nothing_is_wrong_with_new_robots(robot_file, n):
    assert [finding.name for finding in findings(robot_file(new_text(n)))] == ["example_places"]


def with_cables(change, n=8):
    """A new robot's text with each cable's anchor and attachment changed, and moved off the example by 1 mm."""
    lines = []
    for i, (anchor, attachment) in enumerate(template.example_geometry(n)):
        anchor, attachment = change(i, anchor, attachment)
        anchor = [anchor[0] + 1e-3, *anchor[1:]]
        lines.append(f"[[cable]]\nanchor = {[float(v) for v in anchor]}\nattachment = {[float(v) for v in attachment]}")
    return 'name = "x"\n' + "\n".join(lines) + "\n"


def scaled(v, k):
    return [k * x for x in v]


@pytest.mark.parametrize(
    ("change", "name", "says"),
    [
        (lambda i, a, b: (scaled(a, 1000.0 if i == 2 else 1.0), b), "far_anchor", r"cable\[3\].anchor is \d+ m from"),
        (lambda i, a, b: (a, scaled(b, 40.0 if i == 5 else 1.0)), "far_attachment", r"cable\[6\].attachment is"),
        (lambda i, a, b: (a, scaled(b, 20.0)), "huge_platform", "the platform would be larger than the robot"),
        (lambda i, a, b: (a, [b[0] + 9.0, b[1], b[2]]), "far_platform_frame", "from the origin of P"),
        (lambda i, a, b: (scaled(a, 1000.0), b), "huge_robot", "are they in mm"),
        (lambda i, a, b: (a, [0.1, 0.0, 0.0]), "one_attachment", "all 8 cables are attached to the platform at one"),
        (lambda i, a, b: (a, [b[0], b[1], 0.0]) if i else (a, b), None, ""),
        (lambda i, a, b: ([a[0], 0.0, a[2] + 0.3 * i], [b[0], 0.0, b[2]]), "rank", "span only 3 of 6 dimensions"),
        (lambda i, a, b: template.example_geometry(8)[min(i, 6)], "same_cable", "cables 7 and 8"),
        (lambda i, a, b: ([a[0], a[1], -a[2]], b), "cannot_lift", "z of W points up"),
    ],
)
def test_implausible_geometry_is_named(robot_file, change, name, says):
    found = findings(robot_file(with_cables(change)))
    if name is None:
        assert found == []
        return
    texts = {finding.name: f"{finding.says}; {finding.do}" for finding in found}
    assert name in texts, texts
    assert re.search(says, texts[name]), texts[name]


@pytest.mark.parametrize(("rate", "name"), [(900_000, "bitrate"), (1_000_001, None), (500_000, None), (0, None)])
def test_bitrate_of_no_bus_is_named(robot_file, rate, name):
    text = (COGIRO / "robot.toml").read_text()
    assert "bitrate = 1_000_000" in text
    path = robot_file(text.replace("bitrate = 1_000_000", f"bitrate = {rate}"))
    assert [finding.name for finding in findings(path)] == ([name] if name else [])


def test_all_mistakes_of_a_file_at_once(robot_file, inertiactl, tmp_path):
    text = minimal_toml(4, "[imu]\nrte = 1.0\nposition = [0.0, 1.0]\n[align]\nmax_wait = -1.0\n")
    path = robot_file(text.replace("tension_min = 1\n", "tension_min = -1\n"))
    done = inertiactl("compile", path, "-o", tmp_path / "robot.cfg")
    assert done.returncode == 2
    lines = [line.removeprefix(f"inertiactl: {path}: ") for line in done.stderr.splitlines()]
    assert lines == [
        "cables.tension_min = -1: allowed: 0 to 1e+07 N",
        "imu.position = [0.0, 1.0]: allowed: 3 entries, not 2",
        "imu.rte: unknown key; did you mean rate?",
        "align.max_wait = -1.0: allowed: 0 to 10 s",
    ]


def test_all_mistakes_of_the_signals_at_once(robot_file):
    text = (COGIRO / "robot.toml").read_text()
    text = re.sub(r'(acc_x = )"[^"]*"', r'\1"NOTHING.acc"', text)
    text = re.sub(r'(f_2 = )"([^".]*)\.[^"]*"', r'\1"\2.nothing"', text)
    path = robot_file(re.sub(r"\nq_w = .*", "", text))
    with pytest.raises(InputError) as caught:
        configuration.compile_robot(description.load(path), "robot.toml")
    found = sorted(line.split(":")[1].split(" = ")[0].strip() for line in caught.value.lines)
    assert found == ["signals.acc_x", "signals.f_2", "signals.q_w"]


def test_cause_of_a_refused_configuration_is_named(robot_file):
    path = robot_file(with_cables(lambda i, a, b: (a, scaled(b, 1000.0 if i == 5 else 1.0))))
    with pytest.raises(InputError) as caught:
        findings(path)
    assert any(line.startswith("care: cable[6].attachment is") for line in caught.value.lines)


def test_compile_says_what_is_implausible_and_writes(robot_file, inertiactl, tmp_path):
    path = robot_file(with_cables(lambda i, a, b: (scaled(a, 1000.0 if i == 2 else 1.0), b)))
    done = inertiactl("compile", path, "-o", tmp_path / "robot.cfg", "--json", "-")
    assert done.returncode == 0
    assert "care: cable[3].anchor" in done.stderr
    document = json.loads(done.stdout)
    assert (document["verdict"], document["findings"][0]["name"]) == ("care", "far_anchor")
    assert document["bytes"] == (tmp_path / "robot.cfg").stat().st_size


# ---- view ------------------------------------------------------------------------------------------------------------


def test_feasible_box_holds_the_platform_and_is_the_largest(cogiro):
    shown = view.read(COGIRO / "robot.toml")
    edges = view.feasible_box(shown)
    assert edges is not None
    assert view._can_hold(shown.mechanics, edges.reshape(2, 3)).all()
    usual = geometry.box(cogiro)
    assert (edges[:3] <= usual[:3] + 0.1).all()
    assert (edges[3:] >= usual[3:] - 0.1).all()


def test_largest_box_of_a_grid():
    import numpy as np

    held = np.zeros((5, 5, 5), bool)
    held[1:4, 2:5, 0:2] = True
    held[0, 0, 0] = True
    low, high = view._largest_box(held)
    assert (low.tolist(), high.tolist()) == ([1, 2, 0], [3, 4, 1])
    assert view._largest_box(np.zeros((3, 3, 3), bool)) is None


def test_robot_of_four_cables_has_no_box(robot_file):
    assert view.feasible_box(view.read(robot_file(new_text(4)))) is None


@pytest.mark.slow
def test_page_opens_in_a_browser_at_both_widths(robot_file, tmp_path):
    path = robot_file(with_cables(lambda i, a, b: (scaled(a, 1000.0 if i == 2 else 1.0), b)))
    page = tmp_path / "view.html"
    said = view.write(path, page, "inertiactl view", lambda step: None)
    assert said[0].startswith("care: cable[3].anchor")
    with browser() as window:
        for width in (1280, 400):
            window.show(width, 900)
            window.open(page)
            assert window.ask("document.documentElement.scrollWidth") <= width
            assert "cable[3].anchor" in window.ask("document.querySelector('#verdict').innerText")
            assert window.ask("document.querySelectorAll('#figure-robot .drawing canvas').length") > 0
            assert window.ask("document.querySelectorAll('#cables tbody tr').length") == 8
        assert window.complaints == []
        assert all(url.startswith(("file:", "data:", "blob:")) for url in window.requests)


def test_view_draws_a_robot_whose_cable_has_no_direction(robot_file, tmp_path):
    text = with_cables(lambda i, a, b: (a, b))
    path = robot_file(
        text.replace('name = "x"\n', 'name = "x"\n[cables]\npulley_radius = 8.0\n')
    )  # the platform is inside
    page = tmp_path / "view.html"
    said = view.write(path, page, "inertiactl view", lambda step: None)
    assert any("direction" in line for line in said), said
    assert "A cable has no direction in this place" in page.read_text()


def test_places_of_the_template_are_named_until_they_are_replaced(inertiactl, tmp_path):
    path = tmp_path / "robot.toml"
    assert inertiactl("init", "--cables", "6", "-o", path).returncode == 0
    done = inertiactl("compile", path, "-o", tmp_path / "robot.cfg")
    assert done.returncode == 0 and "care: cables 1, 2, 3, 4, 5, 6 are at the example places" in done.stderr
    for cable, (anchor, _) in enumerate(example_geometry(6)):
        path.write_text(path.read_text().replace(f"anchor = {anchor}", f"anchor = {[v + 0.01 for v in anchor]}"))
        said = inertiactl("compile", path, "-o", tmp_path / "robot.cfg").stderr if cable in (2, 5) else ""
        assert ("are at the example places" in said) == (cable == 2)
