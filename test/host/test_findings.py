# SPDX-License-Identifier: Apache-2.0
"""A result that is not sure says so: verdict, findings, exit codes, sigma of correlated residuals, payload changes."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import inertiad_core
from inertiad.base.error import InputError
from inertiad.base.finding import verdict
from inertiad.cli.main import app
from inertiad.identify import block_statistics, identification
from inertiad.run import reader
from inertiad.run.reader import Recording

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "test/accept"))
import scenes  # noqa: E402

pytestmark = pytest.mark.slow


def _invoke(*arguments: object) -> Any:
    return CliRunner().invoke(app, [*map(str, arguments)])


def _fit(tmp_path: Path, *runs: object) -> tuple[int, dict[str, Any]]:
    """Exit code and estimate.json."""
    file = tmp_path / "estimate.json"
    result = _invoke("fit", *runs, "--json", file)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(file.read_text())


def _simulate(folder: Path, *options: object) -> Path:
    done = _invoke("simulate", scenes.COGIRO, "--rate", "50", *options, "-o", folder)
    assert done.exit_code == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def healthy() -> Path:
    return scenes.run(1000, "modern", 100.0, "fourier")


@pytest.fixture(scope="module")
def recording(healthy: Path) -> Recording:
    return reader.read(healthy)


def _names(data: dict[str, Any]) -> set[str]:
    return {finding["name"] for finding in data["findings"] if finding["severity"] != "good"}


# ---- sigma -----------------------------------------------------------------------------------------------------------


def _regression(dice: np.random.Generator, rho: float) -> tuple[dict[str, Any], np.ndarray]:
    """A linear problem of three unknowns in the form of a batch result, its residuals an AR(1) process taken as white,
    and the errors of its solution."""
    n, hop = 1200, 0.1
    t = hop * np.arange(n)
    A = np.column_stack([np.ones(n), np.sin(0.11 * t), np.cos(0.07 * t)])
    e = np.zeros(n)
    for k in range(1, n):
        e[k] = rho * e[k - 1] + np.sqrt(1.0 - rho**2) * dice.standard_normal()
    prior = 1e-6 * np.eye(3)
    x = np.linalg.solve(A.T @ A + prior, A.T @ e)
    left = e - A @ x
    blocks = [
        {
            "run": 0,
            "begin": t[k],
            "end": t[k + 9],
            "H": A[k : k + 10].T @ A[k : k + 10],
            "g": A[k : k + 10].T @ left[k : k + 10],
        }
        for k in range(0, n, 10)
    ]
    correlation = hop * (1.0 + rho) / (1.0 - rho)
    result = {
        "fit": [{"correlation_time": correlation}],
        "blocks": blocks,
        "prior_std": np.ones(3),
        "prior_information": prior,
    }
    return result, x


@pytest.mark.parametrize("rho", [0.0, 0.9, 0.97])
def test_jackknife_covers_whatever_the_residuals_correlation(rho: float) -> None:
    dice = np.random.default_rng(5)
    inside, naive = [], []
    for _ in range(150):
        result, x = _regression(dice, rho)
        of = block_statistics.blocks(result)
        inside.append(np.abs(x) < 1.96 * np.sqrt(np.diag(block_statistics.jackknife(of))))
        naive.append(np.abs(x) < 1.96 * np.sqrt(np.diag(np.linalg.inv(of.total))))
    assert 0.86 < np.mean(inside) < 0.99
    assert rho == 0.0 or np.mean(naive) < 0.7


def test_blocks_last_two_correlation_times_and_lose_nothing() -> None:
    result, _ = _regression(np.random.default_rng(1), 0.97)
    of = block_statistics.blocks(result)
    assert np.diff(of.begin).min() >= result["fit"][0]["correlation_time"]
    np.testing.assert_allclose(of.H.sum(axis=0), sum(b["H"] for b in result["blocks"]))


# ---- verdicts --------------------------------------------------------------------------------------------------------


def test_a_healthy_run_is_good_and_the_file_has_the_contract(healthy: Path, tmp_path: Path) -> None:
    code, data = _fit(tmp_path, healthy)
    assert code == 0
    assert data["converged"] is True and data["verdict"] == "good", data["findings"]
    assert data["segments"] == []
    for finding in data["findings"]:
        assert set(finding) == {"name", "severity", "says", "evidence", "do"}


def _with(run: Recording, **changed: np.ndarray) -> Recording:
    rows = run.rows
    keys = ("acc", "gyro", "q", "position", "f")
    arrays = [np.ascontiguousarray(changed.get(k, getattr(rows, k))) for k in keys]
    return replace(run, rows=inertiad_core.Rows(np.rint(1e9 * rows.t).astype(np.int64), *arrays))


def test_forces_of_another_time_are_stopped(recording: Recording) -> None:
    wrong = _with(recording, f=np.roll(recording.rows.f, len(recording.rows) // 3, axis=0))
    done = identification.identify("joint", wrong.robot, [wrong], [], None)
    assert any(finding.severity == "stop" for finding in done.findings), done.findings


def test_a_gain_far_off_is_named_as_a_correction(recording: Recording) -> None:
    scaled = recording.rows.f * np.r_[1.06, np.ones(7)]
    run = _with(recording, f=scaled)
    done = identification.identify("joint", run.robot, [run], [], None)
    named = [f.evidence.get("parameter") for f in done.findings if f.name == "correction_beyond_prior"]
    assert "force_gain_1" in named, done.findings


@pytest.mark.parametrize("kind", ["no force", "negative force", "one cable dead", "frozen pose", "noise"])
def test_odd_data_end_in_words(recording: Recording, kind: str) -> None:
    rows, dice = recording.rows, np.random.default_rng(3)
    f = rows.f
    changed: dict[str, np.ndarray] = {
        "no force": {"f": np.zeros_like(f)},
        "negative force": {"f": -f},
        "one cable dead": {"f": f * np.r_[0.0, np.ones(7)]},
        "frozen pose": {"position": np.repeat(rows.position[:1], len(f), axis=0)},
        "noise": {"f": 1000.0 * dice.standard_normal(f.shape), "gyro": dice.standard_normal(rows.gyro.shape)},
    }[kind]
    run = _with(recording, **changed)
    try:
        done = identification.identify("joint", run.robot, [run], [], None)
    except InputError as error:
        assert str(error)
        return
    assert verdict(done.findings) != "good", done.findings


def test_a_stopped_calibration_writes_nothing(healthy: Path, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.toml"
    text = (healthy / "robot.toml").read_text()
    wrong.write_text(text.replace("f_1 = ", "f_x = ").replace("f_2 = ", "f_1 = ").replace("f_x = ", "f_2 = "))
    for dbc in healthy.glob("*.dbc"):
        (tmp_path / dbc.name).write_bytes(dbc.read_bytes())
    run = tmp_path / "run"
    run.mkdir()
    for file in healthy.iterdir():
        (run / file.name).write_bytes(file.read_bytes())
    (run / "robot.toml").write_text(wrong.read_text())
    done = _invoke("calibrate", run / "robot.toml", run, "-o", tmp_path / "calibration.toml")
    assert done.exit_code == 1, done.stderr
    assert "look swapped" in done.stderr and "not written" in done.stderr
    assert not (tmp_path / "calibration.toml").exists()


def test_the_papers_method_has_no_sigma_of_one_run(healthy: Path) -> None:
    done = _invoke("fit", healthy, "--method", "paper")
    mass = next(line for line in done.stdout.splitlines() if line.startswith("mass"))
    assert "none" in mass and "0.000 " not in mass.split("kg")[0].split("none")[1]


@pytest.mark.parametrize("method", ["wls", "iv"])
def test_offsets_are_in_the_sigma_of_plain_methods(recording: Recording, method: str) -> None:
    """Five newtons of offset per cable, unknown, are kilograms; wls and iv fit none and must say so."""

    def mass_std(offset: float) -> float:
        std = recording.robot.std.model_copy(update={"force_offset": offset})
        run = replace(recording, robot=recording.robot.model_copy(update={"std": std}))
        done = identification.identify(method, run.robot, [run], [], None)
        assert done.estimate is not None
        return done.estimate.body.std[0]

    assert mass_std(20.0) > 2.0 * mass_std(0.1)


# ---- more than one body ----------------------------------------------------------------------------------------------


def test_a_payload_taken_up_during_a_run_splits_it(tmp_path: Path) -> None:
    run = _simulate(tmp_path / "run", "--seed", 2, "--payload", "20@10")
    code, data = _fit(tmp_path, run)
    assert code == 0 and data["verdict"] == "care"
    assert "payload_changed" in _names(data)
    before, after = data["segments"]
    truth = json.loads((run / "truth.json").read_text())["mass"]
    assert abs(before["mass"]["value"] - (truth - 20.0)) < 3.0 * before["mass"]["std"]
    assert abs(after["mass"]["value"] - truth) < 3.0 * after["mass"]["std"]
    assert before["end"] < 10.6 and after["begin"] > 9.9
    assert data["mass"] == after["mass"]


def test_runs_of_two_bodies_are_not_averaged_in_silence(tmp_path: Path) -> None:
    light = _simulate(tmp_path / "light", "--seed", 3)
    heavy = _simulate(tmp_path / "heavy", "--seed", 3, "--mass", 181.058)
    code, data = _fit(tmp_path, light, heavy)
    assert code == 1 and "runs_disagree" in _names(data)
    said = next(finding for finding in data["findings"] if finding["name"] == "runs_disagree")
    assert said["evidence"]["kind"] == "body" and abs(said["evidence"]["mass_difference"]) == pytest.approx(20, abs=1.5)


def test_runs_with_other_zeros_are_named(tmp_path: Path) -> None:
    one, other = (reader.read(_simulate(tmp_path / name, "--seed", 4)) for name in ("one", "other"))
    moved = _with(other, f=other.rows.f + np.r_[60.0, np.zeros(6), -60.0])
    done = identification.identify("joint", one.robot, [one, moved], [], None)
    found = [finding for finding in done.findings if finding.name == "runs_disagree"]
    assert found and found[0].evidence["kind"] in ("force_offset", "force_gain"), done.findings


def test_equal_runs_do_not_disagree(tmp_path: Path) -> None:
    runs = [_simulate(tmp_path / "one", "--seed", 5), _simulate(tmp_path / "other", "--seed", 5)]
    code, data = _fit(tmp_path, *runs)
    assert code == 0 and not _names(data) & {"runs_disagree", "segments_disagree", "payload_changed"}
