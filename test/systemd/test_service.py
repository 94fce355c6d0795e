# SPDX-License-Identifier: Apache-2.0
"""The shipped unit under systemd, in a guest: its sandbox lets in what the daemon needs, and systemd keeps it running.

systemd is process 1 of namespaces of its own, with the unit as it is shipped, the daemon in /usr/local/bin and vcan0.
Multicast leaves through an interface with an address, as on a machine with a network: datagrams of this host then have
that address as their source. Needs the runs of test/vcan/prepare.py.
"""

import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import lcm
import pytest

from inertiad_lcm import command_t, event_t, health_t, tracker_t

TOP = Path(__file__).resolve().parents[2]
ROBOT = TOP / "build/vcan/devices"
PACKAGING = TOP / "firmware/packaging"
URL = "udpm://239.255.76.67:7667?ttl=0"
ADDRESS = "192.168.76.2"
PATIENCE = 100.0  # s; an emulated guest is slow
EXPOSURE_MAX = 3.0  # 0 best, 10 worst; as in host/test_service.py

UNITS = ("sysinit.target", "basic.target", "shutdown.target", "systemd-journald.service", "systemd-journald.socket")
"""of the distribution, all that the unit needs: a whole system would take minutes to boot in an emulated guest"""
INIT = f"""
set -e
mount -t tmpfs -o mode=755 run /run
umount /sys/fs/cgroup
mount -t cgroup2 cgroup2 /sys/fs/cgroup
mount -t tmpfs tmpfs /usr/local/bin
install -m 755 {TOP}/build/bin/inertiad /usr/local/bin
mkdir /run/units
for unit in {" ".join(UNITS)}; do cp /lib/systemd/system/$unit /run/units; done
cp {PACKAGING}/inertiad.service /run/units
exec env -i container=guest PATH="$PATH" SYSTEMD_UNIT_PATH=/run/units SYSTEMD_GENERATOR_PATH=/run/none \
    /lib/systemd/systemd --system --unit=inertiad.service --log-target=kmsg --show-status=no
"""


class Service:
    """systemd, and what the daemon under it publishes."""

    def __init__(self, log: Path):
        self.log = log
        cgroup = Path("/sys/fs/cgroup/service")
        cgroup.mkdir(exist_ok=True)
        spaces = ["--fork", "--pid", "--mount", "--cgroup", "--mount-proc", "--kill-child"]
        with log.open("w") as file:
            self.outer = subprocess.Popen(
                ["sh", "-c", f'echo $$ >{cgroup}/cgroup.procs; exec unshare "$@"', "sh", *spaces, "sh", "-c", INIT],
                stdout=file,
                stderr=file,
            )
        self.counters: dict[str, int] = {}
        self.answers: list[event_t] = []
        self.lcm = lcm.LCM(URL)
        self.lcm.subscribe("INERTIAD_HEALTH", self._on_health)
        self.lcm.subscribe("INERTIAD_EVENT", lambda _, data: self.answers.append(event_t.decode(data)))

    def _on_health(self, _channel: str, data: bytes) -> None:
        self.counters = {c.name: c.value for c in health_t.decode(data).counter}

    def init(self) -> str:
        """Process number of systemd as seen from here."""
        return Path(f"/proc/{self.outer.pid}/task/{self.outer.pid}/children").read_text().strip()

    def inside(self, *command: object, check: bool = True) -> str:
        """Output of a command beside systemd."""
        enter = ["nsenter", "--target", self.init(), "--all", "--", *map(str, command)]
        return subprocess.run(enter, check=check, capture_output=True, text=True, timeout=PATIENCE).stdout

    def shows(self, name: str) -> str:
        return self.inside("systemctl", "show", "-P", name, "inertiad", check=False).strip()

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                print(self.log.read_text(), subprocess.run(["dmesg"], capture_output=True, text=True).stdout[-6000:])
                pytest.fail(f"{what}: waited in vain; {self.counters}")
            self.lcm.handle_timeout(500)

    def wait_active(self) -> None:
        self.wait(lambda: bool(self.init()), "systemd does not start")
        self.wait(lambda: self.shows("ActiveState") == "active", "the service is not active")
        self.counters = {}
        self.wait(lambda: bool(self.counters), "no HEALTH")


