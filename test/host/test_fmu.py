# SPDX-License-Identifier: Apache-2.0
"""The feed-forward's FMU: built, validated and simulated by FMPy, beside the same mathematics of the Python binding."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import COGIRO, TOP, minimal_toml

import inertiad_core
from inertiad.base.error import InputError
from inertiad.exchange import convert, fmu
from inertiad.robot import configuration, description

ROBOT = COGIRO / "robot.toml"
N = 21
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("fmu") / "robot.fmu"
    command = [sys.executable, "-m", "inertiad", "export", ROBOT, "--to", "fmu", "-o", path]
    done = subprocess.run(command, cwd=TOP, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return path


def motion() -> dict[str, np.ndarray]:
    """Inputs at N instants: a pose that turns, and parameters that jump in the middle."""
    t = np.linspace(0.0, 2.0, N)
    angle = 0.3 * np.sin(t)
    half = np.column_stack([np.cos(angle / 2), np.sin(angle / 2), 0 * t, 0 * t])
    body = description.load(ROBOT).nominal
    theta = np.tile(configuration.theta_of(body), (N, 1))
    theta[N // 2 :] = theta[N // 2 :] * 1.4
    return {
        "p": np.column_stack([0.4 * np.sin(t), 0.3 * np.cos(t), 2.0 + 0.1 * t]),
        "q": 3.0 * half,
        "a": np.column_stack([-0.4 * np.sin(t), -0.3 * np.cos(t), 0 * t]),
        "w": np.column_stack([0.3 * np.cos(t), 0 * t, 0 * t]),
        "alpha": np.column_stack([-0.3 * np.sin(t), 0 * t, 0 * t]),
        "theta": theta,
    }


def expected(given: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Wrench and tensions by the binding's regressor, wrench matrix and distribution."""
    robot = description.load(ROBOT)
    config = inertiad_core.Config(configuration.compile_robot(robot, str(ROBOT)))
    q = given["q"] / np.linalg.norm(given["q"], axis=1)[:, None]
    w, x, y, z = q.T
    R = np.empty((N, 3, 3))
    R[:, 0] = np.column_stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)])
    R[:, 1] = np.column_stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)])
    R[:, 2] = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    s = np.einsum("kji,kj->ki", R, given["a"] + [0.0, 0.0, robot.gravity])
    wrench, tension = np.empty((N, 6)), np.empty((N, robot.n_cables))
    W, sag = inertiad_core.wrench_matrix(config, given["p"], R, np.zeros(3))
    low = np.array([c.tension_min for c in robot.cable])
    high = np.array([c.tension_max for c in robot.cable])
    Y = inertiad_core.regressor(s, given["w"], given["alpha"])
    for k in range(N):
        wrench[k] = Y[k] @ given["theta"][k]
        pull = np.clip(2.0 * given["theta"][k, 0] * robot.gravity / robot.n_cables, low, high)
        f, broken = inertiad_core.distribute(W[k : k + 1], (wrench[k] - sag[k])[None], pull, low, high)
        assert not broken
        tension[k] = f[0]
    return wrench, tension


def test_fmpy_finds_no_fault(model):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(model)) == []


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_outputs_are_those_of_the_core(model, kind, tmp_path):
    from fmpy import extract, instantiate_fmu, read_model_description

    given = motion()
    wrench, tension = expected(given)
    described = read_model_description(str(model))
    reference = {v.name: v.valueReference for v in described.modelVariables}
    instance = instantiate_fmu(extract(str(model), str(tmp_path)), described, fmi_type=kind)
    instance.enterInitializationMode()
    instance.exitInitializationMode()
    for k in range(N):
        for name, values in given.items():
            instance.setFloat64([reference[name]], [float(x) for x in values[k]])
        got = instance.getFloat64([reference["wrench"], reference["tension"]], nValues=6 + tension.shape[1])
        assert got[:6] == pytest.approx(wrench[k], rel=1e-12, abs=1e-9)
        assert got[6:] == pytest.approx(tension[k], rel=1e-9)
        assert instance.getBoolean([reference["feasible"]]) == [True]
    instance.setFloat64([reference["theta"]], [1e5, *[0.0] * 3, *[1e5] * 3, *[0.0] * 3])
    assert instance.getBoolean([reference["feasible"]]) == [False]
    instance.terminate()
    instance.freeInstance()


