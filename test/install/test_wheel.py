# SPDX-License-Identifier: Apache-2.0
"""The wheel in an empty environment: both programs run, demo identifies, what an installation lacks is named."""

import json
import re
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from conftest import newest, refused, run

SIZE_MAX = 250 * 2**20
"""bytes of a base installation, bytecode included"""


def size_of(folder: Path) -> int:
    """Bytes of a site-packages without pip and setuptools, which the environment brought along."""
    foreign = {"pip", "setuptools", "pkg_resources", "_distutils_hack"}
    files = (p for p in folder.rglob("*") if p.relative_to(folder).parts[0] not in foreign)
    return sum(p.lstat().st_size for p in files if p.is_file())


def test_both_programs_run(wheel_bin):
    version = run(wheel_bin / "inertiactl", "--version").split()[1]
    assert run(wheel_bin / "inertiad", "--version").split() == ["inertiad", version]


def test_demo_finds_the_mass(wheel_bin, tmp_path):
    printed = run(wheel_bin / "inertiactl", "demo", "-o", tmp_path / "demo")
    mass = re.search(r"^mass +kg +(\S+) +(\S+) +(\S+)", printed, re.M)
    assert mass is not None
    truth, estimate, std = map(float, mass.groups())
    assert abs(estimate - truth) < 4 * std
    assert json.loads((tmp_path / "demo/estimate.json").read_text())["mass"]["value"] == pytest.approx(
        estimate, abs=0.01
    )


def test_verify_recomputes_a_run_with_the_packaged_daemon(wheel_bin, simulated):
    assert "rows recomputed: all" in run(wheel_bin / "inertiactl", "verify", simulated)


def test_feed_forward_is_exported_by_every_installation(wheel_bin, prefix, simulated, tmp_path):
    for number, folder in enumerate((wheel_bin, prefix / "bin")):
        model = tmp_path / f"{number}.fmu"
        run(folder / "inertiactl", "export", simulated, "--to", "fmu", "-o", model)
        with zipfile.ZipFile(model) as archive:
            assert any(name.endswith("-linux/inertiad_feed_forward.so") for name in archive.namelist())


def test_base_installation_is_small(wheel_bin):
    site = next((wheel_bin.parent / "lib").glob("python3*/site-packages"))
    assert size_of(site) < SIZE_MAX


@pytest.mark.parametrize(
    ("command", "package", "extra"),
    [
        (("report",), "plotly", "plot"),
        (("export", "--to", "mcap", "-o", "x.mcap"), "mcap", "export"),
        (("export", "--to", "parquet", "-o", "x.parquet"), "pyarrow", "export"),
        (("export", "--to", "mf4", "-o", "x.mf4"), "asammdf", "export"),
    ],
)
def test_what_is_missing_is_named_with_the_extra_that_brings_it(
    wheel_bin, simulated, tmp_path, command, package, extra
):
    name, *options = command
    said = refused(wheel_bin / "inertiactl", name, simulated, *options, cwd=tmp_path)
    assert f"needs the Python package {package}; run pip install 'inertiad[{extra}]'" in said


def test_the_wheel_holds_no_lgpl_library_and_has_its_notice():
    with zipfile.ZipFile(newest("*.whl")) as wheel:
        names = wheel.namelist()
        assert [n for n in names if "liblcm" in n] == []
        notice = next(n for n in names if n.endswith("licenses/NOTICE"))
        assert "replace that file" in wheel.read(notice).decode()


def test_every_optional_package_is_in_the_table_of_extras():
    from inertiad.base.extras import EXTRA

    provided = metadata.packages_distributions()
    project = Path(__file__).resolve().parents[2] / "host/inertiad/pyproject.toml"
    import tomllib

    groups = tomllib.loads(project.read_text())["project"]["optional-dependencies"]
    for extra in ("plot", "optimise", "export"):
        for requirement in groups[extra]:
            name = requirement.split("==")[0]
            imported = {
                m for m, found in provided.items() if name in found and not m.startswith(("_", "mpl_", "pylab"))
            }
            assert imported, name
            assert {m: EXTRA.get(m) for m in imported} == dict.fromkeys(imported, extra)
