# SPDX-License-Identifier: Apache-2.0
"""Send a command to a running daemon, and wait for its answer."""

import secrets
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from inertiad.base.error import InputError
from inertiad.live import incoming, lcm_network
from inertiad.model import expectation
from inertiad_lcm import command_t, event_t

KINDS = {
    "freeze": command_t.FREEZE,
    "resume": command_t.RESUME,
    "reset": command_t.RESET,
    "tare": command_t.TARE,
    "configure": command_t.CONFIGURE,
    "mark": command_t.MARK,
    "expect": command_t.EXPECT,
}
ANSWER_MAX: Final = 1000
"""characters of an answer; the daemon's have at most 512"""


@dataclass(frozen=True)
class Answer:
    """The daemon's answer."""

    is_done: bool
    text: str


def make(name: str, argument: str | None, std: str | None = None) -> command_t:
    """The message of a command; std: KG,M,KGM2 of an expected payload.

    InputError: no such command, or its argument is missing, too long or not wanted.
    """
    if name not in KINDS:
        raise InputError(f'command "{name}": allowed: {", ".join(KINDS)}')
    wanted = {"configure": "FILE", "mark": "TEXT", "expect": "PAYLOAD"}.get(name)
    if wanted is not None and not argument:
        raise InputError(f"command {name}: {wanted} is missing")
    if wanted is None and argument is not None:
        raise InputError(f'command {name}: "{argument}" is not wanted')
    message = command_t()
    message.kind, message.text = KINDS[name], ""
    message.sender, message.sequence = secrets.randbits(62), secrets.randbits(62)  # nobody can guess the answer's
    if name == "mark" and argument is not None:
        message.text = argument
        if len(argument.encode()) > command_t.TEXT_MAX or not argument.isprintable():
            raise InputError(f"command mark: allowed: one line of at most {command_t.TEXT_MAX} bytes")
    if std is not None and name != "expect":
        raise InputError(f"command {name}: --std is not wanted")
    if name == "expect" and argument is not None:
        message.config = expectation.parse(argument, time.time_ns(), std).encode()
        message.n_config = len(message.config)
    if name == "configure" and argument is not None:
        message.config = Path(argument).read_bytes()
        if len(message.config) > command_t.CONFIG_MAX:
            limit = command_t.CONFIG_MAX
            raise InputError(f"{argument}: allowed: a compiled configuration, at most {limit} bytes")
        message.n_config = len(message.config)
    return message


def send(message: command_t, url: str, prefix: str, patience: float) -> Answer | None:
    """Send a command, wait so many seconds for its answer; None: nobody answered. InputError: see network.connect()."""
    answers: list[Answer] = []
    decoder = incoming.Decoder()

    def on_event(_channel: str, data: bytes) -> None:
        event = decoder.decode(event_t, data)
        if event is None or event.kind not in (event_t.DONE, event_t.REFUSED):
            return
        if (event.sender, event.command) == (message.sender, message.sequence):
            answers.append(Answer(event.kind == event_t.DONE, incoming.plain(event.text, ANSWER_MAX)))

    bus = lcm_network.connect(url)
    bus.subscribe(f"{prefix}EVENT", on_event)
    message.t_ns = time.time_ns()
    bus.publish(f"{prefix}COMMAND", message.encode())
    end = time.monotonic() + patience
    while not answers and time.monotonic() < end:
        lcm_network.handle(bus, 50)
    return answers[0] if answers else None
