# SPDX-License-Identifier: Apache-2.0
"""
Read a candump log, and write bytes to descriptors each at its own time.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy
from numpy.typing import NDArray


def parse_candump(data: bytes) -> dict:
    """
    Frames of a candump log in the order of the file: dict of t_ns, can_id, flags, length, bus [N], data [N, 8 or 64], names (interface of each bus), n_lines, n_bad, first_bad (line number), first_reason, n_reported_lost. candump.h
    """

def play(data: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], begin: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], due_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], route: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], fds: Sequence[int], start_ns: int, spin_ns: int) -> dict:
    """
    Write data[begin[k]:begin[k + 1]] to fds[route[k]] at start_ns + due_ns[k] of CLOCK_MONOTONIC, for k = 0 .. N - 1; spin_ns before each instant is waited for actively. dict of lateness_ns [items sent] (after the call that sent it), n_waits (full queues), is_interrupted (Ctrl-C), error (errno, 0: none) and the route it came from.
    """
