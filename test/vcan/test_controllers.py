# SPDX-License-Identifier: Apache-2.0
"""The daemon on the driver of a CAN controller: two emulated SJA1000 on one bus under Linux's kvaser_pci and sja1000.

tools/vcan --guest provides can0 and can1, both down. The files of firmware/packaging bring them up, through udev and
systemd-networkd. What the emulation lacks is asserted by the last test and listed in firmware/DESIGN.md: bit timing,
acknowledgement, error counters, so no warning, no error-passive, no bus-off.
"""

import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from daemon import CLASSICAL, PATIENCE, TOP, daemon, run

PACKAGING = TOP / "firmware/packaging"
NETWORKD = Path("/lib/systemd/systemd-networkd")
DRIVER = Path("/sys/bus/pci/drivers/kvaser_pci")
BUSES = ("can0", "can1")
PROCESSOR = 0  # takes the controllers' interrupts and sends: a machine that stalls then loses nothing
FIFO = 64  # bytes of the SJA1000's receive buffer (data sheet, 6.2.9)
FRAME = 11  # of them for a frame of 8 bytes with a standard identifier
SAMPLE = "010#000000000000"  # of the run's robot
INTERRUPT_DISABLE = 1 << 10  # of a PCI device's command register, offset 4
PCI_COMMAND = 4


def facts(bus: str) -> dict[str, Any]:
    """Link of an interface as ip tells it; what the driver knows is in its linkinfo.info_data."""
    return json.loads(run("ip", "-d", "-j", "-s", "link", "show", bus))[0]


def of_driver(bus: str) -> dict[str, Any]:
    return facts(bus)["linkinfo"]["info_data"]


def is_up(bus: str) -> bool:
    return Path(f"/sys/class/net/{bus}/flags").exists() and facts(bus)["operstate"] == "UP"


def wait_until_up() -> None:
    end = time.monotonic() + PATIENCE
    while not all(map(is_up, BUSES)):
        assert time.monotonic() < end, "networkd does not bring the interfaces up"
        time.sleep(0.2)
    take_interrupts()


def take_interrupts() -> None:
    for bus in BUSES:
        irq = Path(f"/sys/class/net/{bus}/device/irq").read_text().strip()
        Path(f"/proc/irq/{irq}/smp_affinity").write_text(f"{1 << PROCESSOR:x}")


def send(*command: object) -> None:
    """Run a command of can-utils where the interrupts are."""
    run("taskset", "-c", PROCESSOR, *command)


@pytest.fixture(scope="module", autouse=True)
def network(tmp_path_factory) -> Iterator[None]:
    """Both interfaces up, by the shipped files."""
    rules, networks = Path("/etc/udev/rules.d"), Path("/etc/systemd/network")
    for folder, name in ((rules, "70-inertiad-can.rules"), (networks, "80-can.network")):
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(PACKAGING / name, folder)
    run("udevadm", "control", "--reload")
    run("udevadm", "trigger", "--action=add", "--settle", *(f"/sys/class/net/{bus}" for bus in BUSES))
    log = tmp_path_factory.mktemp("networkd") / "log"
    with log.open("w") as file:
        networkd = subprocess.Popen([NETWORKD], stderr=file)
    try:
        wait_until_up()
        yield
    finally:
        networkd.terminate()
        networkd.wait(PATIENCE)
        print(log.read_text())
        (networks / "80-can.network").unlink()


@pytest.fixture
def restored() -> Iterator[None]:
    """Both as the shipped files set them, after a test that sets them otherwise."""
    yield
    for bus in BUSES:
        run("ip", "link", "set", bus, "down")
        run("ip", "link", "set", bus, "type", "can", "bitrate", 1000000, "restart-ms", 100, "listen-only", "off")
        run("ip", "link", "set", bus, "up")


def test_bit_rate_restart_and_queue_are_those_of_the_shipped_files():
    for bus in BUSES:
        link = facts(bus)
        driver = link["linkinfo"]["info_data"]
        assert (driver["bittiming"]["bitrate"], driver["restart_ms"]) == (1000000, 100)
        assert driver["state"] == "ERROR-ACTIVE"
        assert link["txqlen"] == 1000


