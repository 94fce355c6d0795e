# SPDX-License-Identifier: Apache-2.0
"""Checks of the rows, with a decoder of their own: from the DBC, in numpy."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inertiad.base import quantity
from inertiad.base.table import Array
from inertiad.check.case import Case, Check
from inertiad.robot import dbc
from inertiad.robot.dbc import Binding
from inertiad.run import encode
from inertiad.run.canlog import CanLog

ROWS_LOST_MAX: Final = 0.01
"""share of IMU samples that may not become rows: at the ends, where another sensor is missing; on a bus also where the
host stamped late and its clock's fit steps back once it knows better"""
UNSETTLED_MAX: Final = 3.0
"""s of rows that the daemon may give up because clocks were not settled, where none was stepped"""
NS_PER_S: Final = 1e9


def decode(binding: Binding, log: CanLog) -> tuple[NDArray[np.intp], Array]:
    """Indices and values [SI] of a bound signal in the log, from the DBC alone: no code shared with the daemon."""
    chosen = (log.can_id == binding.can_id) & (log.length == binding.message.length)
    if len(log.names) > 1:
        chosen &= log.bus == binding.bus
    at = np.flatnonzero(chosen)
    if binding.mux is not None:
        selector, value = binding.mux
        at = at[_raw(selector, log.data[at]) == value]
    return at, _si(binding, _raw(binding.signal, log.data[at]))


def _raw(signal: Any, data: Any) -> Any:
    raw = np.zeros(len(data), dtype=np.uint64)
    for i, (byte, bit) in enumerate(encode.bit_positions(signal)):
        raw |= ((data[:, byte] >> bit) & 1).astype(np.uint64) << np.uint64(i)
    return raw


def _si(binding: Binding, raw: Any) -> Array:
    signal = binding.signal
    if signal.is_float:
        number = raw.astype(np.uint32).view(np.float32) if signal.length == 32 else raw.view(np.float64)
    elif signal.is_signed:
        sign = np.uint64(64 - signal.length)
        number = (raw << sign).view(np.int64) >> sign.astype(np.int64)
    else:
        number = raw
    return np.asarray(number.astype(np.float64) * binding.scale + binding.offset)


def _rows(case: Case) -> tuple[NDArray[np.int64], dict[str, Array]]:
    """Stamps [ns] and values of all rows of all SIGNALS messages."""
    rows = [r for m in case.published.messages["SIGNALS"] for r in m.row]
    values = {name: np.array([getattr(r, name) for r in rows]) for name in ("acc", "gyro")}
    return np.array([r.t_ns for r in rows], dtype=np.int64), values


def check_rows(case: Case) -> Iterator[Check]:
    t_ns, values = _rows(case)
    counters = case.published.summary
    n_imu = counters.get("align.imu.samples", 0) + counters.get("align.imu.backwards", 0)
    n_unsettled = counters.get("clock.unsettled", 0)
    lost = n_imu - len(t_ns) - n_unsettled
    good = n_imu > 0 and 0 <= lost <= max(ROWS_LOST_MAX * n_imu, 50)
    good &= len(t_ns) > 1 and n_unsettled * float(np.median(np.diff(t_ns))) < UNSETTLED_MAX * NS_PER_S
    causes = ("missing", "late", "backwards", "carried", "unsettled")
    listed = ", ".join(f"{name} {n}" for name, n in counters.items() if n and name.rpartition(".")[2] in causes)
    yield Check("rows", good, f"{len(t_ns)} of {n_imu} IMU samples{f'; {listed}' if listed else ''}")
    ordered = len(t_ns) > 0 and bool((np.diff(t_ns) > 0).all())
    yield Check("row stamps", ordered, "increase" if ordered else "do not increase")
    if len(t_ns):
        yield _check_decoder(case, values)


def _check_decoder(case: Case, values: dict[str, Array]) -> Check:
    """Every acceleration and rate in the rows is one that stands in the log, by our own decoder."""
    for name, found in values.items():
        for axis in range(3):
            binding = next(b for b in case.bindings if b.quantity == f"{name}_{'xyz'[axis]}")
            there = np.isin(found[:, axis], decode(binding, case.log)[1])
            if not there.all():
                at = int(np.argmin(there))
                detail = (
                    f"{binding.quantity} = {found[at, axis]:.9g} of row {at + 1} is not in the log by {binding.place}"
                )
                return Check("decoder", False, detail)
    return Check("decoder", True, "every acceleration and rate equals one decoded from the log by the DBC")


def check_sample_counters(case: Case) -> Iterator[Check]:
    """Counters the sensors put into their messages step by one."""
    for binding in case.bindings:
        if binding.quantity not in quantity.COUNTER or dbc.carries_time(binding, case.bindings):
            continue
        _, value = decode(binding, case.raw)
        step = np.mod(np.diff(value), 2.0**binding.signal.length)
        bad = int((step != 1).sum())
        detail = f"steps by one, {len(value)} times" if not bad else f"{bad} steps of other than one"
        yield Check(f"counter {binding.message.name}.{binding.signal.name}", not bad and len(value) > 1, detail)
