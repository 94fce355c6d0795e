# SPDX-License-Identifier: Apache-2.0
"""The daemon behind a serial CAN adapter: Linux's slcan driver on a pseudo-terminal.

The other end speaks the adapter's side of the protocol (Lawicel, CAN232 manual; states and errors as in the driver).
It reports any state, so here a driver goes through those that the emulated SJA1000 never reach, bus-off included. This
driver has no restart: after bus-off the interface is set down and up.
"""

import os
import select
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from daemon import CLASSICAL, PATIENCE, daemon, run

from inertiad_lcm import bus_t

BUS = "slcan0"
SAMPLE = "(0) can0 010#000000000000"  # of the run's robot
INTERFACE = Path(f"/sys/class/net/{BUS}")


class Adapter:
    """The far end of a serial line: collects the commands that come, sends frames and states."""

    def __init__(self) -> None:
        self.line, far = os.openpty()
        os.set_blocking(self.line, False)
        self.commands = b""
        self.is_plugged = True
        self.attached = subprocess.Popen(["slcand", "-F", "-o", "-c", "-s8", os.ttyname(far), BUS])
        self.listener = threading.Thread(target=self._listen, daemon=True)
        self.listener.start()
        wait(INTERFACE.exists, "slcand made no interface")
        os.close(far)  # slcand has it open
        run("ip", "link", "set", BUS, "up")

    def _listen(self) -> None:
        while self.is_plugged:
            if select.select([self.line], [], [], 0.1)[0]:
                self.commands += os.read(self.line, 4096)

    def says(self, *lines: str) -> None:
        text = "".join(f"{line}\r" for line in lines).encode()
        while text:
            try:
                text = text[os.write(self.line, text) :]
            except BlockingIOError:  # the line is full; slcan empties it, but wakes nobody who waits for that
                time.sleep(0.01)

    def unplug(self) -> None:
        self.is_plugged = False
        self.listener.join()
        os.close(self.line)
        wait(lambda: not INTERFACE.exists(), "the interface stays without its adapter")
        self.attached.terminate()
        self.attached.wait(PATIENCE)


def wait(condition: Callable[[], bool], problem: str) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, problem
        time.sleep(0.1)


@contextmanager
def adapter() -> Iterator[Adapter]:
    run("modprobe", "slcan")
    plugged = Adapter()
    try:
        yield plugged
    finally:
        plugged.unplug()


def as_slcan(line: str) -> str:
    """A candump log's line in the adapter's words."""
    can_id, data = line.split()[2].split("#")
    return f"t{can_id}{len(data) // 2}{data}"


def test_run_of_a_serial_adapter_is_all_decoded():
    lines = (CLASSICAL / "run/can.log").read_text().splitlines()[:5000]
    with adapter() as a, daemon(bus=f"socketcan:{BUS}") as d:
        assert a.commands.split(b"\r")[:3] == [b"C", b"S8", b"O"]
        a.says(*map(as_slcan, lines))
        d.wait(lambda c: c["bus0.frames"] + c["bus0.dropped_by_kernel"] >= len(lines))
        summary = d.stop()
        run("cansend", BUS, "123#00FF")
        wait(lambda: a.commands.endswith(b"t123200FF\r"), "what is sent does not reach the adapter")
    assert summary["decode.decoded"] == len(lines)
    assert summary["bus0.dropped_by_kernel"] == 0


def test_states_down_to_bus_off_and_an_overrun_are_counted_and_frames_come_again():
    with adapter() as a, daemon(bus=f"socketcan:{BUS}") as d:
        # when: warning, passive, an overrun of the adapter, bus-off
        a.says("sw097000", "sp130000", "e3oss", "sb000256")
        d.wait(lambda c: c["bus0.bus_off"] == 1)
        d.wait(lambda _: d.condition == bus_t.OFF)
        assert "state BUS-OFF" in run("ip", "-d", "link", "show", BUS)
        # then: set down and up, the adapter is active and so is the bus
        run("ip", "link", "set", BUS, "down")
        d.wait(lambda c: c["bus0.went_down"] == 1)
        run("ip", "link", "set", BUS, "up")
        d.wait(lambda _: d.condition == bus_t.ACTIVE)
        a.says(as_slcan(SAMPLE))
        d.wait(lambda c: c["decode.decoded"] == 1)
        summary = d.stop()
    names = ("error_warning", "error_passive", "bus_off", "controller_overruns")
    assert [summary[f"bus0.{name}"] for name in names] == [1, 1, 1, 1]


def test_serial_adapter_unplugged_and_back_is_taken_up_again():
    run("modprobe", "slcan")
    first = Adapter()
    with daemon(bus=f"socketcan:{BUS}") as d:
        first.unplug()
        d.wait(lambda c: c["bus0.went_down"] == 1)
        with adapter() as a:
            end = time.monotonic() + PATIENCE
            while d.counters["decode.decoded"] == 0 and time.monotonic() < end:
                a.says(as_slcan(SAMPLE))
                d.lcm.handle_timeout(1000)
            assert d.stop()["decode.decoded"] > 0
