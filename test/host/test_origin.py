# SPDX-License-Identifier: Apache-2.0
"""Who may command the daemon and send it positions: this host, once; a neighbour and a replayed log change nothing."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import COGIRO, ISOLATED, TOP

from inertiad.robot import configuration, description

pytestmark = pytest.mark.slow

DAEMON = TOP / "build/bin/inertiad"

# Runs in a network of its own: the daemon on a bus on which nothing comes, and senders that a kernel would let through.
SESSION = """
import json, socket, struct, subprocess, sys, time
from inertiad.base import channels
from inertiad.live import command, lcm_network
from inertiad_lcm import command_t, event_t, health_t, tracker_t

FOREIGN = "10.9.9.9"
daemon_line, script = json.loads(sys.argv[1]), sys.argv[2]
counters, events, answers = {}, [], []


def on_health(_, data):
    counters.update({c.name: c.value for c in health_t.decode(data).counter})


def on_event(_, data):
    event = event_t.decode(data)
    (events if event.kind == event_t.NEWS else answers).append(event.text)


def datagram(channel, message):
    return b"LC02" + bytes(4) + channel.encode() + b"\\0" + message.encode()


def forged(payload, source=FOREIGN):
    "A datagram of another host, as its network card would bring it."
    udp = struct.pack(">HHHH", 4000, channels.PORT, 8 + len(payload), 0) + payload
    ends = socket.inet_aton(source) + socket.inet_aton(channels.GROUP)
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), 1, 0, 1, 17, 0)
    raw = socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_RAW)
    raw.sendto(head + ends + udp, (channels.GROUP, 0))


def local():
    return lcm_network.udp_socket(channels.DEFAULT_URL)


def order(kind=command_t.RESET, age=0.0, sequence=0, sender=7):
    message = command_t()
    message.kind, message.sender, message.sequence, message.text = kind, sender, sequence, ""
    message.t_ns = time.time_ns() - round(1e9 * age)
    return datagram("INERTIAD_COMMAND", message)


def place(t=1.0):
    message = tracker_t()
    message.t_ns, message.valid, message.position = round(1e9 * t), True, [0.1, 0.2, 0.3]
    return datagram("INERTIAD_TRACKER", message)


def listen(seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        bus.handle_timeout(20)


def listen_for(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        bus.handle_timeout(20)


bus = lcm_network.connect(channels.DEFAULT_URL)
bus.subscribe("INERTIAD_HEALTH", on_health)
bus.subscribe("INERTIAD_EVENT", on_event)
before_start = order(sequence=99)
with subprocess.Popen(daemon_line, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as daemon:
    listen_for(lambda: counters)
    exec(script)
    listen(1.2)
    daemon.terminate()
    stderr = daemon.communicate(timeout=20)[1]
rows = [line.removeprefix("inertiad: ").split() for line in stderr.splitlines()]
counters = {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}
print(json.dumps(dict(counters=counters, events=events, answers=answers, stderr=stderr)))
"""


@pytest.fixture(scope="module")
def config(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("robot") / "robot.cfg"
    configuration.write(path, description.load(COGIRO / "robot.toml"), "robot.toml")
    return path


def session(config: Path, script: str, *options: str) -> dict:
    daemon = [str(DAEMON), "-v", "--config", str(config), "--bus", "file:-", *options]
    command = [*ISOLATED, sys.executable, "-c", SESSION, json.dumps(daemon), script]
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, cwd=TOP)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_neighbour_can_neither_command_nor_send_positions(config):
    end = session(config, "forged(order()); forged(place()); local().send(order(sender=8)); local().send(place())")
    n = end["counters"]
    assert (n["lcm.commands_foreign"], n["lcm.tracker_foreign"]) == (1, 1)
    assert (n["lcm.commands"], n["lcm.tracker_positions"], n["command.done"]) == (1, 1, 1)
    assert any("COMMAND from 10.9.9.9:4000 is refused" in text for text in end["events"])
    assert any("TRACKER from 10.9.9.9:4000" in text for text in end["events"])


def test_the_network_is_let_in_where_that_is_asked_for(config):
    script = "forged(order()); forged(place())"
    n = session(config, script, "--commands", "network", "--tracker", "lcm:network")["counters"]
    assert (n["lcm.commands"], n["command.done"], n["lcm.tracker_positions"]) == (1, 1, 1)
    n = session(config, "local().send(order())", "--commands", "off")["counters"]
    assert (n["lcm.commands"], n["lcm.commands_foreign"]) == (0, 1)


def test_a_replayed_log_changes_nothing(config):
    """The datagrams of an hour ago, and those of this moment once more."""
    script = "link = local(); link.send(order(age=3600)); fresh = order(); link.send(fresh); link.send(fresh)"
    end = session(config, script)
    n = end["counters"]
    assert (n["command.done"], n["command.refused"], n["command.old"], n["command.repeated"]) == (1, 2, 1, 1)
    assert len(end["answers"]) == 2 and "reset refused: sent more than 10 s ago" in end["answers"][0]
    assert end["answers"][1].startswith("reset done")


def test_a_command_from_before_the_start_is_refused(config):
    """A log of the last seconds, played again beside a daemon that has just been restarted."""
    end = session(config, "link = local(); link.send(before_start); link.send(order())")
    n = end["counters"]
    assert (n["command.done"], n["command.refused"], n["command.old"]) == (1, 1, 1)
    # on a machine that takes more than 10 s for the start it is too old besides
    assert re.match(r"reset refused: sent (before the daemon began to listen|more than 10 s ago)", end["answers"][0])
    assert end["answers"][1].startswith("reset done")


def test_positions_come_from_one_publisher(config):
    script = """
first, second = local(), local()
for k in range(30):
    first.send(place(1 + 0.1 * k)), second.send(place(1 + 0.1 * k))
    listen(0.1)
for k in range(30):
    second.send(place(4 + 0.1 * k))
    listen(0.1)
"""
    end = session(config, script)
    n = end["counters"]
    assert n["lcm.tracker_other_publisher"] >= 30 and n["lcm.tracker_positions"] >= 45  # silent for 1 s: 10 of them
    assert n["lcm.tracker_positions"] + n["lcm.tracker_other_publisher"] == 90
    assert any("a second publisher of TRACKER, " in text for text in end["events"])


def test_positions_of_file_and_network_never_mix(config, tmp_path):
    rows = "".join(f"{1 + k},0,0,0\n" for k in range(3))
    (tmp_path / "tracker.csv").write_text("t,x,y,z\n" + rows)
    end = session(config, "local().send(place())", "--tracker", f"file:{tmp_path}/tracker.csv")
    assert end["counters"]["lcm.tracker_unused"] == 1
    assert end["counters"]["align.position.samples"] == end["counters"]["tracker.positions"]


def test_a_mark_with_control_characters_is_refused(config):
    script = r"""
for text in ("a\x1b[2Jb", "a\nb", "\x9b31m", "a\u2028b", "Prüfung \u20ac"):
    message = command.make("freeze", None)
    message.kind, message.text, message.t_ns = command_t.MARK, text, time.time_ns()
    local().send(datagram("INERTIAD_COMMAND", message))
"""
    end = session(config, script)
    refused = 4 * ["mark refused: the text of a mark must be one line of UTF-8"]
    assert end["answers"] == [*refused, "mark done: Prüfung \u20ac"]


def test_a_command_that_is_not_one_of_three_is_refused():
    command = [DAEMON, "--config", "robot.cfg", "--bus", "file:-", "--commands", "everybody"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and "--commands: must be off, local or network" in done.stderr
