# SPDX-License-Identifier: Apache-2.0
"""watch: its pages fit a terminal, its lines are JSON, no bytes of a message break it or reach the terminal."""

import json
import os
import pty
import random
import re
import select
import subprocess
import sys
import time

import lcm
import pytest
from conftest import TOP
from rich.console import Console

from inertiad.live import watch, watch_pages
from inertiad.live.latest import Latest
from inertiad_lcm import bus_t, counter_t, estimate_t, event_t, fact_t, health_t, host_t, latency_t

EVIL = "\x1b[2J\x9b31m[red]bold[/red]\x07\r\n\u202e\x1b]0;title\x07" + "x" * 400
CONTROLS = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u202e]")


def estimate(mass: float = 161.0, t: float = 1.0) -> estimate_t:
    result = estimate_t()
    result.t_ns, result.mass, result.mass_std, result.cog = int(1e9 * t), mass, 0.5, [0.01, 0.02, -0.3]
    result.inertia_cog = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    result.n_windows, result.n_rows, result.consistent, result.observable = 12, 3400, True, [True] * 10
    result.systematic_name, result.systematic, result.systematic_std, result.n_systematic = (
        ["acc_bias_x"],
        [0.1],
        [0.2],
        1,
    )
    return result


def bus(name: str, up: bool, condition: int) -> bus_t:
    result = bus_t()
    result.name, result.up, result.condition = name, up, condition
    return result


def health(t: float, counters: dict[str, int], *buses: bus_t) -> health_t:
    result = health_t()
    result.t_ns, result.age = int(1e9 * t), [0.001, 0.002, -1.0]
    for name, value in counters.items():
        item = counter_t()
        item.name, item.value = name, value
        result.counter.append(item)
    result.n_counters, result.bus, result.n_buses = len(counters), list(buses), len(buses)
    latency = latency_t()
    latency.name, latency.n, latency.p50, latency.p99, latency.p999, latency.longest = (
        "estimate",
        77,
        1e-5,
        2e-5,
        3e-5,
        4e-5,
    )
    result.latency, result.n_latencies = [latency], 1
    return result


def event(text: str) -> event_t:
    result = event_t()
    result.t_ns, result.source, result.text, result.kind = 1_000_000_000, "force", text, event_t.NEWS
    return result


def host(value: str) -> host_t:
    result, fact = host_t(), fact_t()
    fact.name, fact.value = "kernel", value
    result.fact, result.n_facts = [fact], 1
    return result


def busy() -> Latest:
    """Everything at once that a page may have to show."""
    latest, names = (
        Latest(),
        [f"align.{s}.{c}" for s in ("imu", "force", "position") for c in ("late", "missing", "reordered")],
    )
    buses = [bus(f"can{k}", k != 1, bus_t.OFF if k == 2 else bus_t.ACTIVE) for k in range(8)]
    for t in (1.0, 2.0):
        counters = {
            "bus0.frames": int(1000 * t),
            "motion.carried": 5,
            **{name: int(t * 10**k) for k, name in enumerate(names)},
        }
        latest.take("HEALTH", health(t, counters, *buses).encode())
    for k in range(200):
        wild = estimate(161.0 + k, float(k))
        wild.nis, wild.consistent, wild.observable, wild.verdict = 99.0, False, [False] * 10, estimate_t.STOP
        latest.take("ESTIMATE", wild.encode())
        latest.take("EVENT", event(f"lost {k}").encode())
    latest.take("HOST", host("Linux").encode())
    return latest


