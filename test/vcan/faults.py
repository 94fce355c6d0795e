# SPDX-License-Identifier: Apache-2.0
"""Do to a daemon what scenarios.py describes, each on a CAN bus of its own, and tell what it made of it.

    tools/vcan python3 test/vcan/faults.py [word ...]

Needs build/vcan/faults (test/vcan/prepare.py) and nothing but the standard library, so that a slow guest starts it
soon. The buses of a phase are fed at once at the run's own pace. Where that pace could not be kept, what failed is no
finding about the daemon and is done again, half as many at once. Leaves build/vcan/faults.txt and faults.json; exit
status 1: a row failed.
"""

import errno
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

TOP = Path(__file__).resolve().parents[2]
RUNS = TOP / "build/vcan/faults"
OUT = Path("/tmp/faults")
RECORD = struct.Struct("<dHH72s")  # as in scenarios.py, which needs more than the standard library to run
PATIENCE = 180.0  # s
SENSORS = ("imu", "force", "position")
LOSSES = (
    ("group", "lost"),
    ("stuck", "refused"),
    ("pace", "dropped"),
    ("align", "backwards"),
    ("align", "duplicate"),
    ("align", "not_finite"),
)
HOUR = 3600.0
STORM = {"unknown storm": ("-I", "7A0", "-L", "8"), "remote storm": ("-I", "010", "-L", "0", "-R")}
"""of cangen, which sends as fast as the machine can; the remote frames ask for the IMU's message"""
ON_TIME = 0.05  # s, no frame later than that: the schedule was kept
TRIES = 3  # of one alone
STORM_MIN = 10000  # frames; else it was none
IDLE_TICKS = 20  # of 10 ms in a second, all daemons together


def shell(text: str) -> None:
    subprocess.run(["sh", "-c", text], check=True)


def in_background(text: str) -> None:
    """In a slow guest it may take seconds: the other buses go on."""
    subprocess.Popen(["sh", "-c", text], stderr=subprocess.DEVNULL)


def read_summary(text: str) -> dict[str, int]:
    """The counters that a daemon leaves on stderr."""
    rows = [line.split()[1:] for line in text.splitlines()]
    return {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}


