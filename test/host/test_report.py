# SPDX-License-Identifier: Apache-2.0
"""report: the page in a real browser, the sensor it names, the words for runs that tell nothing."""

import csv
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, browser
from conftest import COGIRO, TOP

import inertiad_core
from inertiad.base import table
from inertiad.identify import fit
from inertiad.report import document, figure, interactive, page, picture, printed, report_data, scene, verdict
from inertiad.report.report_data import Facts
from inertiad.run import lcmlog, reader

pytestmark = pytest.mark.slow

SIGNALS = ("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z", "q_w", "q_x", "q_y", "q_z")
BROKEN = 2
"""index of the cable whose sensor is spoilt"""


def ignore(step: str) -> None:
    """Progress nobody looks at."""


def inertiactl(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "inertiad", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=TOP)


def simulated(folder: Path, *options: object) -> Path:
    done = inertiactl("simulate", COGIRO / "robot.toml", *options, "-o", folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("report") / "good", "--rate", 100, "--seed", 3)


@pytest.fixture(scope="module")
def again(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("report") / "again", "--rate", 50, "--seed", 4)


def spoilt(good: Path, folder: Path, fault: str) -> Path:
    """The run as signals CSV, with one force sensor that misbehaves from the middle on."""
    rows = reader.read(good).rows
    f, late = rows.f.copy(), rows.t > rows.t[len(rows) // 2]
    match fault:
        case "jump":
            f[late, BROKEN] += 60.0
        case "stuck":
            f[late, BROKEN] = f[late, BROKEN][0]
        case "drift":
            f[:, BROKEN] += 3.0 * (rows.t - rows.t[0])
        case "noise":
            f[:, BROKEN] += 100.0 * np.random.default_rng(1).standard_normal(len(f))
    names = [*SIGNALS, *(f"f_{i + 1}" for i in range(f.shape[1])), "pos_x", "pos_y", "pos_z"]
    columns = np.column_stack([rows.t, rows.acc, rows.gyro, rows.q, f, rows.position])
    folder.mkdir(exist_ok=True)
    file = folder / "signals.csv"
    np.savetxt(file, columns, fmt="%.9g", delimiter=",", header=",".join(["t", *names]), comments="")
    (folder / "robot.toml").write_text((good / "robot.toml").read_text())
    for dbc in good.glob("*.dbc"):
        (folder / dbc.name).write_bytes(dbc.read_bytes())
    return file


def gathered(*paths: Path) -> Facts:
    return report_data.gather(list(paths), None, "inertiactl report", ignore)


def levels(found: verdict.Verdict) -> dict[str, str]:
    return {finding.says: finding.severity for finding in found.findings}


# ---- words -----------------------------------------------------------------------------------------------------------


def test_good_run_is_called_good_and_says_what_limits_it(good: Path) -> None:
    found = verdict.judge(gathered(good))
    assert found.severity == "good", found
    accuracy = next(f for f in found.findings if f.says.startswith("mass to"))
    assert "% of the variance is" in accuracy.do or "limited by noise" in accuracy.do


@pytest.mark.parametrize("fault", ["jump", "drift", "noise"])
def test_broken_force_sensor_is_named_and_the_others_give_the_body(good: Path, tmp_path: Path, fault: str) -> None:
    facts = gathered(spoilt(good, tmp_path / fault, fault))
    check = facts.force_check
    assert check is not None and check.broken == BROKEN and check.worst == BROKEN
    found = verdict.judge(facts)
    assert found.severity == "stop" and found.headline == "Do not use this result yet"
    assert any(f"force sensor of cable {BROKEN + 1} does not fit" in text for text in levels(found))
    assert check.body is not None
    error = np.abs(np.array(check.body.value[:4]) - [161.058, -0.001, -0.077, -0.118])
    assert (error < np.array([2.5, 0.01, 0.01, 0.01])).all(), check.body


def test_stuck_force_sensor_is_named_and_the_fit_does_without_it(good: Path, tmp_path: Path) -> None:
    facts = gathered(spoilt(good, tmp_path / "stuck", "stuck"))
    found = verdict.judge(facts)
    assert found.severity == "care", found.findings
    (says,) = [f.says for f in found.findings if f.name == "broken_force_sensor"]
    said = re.search(rf"force sensor {BROKEN + 1} has failed for (\d+) % of the time, first at ([\d.]+) s", says)
    assert said is not None, says
    share, first = float(said[1]), float(said[2])
    assert share == pytest.approx(50.0, abs=2.0)
    assert first == pytest.approx(0.5 * reader.read(good).duration, abs=0.5)
    assert not any(f.name in ("slack_cable", "forces_disagree", "saturated_sensor") for f in found.findings)
    assert facts.joint is not None
    body = facts.joint.body
    assert abs(body.value[0] - 161.058) < 2.5 * body.std[0]


def test_jump_is_shown_with_its_size(good: Path, tmp_path: Path) -> None:
    check = gathered(spoilt(good, tmp_path / "jump", "jump")).force_check
    assert check is not None and check.error is not None
    half = len(check.error) // 2
    assert np.median(check.error[half + 5 :]) - np.median(check.error[: half - 5]) == pytest.approx(60.0, abs=6.0)


def test_healthy_sensors_are_not_accused(good: Path, again: Path) -> None:
    for path in (good, again):
        check = gathered(path).force_check
        assert check is not None and check.broken is None


def test_each_run_is_predicted_from_the_others_alone(good: Path, again: Path) -> None:
    facts = gathered(good, again)
    assert not any(finding.evidence.get("kind") == "body" for finding in facts.found)
    config = reader.config_of(facts.robot, "test")
    others = fit.joint(config, [reader.read(again)])
    alone = fit.validate(config, others, reader.read(good))
    assert facts.runs[0].prediction is not None
    np.testing.assert_array_equal(facts.runs[0].prediction.tension_rms, alone.tension_rms)


def test_runs_of_different_bodies_are_told_apart(good: Path, tmp_path: Path) -> None:
    heavier = simulated(tmp_path / "heavier", "--rate", 50, "--seed", 4, "--mass", 181.058)
    found = verdict.judge(gathered(good, heavier))
    assert found.severity == "stop"
    finding = next(f for f in found.findings if f.evidence.get("kind") == "body")
    sign = 1.0 if finding.says.startswith("heavier") else -1.0  # of two runs either is the other one
    assert f"saw a different body than the other runs: mass differs by {'+' if sign > 0.0 else '-'}" in finding.says
    gains = 0.01 * float(np.hypot(161.058, 181.058))  # kg: each run's sensors have a common gain of their own
    assert finding.evidence["mass_difference"] == pytest.approx(20.0 * sign, abs=gains)


def test_convergence_is_the_daemons_own_estimate(good: Path) -> None:
    history = gathered(good).runs[0].history
    config = reader.config_of(reader.robot_of(good), "test")
    end = inertiad_core.read_run(config, [f"{good}/can.log"], [""], f"{good}/tracker.csv").estimate
    assert history is not None
    np.testing.assert_allclose(history.value[-1], [end["mass"], *end["cog"], *end["inertia_cog"]], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        history.std[-1], [end["mass_std"], *end["cog_std"], *end["inertia_cog_std"]], rtol=1e-9, atol=1e-9
    )


def test_shares_of_the_variance_are_shares(good: Path) -> None:
    u = gathered(good).uncertainty
    assert u is not None
    for name, share in u.share.items():
        assert (share >= -1e-9).all() and (share <= 1.0 + 1e-9).all(), name
    assert (u.alone <= u.found * (1.0 + 1e-9)).all() and (u.found < u.prior).all()


# ---- runs that tell nothing ------------------------------------------------------------------------------------------


def without_tracker(run: Path) -> None:
    (run / "tracker.csv").unlink()


def empty(run: Path) -> None:
    (run / "can.log").write_text("")


def shortened(seconds: float) -> object:
    def cut(run: Path) -> None:
        lines = (run / "can.log").read_text().splitlines(keepends=True)
        (run / "can.log").write_text("".join(lines[: int(600 * seconds)]))

    return cut


@pytest.mark.parametrize(
    ("damage", "words", "n_figures"),
    [
        (without_tracker, "no positions: no tracker.csv", 2),
        (empty, "can.log is empty", 0),
        (shortened(0.005), "no sample is whole", 0),
        (shortened(0.3), "no whole window", 2),
        (shortened(1.2), "1.0 s are short", 12),
    ],
)
def test_run_that_tells_little_gets_words_and_no_empty_figure(good, tmp_path, damage, words, n_figures) -> None:
    run = tmp_path / "run"
    run.mkdir()
    for file in good.iterdir():
        if file.suffix != ".html":
            (run / file.name).write_bytes(file.read_bytes())
    damage(run)
    result = inertiactl("report", run)
    assert result.returncode == 0 and "Traceback" not in result.stderr, result.stderr
    assert words in result.stderr
    made = document.page_of(gathered(run))
    drawn = page.drawings_of(made)
    assert len(drawn) == n_figures
    for drawing in drawn:
        assert all(trace.get("x") for trace in interactive.document(drawing)["data"]), drawing.key


def test_what_is_not_a_run_is_refused_in_one_line(tmp_path: Path) -> None:
    for path, words in ((tmp_path / "nothing", "No such file"), (tmp_path, "robot.toml: not found")):
        result = inertiactl("report", path)
        assert result.returncode == 2 and words in result.stderr and result.stderr.count("\n") == 1


@pytest.fixture(scope="module")
def logged(good: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the daemon published about the good run, run.lcmlog, and the robot's description."""
    folder = tmp_path_factory.mktemp("logged")
    for file in (*good.glob("*.dbc"), good / "robot.toml"):
        (folder / file.name).write_bytes(file.read_bytes())
    assert inertiactl("compile", good / "robot.toml", "-o", folder / "robot.cfg").returncode == 0
    daemon = [str(TOP / "build/bin/inertiad"), "--config", str(folder / "robot.cfg")]
    inputs = ["--bus", f"file:{good}/can.log?speed=0", "--tracker", f"file:{good}/tracker.csv"]
    log = ["--lcm", f"file://{folder}/run.lcmlog?mode=w"]
    subprocess.run([*daemon, *inputs, *log], check=True, capture_output=True)
    return folder


def assert_same_body(a: Facts, b: Facts) -> None:
    assert a.joint is not None and b.joint is not None
    np.testing.assert_allclose(a.joint.body.value, b.joint.body.value, rtol=1e-9, atol=1e-12)


def test_log_of_the_daemon_gives_the_same_body_as_its_input(good: Path, logged: Path) -> None:
    assert_same_body(gathered(logged), gathered(good))


def test_log_of_two_daemons_is_refused_with_the_command_that_takes_one_out(logged: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(logged, tmp_path / "mixed")
    mixed = lcmlog.Writer(folder / "mixed.lcmlog")
    for event in lcmlog.read(logged / "run.lcmlog"):
        mixed.write(event.t_us, event.channel, event.data)
        mixed.write(event.t_us, event.channel.replace("INERTIAD_", "OTHER_"), event.data)
    mixed.close()
    refused = inertiactl("fit", mixed.path)
    assert refused.returncode == 2 and "of several daemons, prefixes INERTIAD_, OTHER_: " in refused.stderr
    advised = refused.stderr.split("inertiactl ")[-1].split()
    done = inertiactl(*advised[:-1], folder / advised[-1])
    assert done.returncode == 0, done.stderr
    assert_same_body(gathered(folder / "signals.csv"), gathered(logged))


# ---- drawings --------------------------------------------------------------------------------------------------------


def test_thinned_line_keeps_every_peak() -> None:
    y = np.zeros(100_000)
    y[[777, 54_321]] = 1.0, -1.0
    x, thin = figure.thinned(np.arange(len(y), dtype=float), y)
    assert len(thin) <= figure.POINTS_MAX + 2 and thin.max() == 1.0 and thin.min() == -1.0
    assert {777.0, 54_321.0} <= set(x.tolist())


def test_drawings_of_every_kind_are_written_as_png_and_pdf(good: Path, tmp_path: Path) -> None:
    whole = document.page_of(gathered(good))
    picture.write(tmp_path / "all.png", whole)
    assert (tmp_path / "all.png").stat().st_size > 500_000
    made = {drawing.key: drawing for drawing in page.drawings_of(whole)}
    assert len(made) >= 12
    for key in ("platform", "tensions", "limits"):
        printed.write(made[key], tmp_path)
        assert (tmp_path / f"{key}.png").read_bytes().startswith(b"\x89PNG")
        assert (tmp_path / f"{key}.pdf").read_bytes().startswith(b"%PDF")


def test_names_from_files_are_text_on_the_page(good: Path, tmp_path: Path) -> None:
    text = (good / "robot.toml").read_text()
    evil = "</script><script>window.broken=1</script>"
    folder = tmp_path / "evil"
    spoilt(good, folder, "none")
    (folder / "robot.toml").write_text(re.sub(r'(?m)^name = ".*"', f'name = "{evil}"', text))
    html = page.render(document.page_of(gathered(folder / "signals.csv")))
    assert evil not in html and "&lt;/script&gt;" in html


# ---- the browser -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(good: Path, again: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("page") / "report.html"
    result = inertiactl("report", good, again, "-o", file)
    assert result.returncode == 0, result.stderr
    return file


@pytest.fixture(scope="module")
def opened(written: Path):
    with browser() as shown:
        shown.show(1200, 900)
        shown.open(written)
        yield shown


def test_page_is_one_file_below_8_MB_that_asks_for_nothing(written: Path, opened: Browser) -> None:
    assert written.stat().st_size < 8e6
    assert [url for url in opened.requests if not url.startswith(("file:", "data:"))] == []
    assert opened.requests[0] == written.resolve().as_uri()


def test_page_draws_everything_without_complaint(opened: Browser) -> None:
    assert opened.complaints == []
    drawn = opened.ask(
        """[...document.querySelectorAll(".drawing")].map((box) => ({
            key: box.dataset.key,
            height: box.clientHeight,
            is_flat: box.classList.contains("flat"),
            marks: box.querySelectorAll(".trace, .point, .points path, .hm image, .heatmaplayer image").length,
        }))"""
    )
    assert len(drawn) == int(opened.ask("document.documentElement.dataset.drawn")) >= 13
    for box in drawn:
        assert box["height"] > 100, box
        assert not box["is_flat"] or box["marks"] > 0, box


def test_solid_is_really_drawn_and_turns(opened: Browser) -> None:
    """WebGL pixels: many colours, and other ones after a turn of the camera."""
    snapshot = """(async () => {
        const url = await Plotly.toImage(document.querySelector(".scene"), {format: "png", width: 500, height: 350});
        const image = new Image(); image.src = url; await image.decode();
        const canvas = document.createElement("canvas"); canvas.width = 500; canvas.height = 350;
        const context = canvas.getContext("2d", {willReadFrequently: true}); context.drawImage(image, 0, 0);
        return [...context.getImageData(0, 0, 330, 350).data];
    })()"""
    before = np.array(opened.ask(snapshot)).reshape(-1, 4)
    assert len(np.unique(before[:, :3], axis=0)) > 200
    turn = """Plotly.relayout(document.querySelector(".scene"), {"scene.camera.eye": {x: -1, y: 1, z: 1}})"""
    opened.ask(f"{turn}.then(() => 0)")
    after = np.array(opened.ask(snapshot)).reshape(-1, 4)
    assert (np.abs(after - before).max(axis=1) > 30).mean() > 0.01


def test_both_views_of_the_solid_are_true_to_scale(opened: Browser) -> None:
    """Equal lengths along x, y and z are equal in the scene's own units, in each view."""
    state = """(() => { const s = document.querySelector(".scene")._fullLayout.scene;
        return ["x", "y", "z"].map((a) => s.aspectratio[a] / (s[a + "axis"].range[1] - s[a + "axis"].range[0])); })()"""
    for view in (1, 0):
        opened.ask(f"""(() => {{ const box = document.querySelector(".scene");
            const [marks, layout] = box._fullLayout.updatemenus[0].buttons[{view}].args;
            return Plotly.update(box, marks, layout).then(() => 0); }})()""")
        scale = opened.ask(state)
        assert max(scale) == pytest.approx(min(scale), rel=1e-6), scale
    assert opened.ask("document.querySelectorAll('.scene .legend .traces').length") <= 6


def test_labels_of_close_points_are_one() -> None:
    points = np.array([[0.0, 0, 0], [5.0, 0, 0], [0.1, 0, 0], [5.0, 0.1, 0], [9.0, 0, 0]])
    assert scene.merged_labels(points, 0.5) == ["1, 3", "2, 4", "", "", "5"]
    assert scene.merged_labels(points, 0.0) == ["1", "2", "3", "4", "5"]


def test_every_figure_gives_its_numbers_as_csv(opened: Browser) -> None:
    opened.ask("URL.createObjectURL = (blob) => { window.saved = blob; return 'data:,'; }, 0")
    keys = opened.ask("[...document.querySelectorAll('button.csv')].map((b) => b.dataset.key)")
    assert keys == opened.ask("[...document.querySelectorAll('.drawing')].map((b) => b.dataset.key)")
    for key in keys:
        opened.ask(f"""document.querySelector('button.csv[data-key="{key}"]').click()""")
        rows = list(csv.reader(opened.ask("window.saved.text()").splitlines()))
        assert rows[0] == ["panel", "series", "x", "y", "z", "half_width"] and len(rows) > 1, key
        assert all(len(row) == 6 for row in rows), key
        if key == "convergence":
            drawn = opened.ask("""JSON.parse(document.getElementById("drawings").textContent).convergence.data
                .filter((line) => line.hoverinfo !== "skip").map((line) => [line.name, line.x.length, line.y[0]])""")
            named = [row for row in rows[1:] if row[1] == drawn[0][0] and row[0] == "mass, kg"]
            assert len(named) >= drawn[0][1] > 10 and float(named[0][3]) == drawn[0][2]


def test_tables_have_scopes_and_a_page_without_scripts_says_so(written: Path, opened: Browser) -> None:
    assert opened.ask("document.querySelectorAll('th:not([scope])').length") == 0
    assert opened.ask("document.querySelectorAll('tbody tr > :first-child:not(th)').length") == 0
    assert "<noscript>" in written.read_text() and opened.ask("document.querySelector('.back').hash") == "#top"


def test_narrow_page_begins_with_closed_sections_that_open_and_draw(written: Path) -> None:
    with browser() as shown:
        shown.show(400, 900)
        shown.open(written)
        is_open = "[...document.querySelectorAll('details.part')].map((part) => part.open)"
        parts = shown.ask(is_open)
        assert parts[0] and not any(parts[1:])
        shown.ask("document.querySelector('nav a[href=\"#tensions\"]').click()")
        shown.wait("document.querySelector('#tensions .flat .trace') !== null")
        assert shown.complaints == []


def test_page_follows_theme_and_width_and_prints(opened: Browser, tmp_path: Path) -> None:
    ink = """getComputedStyle(document.querySelector(".flat .xtick text")).fill"""
    light = opened.ask(ink)
    opened.show(1200, 900, "dark")
    opened.wait(f"{ink} !== {light!r}")
    opened.show(420, 900)
    opened.wait("[...document.querySelectorAll('.flat')].every((box) => box._fullLayout.width <= 420)")
    assert opened.ask("document.documentElement.scrollWidth") <= 420
    opened.show(1200, 900)
    closed = "document.querySelectorAll('details:not([open])').length"
    before = opened.ask(closed)
    opened.ask(f"window.addEventListener('beforeprint', () => {{ window.closedOnPaper = {closed}; }}), 0")
    opened.print(tmp_path / "page.pdf")
    assert opened.ask("window.closedOnPaper") == 0 and opened.ask(closed) == before > 0
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
    assert opened.complaints == []


def test_verdict_comes_first(opened: Browser) -> None:
    assert opened.ask("document.querySelector('main').firstElementChild.id") == "verdict"


def test_table_of_signals_is_what_was_spoilt(good: Path, tmp_path: Path) -> None:
    """The test's own tool: only one channel differs."""
    file = spoilt(good, tmp_path / "jump", "jump")
    read = table.read(file, ["t", *SIGNALS, "pos_x", "pos_y", "pos_z", *(f"f_{i + 1}" for i in range(8))])
    f = reader.read(good).rows.f
    differs = [i for i in range(8) if np.abs(read.columns[f"f_{i + 1}"] - f[:, i]).max() > 1.0]
    assert differs == [BROKEN]