def test_run_sent_through_one_controller_is_acquired_through_the_other(tmp_path: Path):
    # given: a run's frames, and candump beside the daemon
    log = tmp_path / "can.log"
    lines = (CLASSICAL / "run/can.log").read_text().splitlines()[:7000]
    log.write_text("\n".join(lines) + "\n")
    # when: they are sent as fast as the controllers take them
    with daemon(bus="socketcan:can0") as d, (tmp_path / "dump.log").open("w") as dump:
        candump = subprocess.Popen(["candump", "-L", "-r", "8000000", "-n", str(len(lines)), "can0"], stdout=dump)
        time.sleep(1.0)
        start = time.monotonic()
        send("canplayer", "-t", "-g", "0", "-I", log, "can1=can0")
        print(f"{len(lines) / (time.monotonic() - start):.0f} frames/s")
        d.wait(lambda c: c["bus0.frames"] + c["bus0.dropped_by_kernel"] >= len(lines))
        assert candump.wait(PATIENCE) == 0
        summary = d.stop()
    # then: all arrived, in their order and with their bytes
    sent = [line.split()[2] for line in lines]
    assert [line.split()[2] for line in (tmp_path / "dump.log").read_text().splitlines()] == sent
    assert summary["decode.decoded"] == len(lines)
    assert summary["bus0.dropped_by_kernel"] == summary["bus0.controller_overruns"] == 0
    assert facts("can0")["stats64"]["rx"]["over_errors"] == 0


def set_interrupts(bus: str, is_on: bool) -> None:
    """Of a PCI device: without them the computer is one that does not come to empty its controller."""
    with Path(f"/sys/class/net/{bus}/device/config").open("r+b", buffering=0) as config:
        word = int.from_bytes(os.pread(config.fileno(), 2, PCI_COMMAND), "little")
        word = word & ~INTERRUPT_DISABLE if is_on else word | INTERRUPT_DISABLE
        os.pwrite(config.fileno(), word.to_bytes(2, "little"), PCI_COMMAND)


def test_overrun_of_the_receive_buffer_is_counted():
    before = facts("can0")["stats64"]["rx"]["over_errors"]
    with daemon(bus="socketcan:can0?filter=off") as d:
        set_interrupts("can0", False)
        try:
            for _ in range(2):
                send("cangen", "can1", "-I", "7A0", "-L", "8", "-n", "5", "-g", "1")
        finally:
            set_interrupts("can0", True)
        d.wait(lambda c: c["bus0.controller_overruns"] > 0)
        summary = d.stop()
    assert summary["bus0.frames"] - summary["bus0.error_frames"] == FIFO // FRAME
    assert (summary["bus0.controller_overruns"], summary["bus0.error_frames"]) == (1, 1)
    assert facts("can0")["stats64"]["rx"]["over_errors"] == before + 1


def test_listen_only_receives_and_never_sends(restored):
    run("ip", "link", "set", "can0", "down")
    run("ip", "link", "set", "can0", "type", "can", "bitrate", 1000000, "listen-only", "on")
    run("ip", "link", "set", "can0", "up")
    assert "LISTEN-ONLY" in of_driver("can0")["ctrlmode"]
    with daemon(bus="socketcan:can0?filter=off") as d:
        received = facts("can1")["stats64"]["rx"]["packets"]
        subprocess.run(["cansend", "can0", "123#00"], check=False, timeout=PATIENCE)
        send("cansend", "can1", SAMPLE)
        d.wait(lambda c: c["decode.decoded"] == 1)
        d.stop()
    assert facts("can1")["stats64"]["rx"]["packets"] == received


def test_adapter_unplugged_and_back_is_configured_and_taken_up_again():
    device = Path("/sys/class/net/can0/device").resolve().name
    with daemon(bus="socketcan:can0") as d:
        # when: the driver lets go of the adapter, which takes its interface away, and takes it again
        (DRIVER / "unbind").write_text(device)
        assert not Path("/sys/class/net/can0").exists()
        d.wait(lambda c: c["bus0.went_down"] == 1)
        (DRIVER / "bind").write_text(device)
        # then: networkd has set its bit rate without being asked, and the daemon hears it
        wait_until_up()
        assert of_driver("can0")["bittiming"]["bitrate"] == 1000000
        end = time.monotonic() + PATIENCE
        while d.counters["decode.decoded"] == 0 and time.monotonic() < end:
            send("cansend", "can1", SAMPLE)
            d.lcm.handle_timeout(1000)
        assert d.stop()["decode.decoded"] > 0


def test_states_of_the_controllers_and_what_their_emulation_lacks(restored):
    # states: the driver's
    run("ip", "link", "set", "can1", "down")
    assert (of_driver("can1")["state"], of_driver("can0")["state"]) == ("STOPPED", "ERROR-ACTIVE")
    # nobody acknowledges: a real controller counts to error-passive and repeats the frame for ever
    send("cansend", "can0", "123#00")
    time.sleep(0.5)
    assert of_driver("can0")["state"] == "ERROR-ACTIVE"
    assert facts("can0")["stats64"]["tx"]["errors"] == 0
    # another bit rate: a real controller would hear nothing but errors, and go bus-off
    run("ip", "link", "set", "can1", "type", "can", "bitrate", 500000)
    run("ip", "link", "set", "can1", "up")
    take_interrupts()
    received = facts("can1")["stats64"]["rx"]["packets"]
    send("cansend", "can0", "123#00")
    time.sleep(0.5)
    assert facts("can1")["stats64"]["rx"]["packets"] == received + 1
