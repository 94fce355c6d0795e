# SPDX-License-Identifier: Apache-2.0
"""The power fails at any call that writes: estimate and checkpoint are whole, old or new; records end with a message.

power_loss.c ends the daemon at its n-th call and says what a disk may hold then: with or without what was not synced,
names and contents each for themselves.
"""

import itertools
import json
import os
import shutil
import subprocess
import zlib
from dataclasses import dataclass
from pathlib import Path

import pytest
from conftest import COGIRO, TOP

from inertiad.robot import configuration, description
from inertiad.run import lcmlog

pytestmark = pytest.mark.slow

STATUS = 77
KINDS = list(itertools.product(("synced", "kept"), ("synced", "last")))
"""names and contents: those that were synced, or the last ones"""


@dataclass
class Disk:
    """Files as a power failure leaves them."""

    folder: Path
    model: Path

    def names(self, which: str) -> dict[str, int]:
        lines = [line.split() for line in (self.model / "names").read_text().splitlines()]
        return {name: int(key) for kind, name, key in lines if kind == which}

    def content(self, key: int, which: str) -> bytes:
        """Of file key; one that was never synced is empty."""
        if which == "last":
            names = {number: name for name, number in self.names("kept").items()}
            return (self.folder / names[key] if key in names else self.model / f"{key}.last").read_bytes()
        path = self.model / f"{key}.synced"
        return path.read_bytes() if path.exists() else b""

    def files(self, names: str, content: str) -> dict[str, bytes]:
        return {name: self.content(key, content) for name, key in self.names(names).items()}

    def calls(self) -> int:
        return int((self.model / "calls").read_text())


RESULTS = ("--estimate", "--checkpoint")
RECORD = ("--record",)
ROTATED = ("--record?rotate_s=3",)
FILES = {"--estimate": "e.json", "--checkpoint": "state", "--record": "r.lcmlog", ROTATED[0]: "r.lcmlog"}


def daemon(run: Path, folder: Path, log: str, outputs: tuple[str, ...]) -> list[str]:
    inputs = ["--config", run / "robot.cfg", "--bus", f"file:{run}/{log}", "--tracker", f"file:{run}/tracker.csv"]
    command = [TOP / "build/bin/inertiad", *inputs, "--lcm", "none"]
    for output in outputs:
        option, mark, query = output.partition("?")
        command += [option, f"{folder / FILES[output]}{mark}{query}"]
    return [str(a) for a in command]