def publish_position(service: Service) -> None:
    message = tracker_t()
    message.valid, message.t_ns, message.position = True, time.time_ns(), [0.0, 0.0, 2.0]
    service.lcm.publish("INERTIAD_TRACKER", message.encode())


def send(service: Service, kind: int, sequence: int) -> None:
    message = command_t()
    message.kind, message.text, message.sender = kind, "load on", 7
    message.sequence, message.t_ns = sequence, time.time_ns()
    service.lcm.publish("INERTIAD_COMMAND", message.encode())


def learnt(service: Service) -> int:
    """Windows that the estimate holds, from the answer to a RESUME, which changes nothing."""
    sequence = time.time_ns()
    send(service, command_t.RESUME, sequence)
    found: list[event_t] = []

    def is_answered() -> bool:
        found.extend(a for a in service.answers if a.command == sequence)
        return bool(found)

    service.wait(is_answered, "RESUME is not answered")
    match = re.fullmatch(r"resume done: learning already, (\d+) windows", found[0].text)
    assert match, found[0].text
    return int(match[1])


@pytest.fixture(scope="module")
def service(tmp_path_factory) -> Iterator[Service]:
    for command in (
        "modprobe dummy",
        "ip link add lan type dummy",
        f"ip address add {ADDRESS}/24 dev lan",
        "ip link set lan up multicast on",
        "ip route replace 224.0.0.0/4 dev lan",
    ):
        subprocess.run(command.split(), check=True)
    Path("/etc/inertiad").mkdir(exist_ok=True)
    shutil.copy(ROBOT / "robot.cfg", "/etc/inertiad")
    Path("/etc/inertiad/options").write_text('BUSES="--bus socketcan:vcan0 --bus socketcan:vcan1"\n')
    s = Service(tmp_path_factory.mktemp("systemd") / "log")
    try:
        s.wait_active()
        yield s
    finally:
        s.outer.kill()
        s.outer.wait()
        print(s.log.read_text())


def test_command_and_tracker_of_this_host_arrive(service: Service):
    def position_arrived() -> bool:
        publish_position(service)
        return service.counters["lcm.tracker_unused"] > 0  # its robot stands in one place

    def command_answered() -> bool:
        command_answered.sequence += 1
        send(service, command_t.MARK, command_answered.sequence)
        return any(a.kind == event_t.DONE and a.sender == 7 for a in service.answers)

    command_answered.sequence = 0
    service.wait(position_arrived, "positions of this host do not reach the daemon")
    service.wait(command_answered, "commands of this host do not reach the daemon")


def test_daemon_that_hangs_is_replaced_by_the_watchdog(service: Service):
    # given: a checkpoint with something in it
    assert learnt(service) == 0
    player = subprocess.Popen(["canplayer", "-I", str(ROBOT / "can.log"), "vcan0=can0", "vcan1=can1"])
    service.wait(lambda: learnt(service) > 0, "nothing is learnt")
    hung = service.shows("MainPID")
    saved = service.counters.get("checkpoint.written", 0)
    service.wait(lambda: service.counters.get("checkpoint.written", 0) > saved, "no checkpoint is written")
    player.kill()
    player.wait()
    # when
    service.inside("sh", "-c", f"kill -STOP {hung}")
    # then: the watchdog, and the next daemon goes on from the checkpoint
    service.wait(lambda: service.shows("NRestarts") == "1", "the watchdog does not restart it")
    service.wait_active()
    assert service.shows("MainPID") != hung
    assert learnt(service) > 0


def test_sandbox_is_as_tight_as_it_was(service: Service):
    text = service.inside("systemd-analyze", "security", "--no-pager", "inertiad")
    print(text.splitlines()[-1])
    assert float(re.search(r"exposure level for inertiad.service: ([0-9.]+)", text)[1]) <= EXPOSURE_MAX


def test_stop_is_clean_and_leaves_the_files(service: Service):
    service.inside("systemctl", "stop", "inertiad")
    assert service.shows("ActiveState") == "inactive"
    assert (service.shows("Result"), service.shows("ExecMainStatus")) == ("success", "0")
    files = service.inside("ls", "/var/lib/private/inertiad").split()
    assert {"run.lcmlog", "checkpoint"} <= set(files)
