# SPDX-License-Identifier: Apache-2.0
"""replay on real buses: every frame on its bus, as often and as fast as asked for. Only plain sockets read here."""

import socket
import struct
import subprocess
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]
SO_RCVBUFFORCE, SO_TIMESTAMPNS = 33, 35
N, PERIOD = 400, 0.005  # frames, s
FD = 0x200


def listener(interface: str) -> socket.socket:
    link = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    link.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 8 << 20)
    link.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    link.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
    link.bind((interface,))
    link.settimeout(1.0)
    return link


def received(link: socket.socket) -> list[tuple[int, bytes, float]]:
    """Identifier, data and kernel stamp [s]."""
    found = []
    while True:
        try:
            frame, control, _, _ = link.recvmsg(72, 128)
        except TimeoutError:
            return found
        s, ns = struct.unpack("qq", control[0][2][:16])
        can_id, length = struct.unpack("=IB", frame[:5])
        found.append((can_id, frame[8 : 8 + length], s + 1e-9 * ns))


def test_two_buses_classical_and_fd_cut_sped_up_and_looped(tmp_path: Path):
    # given: frames by turns on two interfaces, those of the second in CAN FD
    lines, sent = [], {"can0": [], "can1": []}
    for k in range(N):
        name, data = f"can{k % 2}", k.to_bytes(4, "big") * (1 if k % 2 == 0 else 5)
        mark = "#" if k % 2 == 0 else "##1"
        lines.append(f"({100 + PERIOD * k:017.6f}) {name} {0x100 + k % 8:03X}{mark}{data.hex().upper()}\n")
        if 0.5 <= PERIOD * k <= 1.5:
            sent[name].append((0x100 + k % 8, data))
    (tmp_path / "can.log").write_text("".join(lines))
    # when: the second from 0.5 to 1.5 s is played twice at double speed
    options = ["--start", "0.5", "--stop", "1.5", "--speed", "2", "--loop", "2"]
    command = [TOP / "build/bin/inertiactl", "replay", tmp_path / "can.log", *options]
    with listener("vcan0") as first, listener("vcan1") as second:
        buses = ["--bus", "socketcan:vcan0", "--bus", "socketcan:vcan1"]
        result = subprocess.run([str(c) for c in (*command, *buses)], capture_output=True, text=True, timeout=300)
        assert result.returncode == 0, result.stderr
        got = {"can0": received(first), "can1": received(second)}
    # then
    for name, frames in got.items():
        assert [(can_id, data) for can_id, data, _ in frames] == 2 * sent[name]
        n = len(sent[name])
        assert frames[n - 1][2] - frames[0][2] >= 0.45  # 1 s of log in 0.5 s; later where the machine stalls
    n_all = 2 * sum(map(len, sent.values()))
    assert sum(int(line.split()[1]) for line in result.stderr.splitlines() if " sent, late by" in line) == n_all
