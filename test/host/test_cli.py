# SPDX-License-Identifier: Apache-2.0
"""The command line in a process of its own: exit codes, one line on stderr, files written."""

import json
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from conftest import COGIRO, TOP, minimal_toml

import inertiad_core
from inertiad.base import body
from inertiad.base.error import InputError

COMMANDS = ["compile", "simulate", "encode", "excite", "watch", "command"]


def one_line_and_2(result):
    assert result.returncode == 2
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert "Traceback" not in result.stderr
    return lines[0]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_an_example(inertiactl, command):
    result = inertiactl(command, "-h")
    assert result.returncode == 0
    assert f"Example: inertiactl {command}" in " ".join(result.stdout.split())


def test_daemon_prints_the_packages_version():
    project = tomllib.loads((TOP / "host/inertiad/pyproject.toml").read_text())["project"]
    done = subprocess.run([TOP / "build/bin/inertiad", "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"inertiad {project['version']}\n")


def test_help_lists_the_commands(inertiactl):
    result = inertiactl("-h")
    assert all(command in result.stdout for command in COMMANDS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["compil"], "No such command 'compil'"),
        (["compile", COGIRO / "robot.toml"], "Missing option '-o' / '--output'"),
        (["compile", "nowhere.toml", "-o", "x.cfg"], "nowhere.toml: No such file or directory"),
        (["compile", COGIRO / "robot.toml", "-o", "/nowhere/x.cfg"], "/nowhere/x.cfg: No such file or directory"),
        (["simulate", COGIRO / "robot.toml", "--faults", "few", "-o", "x"], '--faults "few": allowed: ideal, modern'),
        (["simulate", COGIRO / "robot.toml", "--rate", "fast", "-o", "x"], "--rate"),
        (
            ["simulate", COGIRO / "robot.toml", "--mass", "-1", "-o", "x"],
            "--mass: mass = -1.0: allowed: 1e-06 to 1e+07 kg",
        ),
        (["encode", COGIRO / "robot.toml", "nowhere.csv", "-o", "x"], "nowhere.csv: No such file or directory"),
        (["watch", "--lcm", "nonsense://"], "--lcm nonsense://: cannot open"),
    ],
)
def test_user_errors_are_one_line_and_exit_2(inertiactl, arguments, message):
    assert message in one_line_and_2(inertiactl(*arguments))


def test_compile_writes_what_the_core_reads(inertiactl, tmp_path):
    result = inertiactl("compile", COGIRO / "robot.toml", "-o", tmp_path / "robot.cfg")
    assert result.returncode == 0, result.stderr
    assert inertiad_core.Config((tmp_path / "robot.cfg").read_bytes()).n_cables == 8


def test_an_estimate_without_sigma_is_read(tmp_path):
    file = tmp_path / "two_steps.json"
    none = {"mass": None, "cog": [None] * 3, "inertia_cog": [None] * 6}
    value = {"mass": 2.0, "cog": [0.1, 0.2, 0.3], "inertia_cog": [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]}
    file.write_text(json.dumps({key: {"value": value[key], "std": none[key]} for key in value}))
    found = body.read(file)
    assert found.value[:2] == (2.0, 0.1)
    assert np.isnan(found.std).all()


@pytest.mark.slow
def test_simulate_then_compile_the_run(inertiactl, tmp_path):
    run = tmp_path / "run"
    arguments = ["--trajectory", "hold", "--duration", "0.5", "--faults", "modern", "--seed", "7", "-o", run]
    result = inertiactl("simulate", COGIRO / "robot.toml", *arguments)
    assert result.returncode == 0, result.stderr
    assert json.loads((run / "truth.json").read_text())["seed"] == 7
    assert inertiactl("compile", run / "robot.toml", "-o", run / "robot.cfg").returncode == 0


@pytest.mark.slow
def test_encode_then_compile_the_run(inertiactl, tmp_path):
    robot, signals, tracker, run = (tmp_path / n for n in ("robot.toml", "signals.csv", "tracker.csv", "run"))
    robot.write_text(minimal_toml(4))
    t = np.arange(100) / 100.0
    data = np.column_stack([t, *[np.zeros(100)] * 2, np.full(100, 9.81), *[np.zeros(100)] * 3, np.ones(100)])
    data = np.column_stack([data, np.zeros((100, 3)), np.full((100, 4), 50.0)])
    header = "t,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z,q_w,q_x,q_y,q_z,f_1,f_2,f_3,f_4"
    np.savetxt(signals, data, delimiter=",", header=header, comments="")
    np.savetxt(tracker, np.column_stack([t, np.zeros((100, 3))]), delimiter=",", header="t,x,y,z", comments="")
    result = inertiactl("encode", robot, signals, "--tracker", tracker, "-o", run)
    assert result.returncode == 0, result.stderr
    assert len((run / "can.log").read_text().splitlines()) == 200
    assert inertiactl("compile", run / "robot.toml", "-o", run / "robot.cfg").returncode == 0