@pytest.fixture(scope="module")
def shim(tmp_path_factory) -> Path:
    library = tmp_path_factory.mktemp("power_loss") / "power_loss.so"
    source = TOP / "test/host/power_loss.c"
    flags = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", library, source], check=True)
    return library


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A run of 8 s; half.log is its first half, and old/ what the daemon made of that."""
    folder = tmp_path_factory.mktemp("run")
    command = [TOP / "build/bin/inertiactl", "simulate", COGIRO / "robot.toml", "-o", folder, "--seed", "5"]
    options = ["--faults", "modern", "--duration", "8", "--rate", "100"]
    subprocess.run([*map(str, command), *options], check=True, capture_output=True)
    configuration.write(folder / "robot.cfg", description.load(folder / "robot.toml"), "robot.toml")
    lines = (folder / "can.log").read_text().splitlines(keepends=True)
    (folder / "half.log").write_text("".join(lines[: len(lines) // 2]))
    (folder / "old").mkdir()
    for outputs in (RESULTS, RECORD):
        subprocess.run(daemon(folder, folder / "old", "half.log", outputs), check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def old(run) -> dict[str, bytes]:
    return {name: (run / "old" / name).read_bytes() for name in FILES.values()}


def lose_power(shim: Path, run: Path, to: Path, outputs: tuple[str, ...], at: int, is_half: bool = False) -> Disk:
    """The daemon goes on from old/ and ends at its at-th call; 0: at its end."""
    disk = Disk(to / "files", to / "disk")
    disk.folder.mkdir(parents=True)
    disk.model.mkdir()
    for option in outputs:
        shutil.copy(run / "old" / FILES[option], disk.folder)
    more = {"POWER_LOSS_HALF": "1"} if is_half else {}
    where = {"POWER_LOSS_FOLDER": str(disk.folder), "POWER_LOSS_DISK": str(disk.model), "POWER_LOSS_AT": str(at)}
    environment = {**os.environ, "LD_PRELOAD": str(shim), **where, **more}
    command = daemon(run, disk.folder, "can.log", outputs)
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == (STATUS if disk.calls() == at else 0), done.stderr
    return disk


def check_results(files: dict[str, bytes], old: dict[str, bytes]) -> None:
    windows = [json.loads(text)["samples"]["windows"] for text in (old["e.json"], files["e.json"])]
    assert files["e.json"] == old["e.json"] or windows[1] > windows[0]
    state = files["state"]
    assert state[:8] == b"ipe-chk\0" and zlib.crc32(state[:-4]) == int.from_bytes(state[-4:], "little")


def check_record(files: dict[str, bytes], old: dict[str, bytes], path: Path) -> int:
    """The old record is there; the messages of the new ones are the first that the daemon made: their number."""
    assert old["r.lcmlog"] in files.values(), "the old record is gone"
    moved = sorted((name for name in files if name.startswith("r.lcmlog.")), key=lambda name: int(name.split(".")[-1]))
    numbers: list[int] = []
    for name in [*moved, "r.lcmlog"]:
        if files.get(name, old["r.lcmlog"]) == old["r.lcmlog"]:
            continue
        remarks: list[str] = []
        path.write_bytes(files[name])
        events = list(lcmlog.read(path, remarks))
        assert not any("damaged" in remark for remark in remarks), remarks
        assert [e.channel for e in events[:1]] in ([], ["INERTIAD_CONFIG"])
        numbers += [e.number for e in events[1:]]
    assert numbers == list(range(1, len(numbers) + 1))
    return len(numbers)


def check_nothing_synced_is_lost(disk: Disk, names: str) -> None:
    """A file of which something was synced has a name."""
    is_synced = {key for key in disk.names("kept").values() if disk.content(key, "synced")}
    assert is_synced <= set(disk.names(names).values()), "content was synced, the name of its file was not"


def restart(run: Path, to: Path, outputs: tuple[str, ...], files: dict[str, bytes]) -> None:
    """The daemon goes on from these files."""
    to.mkdir()
    for name, content in files.items():
        (to / name).write_bytes(content)
    done = subprocess.run(daemon(run, to, "can.log", outputs), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert ("continuing from" in done.stderr) == ("--checkpoint" in outputs)
    assert all((to / FILES[option]).stat().st_size > 0 for option in outputs)


@pytest.mark.parametrize("outputs", [RESULTS, RECORD, ROTATED])
def test_everything_is_on_the_disk_when_the_daemon_has_ended(shim, run, old, tmp_path, outputs):
    disk = lose_power(shim, run, tmp_path, outputs, 0)
    for names, content in KINDS:
        files = disk.files(names, content)
        for option in outputs:
            name = FILES[option]
            assert files[name] == (disk.folder / name).read_bytes() != old[name], (names, content, name)
        if outputs != RESULTS:
            assert check_record(files, old, tmp_path / "record") > 1000


@pytest.mark.parametrize(("outputs", "each"), [(RESULTS, 1), (RECORD, 5), (ROTATED, 9)])
def test_power_fails_at_any_call(shim, run, old, tmp_path, outputs, each):
    """each: of so many calls one is tried. Before every other of these, and in the middle of the rest."""
    n_old = n_new = n_restarts = 0
    for at in itertools.count(1, each):
        disk = lose_power(shim, run, tmp_path / str(at), outputs, at, is_half=at // each % 2 == 0)
        if disk.calls() < at:
            break
        for i, (names, content) in enumerate(KINDS):
            files = disk.files(names, content)
            if outputs == RESULTS:
                check_results(files, old)
                is_old = files["e.json"] == old["e.json"]
            else:
                check_nothing_synced_is_lost(disk, names)
                is_old = check_record(files, old, tmp_path / "record") == 0
            n_old += is_old
            n_new += not is_old
            if (at // each + i) % 7 == 0:
                restart(run, tmp_path / f"restart{n_restarts}", outputs, files)
                n_restarts += 1
        shutil.rmtree(tmp_path / str(at))
    assert n_old > 5 and n_new > 2 and n_restarts > 2, (at, n_old, n_new, n_restarts)