def text_of(shown: object, width: int = 80) -> str:
    console = Console(width=width, height=24, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(shown)
    return console.export_text()


def test_pages_show_value_sigma_trend_and_consistency():
    latest = Latest()
    assert "waiting for an estimate on udpm://x" in text_of(watch_pages.whole(latest, "udpm://x"))
    for k in range(1, 8):
        latest.take("ESTIMATE", estimate(161.0 + k, float(k)).encode())
    latest.take("HEALTH", health(1.0, {}).encode())
    text = text_of(watch_pages.whole(latest, "udpm://x"))
    for part in ("168.000", "0.500", "-0.3000", "12 windows, 3400 rows", "consistent", "▁▂▃▅▆▇█", "6 is expected"):
        assert part in text, part
    assert "IMU 1 ms, force 2 ms, position none yet" in text


def test_pages_show_buses_latencies_losses_and_events():
    latest = Latest()
    buses = bus("can0", True, bus_t.ACTIVE), bus("can1", False, bus_t.OFF)
    latest.take("HEALTH", health(5.0, {"bus0.frames": 1000}, *buses).encode())
    counters = {"bus0.frames": 3000, "bus1.dropped_by_kernel": 12, "align.force.late": 7, "align.rows": 5}
    frozen = health(7.0, counters, *buses)
    frozen.frozen = True
    latest.take("HEALTH", frozen.encode())
    latest.take("EVENT", event("lost, silent for 0.52 s").encode())
    text = " ".join(text_of(watch_pages.whole(latest, "udpm://x")).split())
    assert "can0 active 1000 3000 0 0" in text and "can1 down 0 0 0 12" in text
    assert "estimate 10.0 20.0 30.0 40.0 77" in text
    assert "lost: bus1.dropped_by_kernel 12, align.force.late 7" in text and "align.rows" not in text
    assert "frozen" in text and "force: lost, silent for 0.52 s" in text


@pytest.mark.parametrize("number", range(len(watch_pages.PAGES)))
def test_each_page_fits_80_by_24_when_everything_is_wrong(number: int):
    lines = text_of(watch_pages.screen(busy(), "udpm://239.255.76.67:7667?ttl=0", number, 24)).splitlines()
    assert len(lines) <= 24 and all(len(line) <= 80 for line in lines)
    assert f" {number + 1} {watch_pages.PAGES[number][0]} " in lines[0]


def test_keys_turn_pages():
    assert [watch.turned(0, key) for key in ("", "2", "\t", "\x1b[D", "9", "0", "x")] == [0, 1, 1, 3, 0, 0, 0]


def test_sparkline_is_the_trend():
    assert watch_pages.sparkline([]) == "" and watch_pages.sparkline([2.0, 2.0]) == "▁▁"
    assert watch_pages.sparkline([0.0, 7.0, 3.0]) == "▁█▄"
    assert len(watch_pages.sparkline([float(k) for k in range(100)], 10)) == 10


# ---- bytes of any kind -----------------------------------------------------------------------------------------------


def spoilt(latest: Latest, dice: random.Random, n: int) -> None:
    whole = {"ESTIMATE": estimate().encode(), "HEALTH": health(1.0, {"bus0.frames": 1}, bus("can0", True, 0)).encode()}
    whole |= {"EVENT": event("lost").encode(), "HOST": host("Linux").encode()}
    for _ in range(n):
        channel = dice.choice(list(whole))
        data = bytearray(whole[channel])
        for _ in range(dice.randrange(1, 6)):
            data[dice.randrange(8, len(data))] = dice.choice([0, 0x7F, 0x80, 0xFF, 0x1B, 0x9B, dice.randrange(256)])
        latest.take(channel, bytes(data[: dice.choice([len(data), dice.randrange(len(data))])]))


def test_no_bytes_break_a_page_or_a_line():
    dice = random.Random(3)
    for _ in range(60):
        latest = Latest()
        spoilt(latest, dice, 40)
        assert latest.n_undecodable > 0
        for number in range(len(watch_pages.PAGES)):
            assert not CONTROLS.search(text_of(watch_pages.screen(latest, "x", number, 24)))
        for message in (latest.estimate, latest.health, latest.host, *latest.events):
            if message is not None:
                json.loads(watch.json_line("X", message), parse_constant=lambda name: pytest.fail(name))


def test_text_of_messages_is_text_in_a_terminal_and_in_json():
    latest = Latest()
    latest.take("HEALTH", health(1.0, {EVIL: 3}, bus(EVIL, True, 0)).encode())
    latest.take("HOST", host(EVIL).encode())
    latest.take("EVENT", event(EVIL).encode())
    text = text_of(watch_pages.whole(latest, "x"), 2000)
    assert not CONTROLS.search(text) and "[red]bold[/red]" in text
    for message in (latest.health, latest.host, latest.events[0]):
        line = watch.json_line("X", message)
        assert not CONTROLS.search(line) and not CONTROLS.search(str(json.loads(line)).replace("\\n", ""))


# ---- the command -----------------------------------------------------------------------------------------------------


@pytest.fixture
def log(tmp_path):
    """An LCM log of each kind of message, and of bytes that are none."""
    written = lcm.EventLog(str(tmp_path / "run.lcmlog"), "w", overwrite=True)
    messages = (("ESTIMATE", estimate(123.456)), ("HEALTH", health(1.0, {"bus0.frames": 7})), ("EVENT", event(EVIL)))
    for channel, message in messages:
        written.write_event(1_000_000, f"INERTIAD_{channel}", message.encode())
        written.write_event(1_000_000, f"INERTIAD_{channel}", message.encode()[:20])
    written.close()
    return f"file://{tmp_path}/run.lcmlog?speed=0"


@pytest.mark.slow
def test_watch_shows_what_an_lcm_log_holds(inertiactl, log):
    result = inertiactl("watch", "--lcm", log, "--seconds", "20")
    assert result.returncode == 0 and result.stderr == ""
    assert "123.456" in result.stdout and "3 messages could not be decoded" in result.stdout
    assert not CONTROLS.search(result.stdout)


@pytest.mark.slow
def test_json_is_one_object_per_message(inertiactl, log):
    result = inertiactl("watch", "--lcm", log, "--seconds", "20", "--json")
    assert result.returncode == 0 and result.stderr == ""
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert [line["message"] for line in lines] == ["ESTIMATE", "HEALTH", "EVENT"]
    assert lines[0]["mass"] == 123.456 and lines[0]["systematic_name"] == ["acc_bias_x"]
    assert lines[1]["counter"] == {"bus0.frames": 7} and "n_counters" not in lines[1]


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--json"]])
def test_exit_code_is_1_when_nobody_sends(inertiactl, options):
    result = inertiactl("watch", "--lcm", "memq://", "--seconds", "0.3", *options)
    assert result.returncode == 1 and "nothing came on INERTIAD_" in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.slow
def test_terminal_turns_pages_ends_with_q_and_gets_its_state_back():
    """In a pseudo-terminal of 80 x 24."""
    parent, child = pty.openpty()
    environment = os.environ | {"TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
    command = [sys.executable, "-m", "inertiad", "watch", "--lcm", "memq://"]
    before = subprocess.check_output(["stty", "-a"], stdin=child)
    with subprocess.Popen(command, stdin=child, stdout=child, stderr=child, env=environment, cwd=TOP) as process:
        until(parent, "waiting for an estimate")
        os.write(parent, b"4")
        until(parent, "no events")
        os.write(parent, b"q")
        end = time.monotonic() + 60.0
        while process.poll() is None and time.monotonic() < end:
            drained(parent)
        assert process.returncode == 1
    assert subprocess.check_output(["stty", "-a"], stdin=child) == before
    os.close(parent)
    os.close(child)


def drained(terminal: int) -> bytes:
    """What waits in a terminal; a program that ends waits until it is read."""
    return os.read(terminal, 65536) if select.select([terminal], [], [], 0.1)[0] else b""


def until(terminal: int, text: str) -> None:
    found, end = b"", time.monotonic() + 60.0
    while text.encode() not in found:
        assert time.monotonic() < end, found
        found += drained(terminal)
