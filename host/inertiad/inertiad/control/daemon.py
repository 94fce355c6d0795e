# SPDX-License-Identifier: Apache-2.0
"""The daemon in lock-step: frames, positions and commands go to it through a pipe, estimates and events come back.

Nothing depends on the clock: the same lines give the same answers, bit for bit. Protocol: firmware/io/lock_step.h
"""

import subprocess
from pathlib import Path
from typing import IO, Final

from inertiad.base import installation
from inertiad.base.error import InputError
from inertiad.run import lcmlog
from inertiad.run.lcmlog import Event

PREFIX: Final = "CONTROL_"
"""of the channels"""
ANSWER: Final = f"{PREFIX}ANSWER"


def _read(file: IO[bytes], n: int) -> bytes:
    """n bytes. EOFError: the daemon has ended."""
    data = file.read(n)
    if len(data) < n:
        raise EOFError
    return data


class Daemon:
    """A process of its own; kill() and start() as often as wanted."""

    def __init__(self, config: Path, log: Path) -> None:
        """config: robot.cfg; log: takes what it prints."""
        self._command = [str(installation.daemon()), "--config", str(config), "--lock-step", "--lcm-prefix", PREFIX]
        self._log = log
        self._process: subprocess.Popen[bytes] | None = None
        self.start()

    @property
    def is_running(self) -> bool:
        """Whether it takes lines."""
        return self._process is not None

    def start(self) -> None:
        """Start it; it knows nothing of what the one before has learnt."""
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, bufsize=1 << 16
            )

    def ask(self, lines: list[str]) -> list[Event]:
        """Hand over lines; what was published since the last time. InputError: it has ended."""
        assert self._process is not None and self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write("".join([*lines, "answer\n"]).encode())
            self._process.stdin.flush()
            return self._answer(self._process.stdout)
        except (OSError, EOFError):
            self._process.wait()
            said = self._log.read_text(errors="replace").strip().splitlines()
            raise InputError(f"inertiad ended: {said[-1] if said else 'it said nothing'}") from None

    def _answer(self, file: IO[bytes]) -> list[Event]:
        events: list[Event] = []
        while True:
            _, number, t_us, n_channel, n_data = lcmlog.HEAD.unpack(_read(file, lcmlog.HEAD.size))
            channel, data = _read(file, n_channel).decode(), _read(file, n_data)
            if channel == ANSWER:
                return events
            events.append(Event(number, t_us, channel.removeprefix(PREFIX), data))

    def kill(self) -> None:
        """End it at once, as a crash would."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None