def test_python_file_has_a_licence_line():
    for path in [*(TOP / "host/inertiad/inertiad").rglob("*.py"), *(TOP / "test/host").glob("*.py")]:
        assert path.read_text().startswith("# SPDX-License-Identifier: Apache-2.0\n"), path


# ---- estimate ------------------------------------------------------------------------------------------------------


ESTIMATE = {
    "method": "rls",
    "mass": {"value": 10.0, "std": 0.1},
    "cog": {"value": [1, 2, 3], "std": [0.1, 0.2, 0.3]},
    "inertia_cog": {"value": [1, 2, 3, 4, 5, 6], "std": [0, 0, 0, 0, 0, 0]},
}
TRUTH = {"mass": 9.0, "cog": [1, 2, 2], "inertia_cog": [1, 2, 3, 4, 5, 7], "seed": 1}


def test_estimate_minus_truth(tmp_path):
    (tmp_path / "estimate.json").write_text(json.dumps(ESTIMATE))
    (tmp_path / "truth.json").write_text(json.dumps(TRUTH))
    found, truth = body.read(tmp_path / "estimate.json"), body.read_truth(tmp_path / "truth.json")
    assert body.errors(found, truth) == (1.0, 0, 0, 1.0, 0, 0, 0, 0, 0, -1.0)
    assert found.std[:3] == (0.1, 0.1, 0.2)


@pytest.mark.parametrize(
    "data",
    [
        "{",
        "[]",
        "{}",
        json.dumps(ESTIMATE | {"mass": None}),
        json.dumps(ESTIMATE | {"cog": {"value": [1], "std": [1]}}),
    ],
)
def test_unusable_estimate_is_one_line(tmp_path, data):
    (tmp_path / "estimate.json").write_text(data)
    with pytest.raises(InputError, match=r"^[^\n]+estimate.json: [^\n]+$"):
        body.read(tmp_path / "estimate.json")


# ---- help texts, stdout ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "text"),
    [
        ("compile", "Leave [nominal] out"),
        ("encode", "CSV: t,x,y,z [m]."),
        ("calibrate", 'In robot.toml: [calibration] file = "calibration.toml"'),
        ("sync", 'In robot.toml: [calibration] sync = "sync.json"'),
        ("paper", "Robot with a [nominal] body"),
    ],
)
def test_help_keeps_what_stands_in_brackets(inertiactl, command, text):
    plain = " ".join(word for word in inertiactl(command, "-h").stdout.replace("│", " ").split())
    assert text in plain
    assert "\\[" not in plain


def test_configuration_on_stdout_is_the_file(tmp_path):
    command = [sys.executable, "-m", "inertiad", "compile", str(COGIRO / "robot.toml"), "-o"]
    subprocess.run([*command, str(tmp_path / "robot.cfg")], check=True, cwd=TOP, capture_output=True)
    done = subprocess.run([*command, "-"], check=True, cwd=TOP, capture_output=True)
    assert done.stdout == (tmp_path / "robot.cfg").read_bytes()
    assert done.stderr == b""


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", COGIRO / "robot.toml", "-o", "-"),
        ("encode", COGIRO / "robot.toml", "signals.csv", "-o", "-"),
        ("import", "log.csv", "-o", "-"),
        ("record", "--from", "udp:5999", "-o", "-"),
        ("report", "run", "--figures", "-"),
    ],
)
def test_a_folder_does_not_go_to_stdout(inertiactl, words):
    assert "-: allowed: a folder" in one_line_and_2(inertiactl(*words))


def test_two_outputs_do_not_share_stdout(inertiactl):
    result = inertiactl("compile", COGIRO / "robot.toml", "-o", "-", "--json", "-")
    assert "stdout takes one output" in one_line_and_2(result)


def test_recording_ends_with_its_counts_as_json(inertiactl, tmp_path):
    source = tmp_path / "positions.txt"
    source.write_text("1.0,0.1,0.2,0.3\n1.1,0.1,0.2,0.4\nnonsense\n")
    lines = ["--from", f"file:{source}", "--seconds", "1", "--lcm", f"file://{tmp_path}/lcm.log?mode=w"]
    done = inertiactl("record", *lines, "--json", "-", "-o", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["n_samples"], found["n_bad"], found["error"]) == (2, 1, None)
    assert "samples: 2 received" in done.stderr