class Patient:
    """One scenario: its bus, its daemon, what was sent."""

    def __init__(self, number: int, facts: dict[str, Any]):
        self.facts = facts
        self.bus = f"fault{number}"
        self.folder = OUT / str(number)
        self.n_sent = self.n_refused = self.n_dropped = 0
        self.socket: socket.socket | None = None
        self.n_foreign = 0
        self.storm: subprocess.Popen[bytes] | None = None
        self.restart_s: float | None = None
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        options = [o.format(folder=self.folder) for o in self.facts["options"]]
        if "--lcm" not in options:
            options += ["--lcm", "none"]
        address = f"socketcan:{self.bus}" + ("" if self.facts["filter"] else "?filter=off")
        command = [
            TOP / "build/bin/inertiad",
            "-v",
            "--config",
            RUNS / self.facts["robot"] / "robot.cfg",
            "--bus",
            address,
        ]
        self.estimate = self.folder / "estimate.json"
        self.errors = self.folder / "stderr.txt"
        with self.errors.open("wb") as file:
            self.process = subprocess.Popen([*command, "--estimate", self.estimate, *options], stderr=file)

    def ticks(self) -> int:
        """processor time so far, as the kernel counts it"""
        assert self.process is not None
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return int(fields[11]) + int(fields[12])

    def is_listening(self) -> bool:
        return f" {self.bus} " in Path("/proc/net/can/rcvlist_err").read_text().replace("\n", " ")

    def send(self, frame: bytes) -> None:
        try:
            if self.socket is None:
                self.connect()
            self.socket.send(frame)
            self.n_sent += 1
        except OSError as error:
            if error.errno == errno.ENOBUFS:
                raise
            self.n_refused += 1  # the interface is down or gone
            self.socket = None

    def connect(self) -> None:
        if not Path(f"/sys/class/net/{self.bus}").exists():  # asked by name, the kernel would look for a module
            raise OSError(errno.ENODEV, self.bus)
        self.socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        self.socket.bind((self.bus,))

    def act(self, action: str) -> None:
        assert self.process is not None
        match action:
            case "down" | "up":
                in_background(f"ip link set {self.bus} {action}")
            case "delete":
                in_background(f"ip link del {self.bus}")
            case "create":
                in_background(
                    f"until ip link add {self.bus} type vcan; do sleep 0.1; done; ip link set {self.bus} mtu 72 up"
                )
            case "no multicast":
                in_background("ip route del 224.0.0.0/4 dev lo")
            case "multicast":
                in_background("ip route add 224.0.0.0/4 dev lo")
            case "unknown storm" | "remote storm":
                command = ["cangen", self.bus, "-g", "0", "-p", "10", *STORM[action]]
                self.storm = subprocess.Popen(command, stderr=subprocess.DEVNULL)
            case "calm":
                assert self.storm is not None
                self.storm.terminate()
                self.storm.wait()
            case "stop":
                self.process.send_signal(signal.SIGSTOP)
            case "continue":
                self.process.send_signal(signal.SIGCONT)
            case "terminate":
                self.process.send_signal(signal.SIGTERM)
            case "kill":
                self.process.kill()
                self.process.wait()
                begin = time.monotonic()
                self.start()
                while not self.is_listening() and time.monotonic() < begin + PATIENCE:
                    time.sleep(0.01)
                self.restart_s = time.monotonic() - begin
            case "hour ahead" | "hour back":
                step = HOUR if action == "hour ahead" else -HOUR
                time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME) + step)
            case "small disk":
                pass  # was there from the start

    def prepare(self) -> None:
        subprocess.run(["umount", "-q", self.folder / "small"], check=False, stderr=subprocess.DEVNULL)
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        if any(action == "small disk" for _, action in self.facts["actions"]):
            (self.folder / "small").mkdir()
            shell(f"mount -t tmpfs -o size=128k tmpfs {self.folder}/small")

    def note_statistics(self) -> None:
        """Frames taken from the sender that the interface, on its way down, gave to nobody; frames of a storm."""
        statistics = Path(f"/sys/class/net/{self.bus}/statistics")
        self.n_dropped = int((statistics / "rx_dropped").read_text())
        if self.storm is not None:
            self.n_foreign = int((statistics / "tx_packets").read_text()) - self.n_sent

    def counters(self) -> dict[str, int]:
        return read_summary(self.errors.read_text())


def sigmas(estimate: Path, truth: dict[str, Any]) -> float:
    """The largest error of mass, CoG and inertia against the truth, in the estimate's own standard deviations."""
    found = json.loads(estimate.read_text())
    worst = 0.0
    for name in ("mass", "cog", "inertia_cog"):
        if found[name] is None:  # no body was found
            return float("inf")
        value, std, true = found[name]["value"], found[name]["std"], truth[name]
        triples = [(value, std, true)] if name == "mass" else zip(value, std, true, strict=True)
        worst = max(worst, *(abs(v - t) / s if s > 0.0 else float("inf") for v, s, t in triples), 0.0)
    return worst


def account(c: dict[str, int]) -> tuple[int, dict[str, int], list[str]]:
    """Samples used, samples lost by cause, and what in a summary's counters does not add up."""
    wrong = []
    outcomes = ("decoded", "unknown_id", "remote", "error_frame", "bad_length")
    if c["bus0.frames"] != sum(c[f"decode.{outcome}"] for outcome in outcomes):
        wrong.append("frames received and decoded differ")
    used = sum(c[f"align.{s}.samples"] for s in SENSORS)
    names = [f"{stage}.{s}.{cause}" for s in SENSORS for stage, cause in LOSSES]
    lost = {name: c[name] for name in names if c[name]}
    grouped = sum(c[f"group.{s}.{kind}_frames"] for s in SENSORS for kind in ("duplicate", "dropped"))
    if c["decode.decoded"] - grouped != used + sum(n for name, n in lost.items() if not name.endswith(".lost")):
        wrong.append("samples received and used differ")
    return used, lost, wrong


