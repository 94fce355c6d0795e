# SPDX-License-Identifier: Apache-2.0
"""python session.py DAEMON ARGUMENTS... -- STEP...: run the daemon, send it commands, print what it publishes as JSON.

To be run in a network of its own. A step is a number of seconds to wait, or a command, with its argument after "=".
Every answer is one line {"answer": text, "done"}, every event one {"event": text, "kind", "source"}; the last line has
the daemon's exit status, its counters and its stderr.
"""

import json
import signal
import subprocess
import sys
import threading
import time

from inertiad.base import channels
from inertiad.live import command, lcm_network
from inertiad_lcm import event_t, health_t

PATIENCE = 20.0


class Listener(threading.Thread):
    """Collects events and the last HEALTH."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.events: list[event_t] = []
        self.health: health_t | None = None
        self.is_over = False
        self.bus = lcm_network.connect(channels.DEFAULT_URL)
        self.bus.subscribe("INERTIAD_EVENT", lambda _, data: self.events.append(event_t.decode(data)))
        self.bus.subscribe("INERTIAD_HEALTH", self.on_health)

    def on_health(self, _channel: str, data: bytes) -> None:
        self.health = health_t.decode(data)

    def run(self) -> None:
        while not self.is_over:
            self.bus.handle_timeout(50)


def say(**what: object) -> None:
    print(json.dumps(what), flush=True)


def take(step: str) -> None:
    """Wait or command."""
    if step.replace(".", "").isdigit():
        time.sleep(float(step))
        return
    name, _, argument = step.partition("=")
    answer = command.send(command.make(name, argument or None), channels.DEFAULT_URL, channels.DEFAULT_PREFIX, PATIENCE)
    say(answer=answer and answer.text, done=answer and answer.is_done)


def main() -> None:
    split = sys.argv.index("--")
    listener = Listener()
    listener.start()
    with subprocess.Popen(sys.argv[1:split], stderr=subprocess.PIPE, text=True) as daemon:
        end = time.monotonic() + PATIENCE
        while listener.health is None and daemon.poll() is None and time.monotonic() < end:
            time.sleep(0.02)
        for step in sys.argv[split + 1 :]:
            take(step)
        daemon.send_signal(signal.SIGTERM)
        stderr = daemon.communicate(timeout=PATIENCE)[1]
    time.sleep(0.2)
    listener.is_over = True
    listener.join()
    for event in listener.events:
        say(event=event.text, kind=event.kind, source=event.source)
    rows = [line.removeprefix("inertiad: ").split() for line in stderr.splitlines()]
    counters = {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}
    say(status=daemon.returncode, counters=counters, stderr=stderr)


if __name__ == "__main__":
    main()
