# SPDX-License-Identifier: Apache-2.0
"""A tracker's own recording beside that of the other sensors: its channels on the clock of the other.

Motion capture exports count from 0 or by a clock of their own. Where the start is not given, the motion gives it
(clock_offset.py), and with it the axis that points up: Motive's is y unless told otherwise.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from inertiad.base import quantity
from inertiad.base.error import InputError
from inertiad.exchange import channels, clock_offset
from inertiad.exchange.channels import Found, Mapping
from inertiad.exchange.foreign_csv import Channel

Z_FROM_Y: Final = {"pos_x": ("pos_x", 1.0), "pos_y": ("pos_z", -1.0), "pos_z": ("pos_y", 1.0)}
"""z up from y up: the quantity whose proposed channel each takes instead, and its sign"""


def joined(
    file: Path, known: list[Found], tracker: Path, mapping: Mapping | None, start: float | None, remarks: list[str]
) -> list[Found]:
    """The channels of a recording, and a tracker's own ones with times on the clock of the first.

    mapping: None to propose one. start: s, time of the recording at which the tracker's clock is 0; None: from the
    motion. remarks: start and axes that were found. InputError: no positions, or no start that explains the motion.
    """
    others = [replace(item, quantity=None) if item.quantity in quantity.POSITION else item for item in known]
    seen = _renamed(tracker, channels.summary(tracker), {item.channel.name for item in known})
    up = "z"
    if start is None:
        found = _offset(file, others, tracker, seen, mapping)
        start, up = found.start, found.up
        remarks.append(
            f"{tracker.name} begins its clock at t = {start:.3f} s of {file.name}: from the motion, correlation "
            f"{found.correlation:.2f}; --tracker-start sets it, inertiactl sync estimates what remains"
        )
    if up == "y" and mapping is not None:
        remarks.append(f"{tracker.name}: the motion fits better with y up: check pos_y and pos_z of the mapping")
    elif up == "y":
        remarks.append(f"{tracker.name}: y points up there: pos_y is its -z, pos_z its y")
        seen = _z_up(seen)
    return [*others, *_within(file, others, tracker, seen, start, remarks)]


def _renamed(tracker: Path, found: Sequence[Found], taken: set[str]) -> list[Found]:
    """Channels with names of their own, of which positions alone are proposed."""
    result = []
    for item in found:
        channel = item.channel
        name = f"{channel.name} ({tracker.name})" if channel.name in taken else channel.name
        kept = item.quantity if item.quantity in quantity.POSITION else None
        result.append(Found(Channel(name, channel.unit, channel.t, channel.value), kept))
    return result


def _offset(
    file: Path, known: list[Found], tracker: Path, seen: list[Found], mapping: Mapping | None
) -> clock_offset.Offset:
    both = [*known, *seen]
    mapped = channels.mapped(file, both, mapping or channels.proposed_mapping(file, both))
    remedy = f"pass --tracker-start S: s, the time of {file.name} at which the clock of {tracker.name} is 0"
    lacking = [name for name in (*quantity.ACC, *quantity.POSITION) if name not in mapped]
    if lacking:
        raise InputError(f"{tracker}: no {', '.join(lacking)} to find the offset of its clock by; {remedy}")
    acc, position = ([mapped[name] for name in names] for names in (quantity.ACC, quantity.POSITION))
    if any(len(axis.t) != len(of[0].t) for of in (acc, position) for axis in of):
        raise InputError(f"{tracker}: x, y and z of accelerations or positions have different times; {remedy}")
    try:
        found = clock_offset.find(
            acc[0].t,
            np.column_stack([c.value for c in acc]),
            position[0].t,
            np.column_stack([c.value for c in position]),
        )
    except clock_offset.NoOffset as error:
        raise InputError(
            f"{tracker}: the offset of its clock to that of {file.name} is not found: {error}; {remedy}"
        ) from None
    if found.is_ambiguous:
        raise InputError(
            f"{tracker}: several offsets of its clock explain the motion of {file.name}, as it repeats; {remedy}"
        )
    return found


def _z_up(seen: list[Found]) -> list[Found]:
    """The proposal for positions whose y points up."""
    new = {source: (name, sign) for name, (source, sign) in Z_FROM_Y.items()}
    return [Found(item.channel, *new[item.quantity]) if item.quantity in new else item for item in seen]


def _within(
    file: Path, known: list[Found], tracker: Path, seen: list[Found], start: float, remarks: list[str]
) -> list[Found]:
    """The tracker's channels on the other clock, as far as the other recording goes."""
    times = [item.channel.t for item in known if item.quantity is not None]
    first, last = (min(t[0] for t in times), max(t[-1] for t in times)) if times else (0.0, np.inf)
    result, n_cut, n_all = [], 0, 0
    for item in seen:
        t = item.channel.t + start
        kept = (t >= first) & (t <= last)
        n_cut, n_all = (int((~kept).sum()), len(t)) if item.quantity == quantity.POSITION[0] else (n_cut, n_all)
        if kept.any():
            channel = item.channel
            result.append(replace(item, channel=Channel(channel.name, channel.unit, t[kept], channel.value[kept])))
    if not any(item.quantity in quantity.POSITION for item in result) and seen:
        raise InputError(
            f"{tracker}: begins {start:.6g} s after 0 of {file.name}, none of it between {first:.6g} and {last:.6g} s: "
            "check --tracker-start"
        )
    if n_cut:
        remarks.append(f"{tracker.name}: {n_cut} of {n_all} positions lie outside of {file.name} in time: left out")
    return result