def judge(patient: Patient) -> dict[str, Any]:
    """A row of the table, with everything that is wrong with it."""
    facts = patient.facts
    assert patient.process is not None
    if patient.process.returncode != 0:
        return {"fault": facts["name"], "wrong": [f"exit status {patient.process.returncode}"]}
    c = patient.counters()
    used, lost, wrong = account(c)
    actions = {action for _, action in facts["actions"]}
    is_whole = not actions & {"terminate", "kill"}
    is_heard = is_whole and "create" not in actions  # a new interface has no listener until the daemon finds it
    if is_whole and facts["made"] != used + sum(lost.values()):
        wrong.append(f"{facts['made']} samples were made")
    if is_heard and patient.n_sent != c["bus0.frames"] + c["bus0.dropped_by_kernel"] + patient.n_dropped:
        wrong.append(f"{patient.n_sent} frames sent, {c['bus0.frames']} received, {patient.n_dropped} dropped unheard")
    wrong += [f"{name} is 0" for name in facts["counted"] if not c.get(name)]
    if patient.storm is not None and patient.n_foreign < STORM_MIN:
        wrong.append(f"only {patient.n_foreign} foreign frames")
    error = sigmas(patient.estimate, json.loads((RUNS / "run/truth.json").read_text()))
    if not error < 3.0:
        wrong.append(f"estimate off by {error:.1f} sigma")
    return {
        "fault": facts["name"],
        "made": facts["made"],
        "sent": patient.n_sent,
        "used": used,
        "lost": lost,
        "noticed": {name: c[name] for name in facts["counted"] if name not in lost and c.get(name)}
        | ({"foreign frames kept away": patient.n_foreign} if patient.n_foreign else {}),
        "sigma": round(error, 2),
        "restart_s": patient.restart_s,
        "wrong": wrong,
    }


def table(rows: list[dict[str, Any]]) -> str:
    head = f"{'fault':27}{'samples':>8}{'sent':>7}{'used':>7}  {'lost, by cause':50}{'error/sigma':>12}  verdict"
    lines = [head]
    for row in rows:
        if "used" not in row:
            lines.append(f"{row['fault']:27}{'; '.join(row['wrong'])}")
            continue
        causes = ", ".join(f"{name} {n}" for name, n in row["lost"].items()) or "none"
        numbers = f"{row['fault']:27}{row['made']:8}{row['sent']:7}{row['used']:7}"
        lines.append(f"{numbers}  {causes:50}{row['sigma']:12.2f}  {'; '.join(row['wrong']) or 'good'}")
        notes = [f"{name} {n}" for name, n in row["noticed"].items()]
        notes += [f"listening again after {row['restart_s']:.2f} s"] if row["restart_s"] is not None else []
        if notes:
            lines.append(" " * 51 + ", ".join(notes))
    return "\n".join(lines) + "\n"