def test_simulation_by_fmpy_takes_parameters_while_it_runs(model):
    from fmpy import simulate_fmu

    columns = [("time", np.float64), ("theta", np.float64, (10,))]
    body = np.asarray(configuration.theta_of(description.load(ROBOT).nominal))
    signals = np.array([(0.0, body), (0.5, body), (0.5, 2.0 * body), (1.0, 2.0 * body)], dtype=columns)
    found = simulate_fmu(
        str(model), stop_time=1.0, step_size=0.1, output_interval=0.1, input=signals, output=["wrench"],
        fmi_type="CoSimulation",
    )  # fmt: skip
    force = found["wrench"][:, 2]
    assert force[2] == pytest.approx(body[0] * description.load(ROBOT).gravity)
    assert force[-1] == pytest.approx(2.0 * force[2])


@pytest.mark.parametrize(("is_installed", "remedy"), [(False, "run make fmu"), (True, "install inertiad again")])
def test_library_that_is_not_there_is_named(tmp_path, monkeypatch, is_installed, remedy):
    from inertiad.base import installation

    monkeypatch.setattr(installation, "SOURCE_TREE", None if is_installed else tmp_path)
    with pytest.raises(InputError, match=remedy):
        fmu.write(ROBOT, tmp_path / "x.fmu")
    assert not (tmp_path / "x.fmu").exists()


def test_robot_with_four_cables_is_refused(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(minimal_toml(4))
    with pytest.raises(InputError, match="4 cables: allowed: 6 or more, fewer cannot give every wrench"):
        fmu.write(path, tmp_path / "x.fmu")


def test_robot_is_not_replaced_by_its_model(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(minimal_toml(8))
    before = path.read_bytes()
    for run in (path, tmp_path):
        with pytest.raises(InputError, match=r"robot.toml: is what is exported: allowed: another file"):
            convert.export(run, "fmu", path, None, "", [])
    with pytest.raises(InputError, match=r"--robot .*: not wanted with --to fmu"):
        convert.export(path, "fmu", tmp_path / "x.fmu", path, "", [])
    assert path.read_bytes() == before


def test_run_folder_gives_its_robot(tmp_path, model):
    (tmp_path / "robot.toml").write_text(minimal_toml(8))
    [said] = convert.export(tmp_path, "fmu", tmp_path / "x.fmu", None, "", [])
    assert "8 tensions" in said


def test_values_at_the_start_are_those_of_the_description(model, tmp_path):
    from fmpy import extract, instantiate_fmu, read_model_description

    described = read_model_description(str(model))
    instance = instantiate_fmu(extract(str(model), str(tmp_path)), described, fmi_type="CoSimulation")
    for variable in (v for v in described.modelVariables if v.causality == "input"):
        start = [float(x) for x in variable.start.split()]
        assert instance.getFloat64([variable.valueReference], nValues=len(start)) == pytest.approx(start), variable.name
    instance.freeInstance()


def four_cables(folder: Path) -> bytes:
    path = folder / "robot.toml"
    path.write_text(minimal_toml(4))
    return configuration.compile_robot(description.load(path), str(path))


@pytest.mark.parametrize(
    ("config", "message"), [(lambda _: b"nothing", "robot.cfg"), (four_cables, "4 cables: allowed: 6 or more")]
)
def test_model_refuses_a_damaged_or_unusable_robot(model, tmp_path, config, message):
    from fmpy import extract, instantiate_fmu, read_model_description

    folder = Path(extract(str(model), str(tmp_path / "fmu")))
    (folder / "resources/robot.cfg").write_bytes(config(tmp_path))
    said: list[str] = []
    with pytest.raises(Exception, match="nstantiat"):
        instantiate_fmu(
            str(folder),
            read_model_description(str(model)),
            fmi_type="CoSimulation",
            logger=lambda environment, status, category, message: said.append(message.decode()),
        )
    assert said and message in said[0]
    shutil.rmtree(folder)
