# SPDX-License-Identifier: Apache-2.0
"""A log whose ESTIMATE has version 1 of the message is read by every command that reads logs.

logs/estimate_v1: 3 s of CoGiRo at 50 Hz, recorded by the last daemon that wrote version 1; 21 estimates, at 10 Hz.
"""

import shutil
from pathlib import Path

import pytest
from conftest import TOP

from inertiad.run import estimate_message, lcmlog
from inertiad_lcm import estimate_t, estimate_v1_t, estimate_v2_t

OLD = TOP / "test/host/logs/estimate_v1"
MASS = 159.384  # kg, of its last estimate


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return Path(shutil.copytree(OLD, tmp_path / "run"))


def test_old_estimate_becomes_the_present_one_with_names():
    events = [e for e in lcmlog.read(OLD / "run.lcmlog") if e.channel == "INERTIAD_ESTIMATE"]
    old, new = estimate_v1_t.decode(events[-1].data), lcmlog.decode(estimate_t, events[-1], "log")
    assert len(events) == 21
    assert new.mass == old.mass == pytest.approx(MASS, abs=1e-3)
    assert (new.schema, new.verdict, new.covariance) == (1, estimate_t.UNKNOWN, old.covariance)
    named = dict(zip(new.systematic_name, old.systematic, strict=True))
    assert named["position_delay"] == old.systematic[10] and named["force_gain_8"] == old.systematic[26]
    assert list(named)[11] == "force_offset_1" and list(named)[18] == "force_offset_8"
    with pytest.raises(ValueError):
        estimate_message.decode(bytes(8) + events[-1].data[8:])


def test_estimate_of_version_2_becomes_the_present_one():
    """Version 2 was written before payloads could be announced."""
    old = estimate_v2_t()
    old.schema, old.sequence, old.mass, old.verdict = 2, 7, MASS, estimate_v2_t.CARE
    old.n_systematic, old.systematic_name, old.systematic, old.systematic_std = 1, ["position_delay"], [1e-3], [1e-4]
    new = estimate_message.decode(old.encode())
    assert type(new) is estimate_t
    assert (new.schema, new.sequence, new.mass, new.verdict) == (2, 7, MASS, estimate_t.CARE)
    assert (list(new.systematic_name), bool(new.provisional)) == (["position_delay"], False)
    assert estimate_t.decode(new.encode()).mass == MASS


@pytest.mark.slow
def test_fit_reads_it(run, inertiactl):
    done = inertiactl("fit", run / "run.lcmlog")
    assert done.returncode == 0, done.stderr
    assert "159.5" in done.stdout


@pytest.mark.slow
def test_report_reads_it(run, inertiactl):
    (run / "can.log").unlink()
    done = inertiactl("report", run)
    assert done.returncode == 0, done.stderr
    assert (run / "report.html").stat().st_size > 10_000


@pytest.mark.slow
def test_verify_reads_the_configuration_from_it(run, inertiactl):
    done = inertiactl("verify", run)
    assert done.returncode == 0, done.stdout + done.stderr
    # Its configuration has fewer fields than today's: it cannot be compared, and verify says so.
    assert "run.lcmlog was written by another version" in done.stdout


def test_export_reads_it(run, inertiactl):
    done = inertiactl("export", run / "run.lcmlog", "--to", "csv", "-o", run / "x.csv")
    assert done.returncode == 0, done.stderr
    header, *rows = (run / "x.estimate.csv").read_text().splitlines()
    assert len(rows) == 21
    assert "attitude_bias_x [rad]" in header.split(",") and "force_offset_8 [N]" in header.split(",")


def test_watch_shows_it(run, inertiactl):
    done = inertiactl("watch", "--lcm", f"file://{run}/run.lcmlog?speed=0", "--seconds", "30")
    assert done.returncode == 0, done.stderr
    assert f"{MASS}" in done.stdout