def wait_until(condition: Any, what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            sys.exit(f"faults: waited in vain for {what}")
        time.sleep(0.1)


def wait_until_idle(patients: list[Patient]) -> None:
    """A slow guest takes its time to load the daemons: frames should not be late for that."""
    end, ticks, used = time.monotonic() + PATIENCE, 0, IDLE_TICKS
    while used >= IDLE_TICKS and time.monotonic() < end:
        time.sleep(1.0)
        now = sum(p.ticks() for p in patients)
        ticks, used = now, now - ticks


def feed(patients: dict[int, Patient], phase: int) -> float:
    """Send the schedule at its pace, act in between. The largest delay of a frame, s."""
    actions = sorted(((t, n, action) for n, p in patients.items() for t, action in p.facts["actions"]), reverse=True)
    begin, latest = time.monotonic() + 0.5, 0.0
    for due, number, size, frame in RECORD.iter_unpack((RUNS / f"schedule_{phase}.bin").read_bytes()):
        if number not in patients:
            continue
        while actions and actions[-1][0] <= due:
            _, n, action = actions.pop()
            patients[n].act(action)
            print(f"  {time.monotonic() - begin:6.2f} s: {patients[n].facts['name']}: {action}", file=sys.stderr)
        early = begin + due - time.monotonic()
        if early > 0.0:
            time.sleep(early)
        latest = max(latest, -early)
        patients[number].send(frame[:size])
    for _, n, action in reversed(actions):
        patients[n].act(action)
    return latest


def run_together(patients: dict[int, Patient], phase: int) -> float:
    """Feed these daemons at once. The largest delay of a frame, s."""
    former = [Path(f"/sys/class/net/{p.bus}") for p in patients.values()]
    wait_until(lambda: not any(path.exists() for path in former), "the end of buses used before")
    links = "".join(f"link add {p.bus} type vcan\nlink set {p.bus} mtu 72 up\n" for p in patients.values())
    subprocess.run(["ip", "-batch", "-"], input=links, text=True, check=True)
    for p in patients.values():
        p.prepare()
        p.start()
    wait_until(lambda: all(p.is_listening() for p in patients.values()), "the daemons")
    wait_until_idle(list(patients.values()))
    latest = feed(patients, phase)
    time.sleep(3.0)  # the slowest of them reads its last frames
    for p in patients.values():
        assert p.process is not None
        p.process.send_signal(signal.SIGTERM)
    for p in patients.values():
        p.process.wait(PATIENCE)
        p.note_statistics()
        in_background(f"ip link del {p.bus}")
    print(f"phase {phase}: {len(patients)} daemons, no frame later than {latest:.2f} s", file=sys.stderr)
    return latest


Scenarios = dict[int, dict[str, Any]]
"""by number, as in scenarios.json"""


def rows_of(scenarios: Scenarios, phase: int, tries: int = TRIES) -> dict[int, dict[str, Any]]:
    """Run scenarios of one phase at once. Those that failed where the schedule was not kept run again, in halves."""
    patients = {n: Patient(n, facts) for n, facts in scenarios.items()}
    latest = run_together(patients, phase)
    rows = {n: judge(patient) for n, patient in patients.items()}
    failed = [n for n, row in rows.items() if row["wrong"]]
    for n in failed:
        shutil.copy(patients[n].errors, RUNS / f"{patients[n].bus}.stderr.txt")
    is_alone = len(scenarios) == 1
    if latest <= ON_TIME or (is_alone and tries == 1):
        return rows
    size = max(1, len(scenarios) // 2)
    for i in range(0, len(failed), size):
        half = {n: scenarios[n] for n in failed[i : i + size]}
        rows |= rows_of(half, phase, tries - is_alone)
    return rows


def main(words: list[str]) -> int:
    facts = json.loads((RUNS / "scenarios.json").read_text())
    chosen = {n: f for n, f in enumerate(facts) if not words or any(w in f["name"] for w in words)}
    found: dict[int, dict[str, Any]] = {}
    for phase in sorted({f["phase"] for f in chosen.values()}):
        found |= rows_of({n: f for n, f in chosen.items() if f["phase"] == phase}, phase)
    rows = [found[n] for n in sorted(found)]
    (RUNS.parent / "faults.json").write_text(json.dumps(rows, indent=1) + "\n")
    (RUNS.parent / "faults.txt").write_text(table(rows))
    print(table(rows), end="")
    return 1 if any(row["wrong"] for row in rows) else 0


if __name__ == "__main__":
    os.environ.setdefault("LC_ALL", "C")
    sys.exit(main(sys.argv[1:]))
