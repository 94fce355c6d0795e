# SPDX-License-Identifier: Apache-2.0
"""Channels of a recording with their rates and ranges, the quantity each most likely is, and the mapping as a file.

A mapping, TOML:
    [time] channel = "Zeit", unit = "ms"        both may be left out
    [channels.acc_x] channel = "IMU AccX", unit = "g", scale = 1.0, offset = 0.0
The keys of [channels] are quantities. unit: where the file gives none, or another one; scale and offset apply in SI.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Self

import numpy as np
from pydantic import model_validator

from inertiad.base import quantity, units
from inertiad.base.error import InputError
from inertiad.base.recognition import recognise
from inertiad.base.table import Table
from inertiad.base.text_files import read_toml, toml_value
from inertiad.exchange import convert, foreign_csv, foreign_messages, foreign_tables, motion_capture
from inertiad.exchange.foreign_csv import Channel
from inertiad.robot.messages import Strict, nearest_or_known, validate
from inertiad.robot.value_types import Range

NOT_MAPPED: Final = (*quantity.COUNTER, *quantity.TIME)


class Source(Strict):
    """Where a quantity comes from."""

    channel: str
    """Name of the channel in the recording."""
    unit: str | None = None
    """Its unit, where the recording gives none or a wrong one."""
    scale: Annotated[float, Range(-1e9, 1e9)] = 1.0
    """SI value = value in unit * scale + offset."""
    offset: Annotated[float, Range(-1e9, 1e9)] = 0.0
    """In SI."""


class Time(Strict):
    """The column of time."""

    channel: str | None = None
    """Its name; without it: the first column recognised as a time."""
    unit: str | None = None
    """Its unit."""


class Mapping(Strict):
    """Channels of a recording by quantity."""

    time: Time = Time()
    channels: dict[str, Source] = {}

    @model_validator(mode="after")
    def _known(self) -> Self:
        known = [name for name in quantity.QUANTITIES if name not in NOT_MAPPED]
        unknown = [name for name in self.channels if name not in known]
        if unknown:
            raise ValueError(
                "\n".join(f"channels.{name}: not a quantity{nearest_or_known(name, known)}" for name in unknown)
            )
        return self


@dataclass(frozen=True)
class Found:
    """A channel of a recording and the quantity proposed for it."""

    channel: Channel
    quantity: str | None
    scale: float = 1.0
    """proposed factor"""

    @property
    def text(self) -> str:
        """One line for people."""
        values = self.channel.value
        unit = f" {self.channel.unit}" if self.channel.unit else ""
        rate = f"{self.channel.rate:.4g} Hz"
        span = f"{np.min(values):.4g} to {np.max(values):.4g}{unit}"
        return f"{self.channel.name}: {len(values)} samples, {rate}, {span}: {self.quantity or 'not recognised'}"


def of_tables(tables: dict[str, Table]) -> list[Channel]:
    """Channels of tables with the names and units of this project."""
    chosen = [tables[name] for name in ("signals", "tracker") if name in tables]
    return [
        Channel(name, units.of(name), table.t, values.astype(float))
        for table in chosen
        for name, values in table.columns.items()
        if values.dtype.kind in "fiu"
    ]


def _foreign(path: Path, time: Time) -> list[Channel]:
    """Channels of a file of another tool."""
    ending = path.suffix.lower()
    if foreign_messages.is_bag(path):
        return foreign_messages.read_bag(path)
    if motion_capture.kind(path) is not None:
        return motion_capture.read(path)
    if ending == ".mf4":
        return foreign_tables.read_mf4(path)
    if ending == ".mcap":
        return foreign_messages.read_mcap(path)
    read = {".parquet": foreign_tables.read_parquet, ".mat": foreign_tables.read_mat}.get(ending, foreign_csv.read)
    return read(path, time.channel, time.unit)


def summary(path: Path, mapping: Mapping | None = None, dbcs: Sequence[Path] = ()) -> list[Found]:
    """Every channel of a recording with the quantity proposed for it, each quantity once.

    dbcs: of a CAN log's buses. InputError: the file cannot be read, or has nothing but CAN frames and no DBC is given.
    """
    if dbcs:
        channels = foreign_messages.read_can(path, list(dbcs))
    elif path.suffix.lower() == ".csv" or convert.is_foreign(path):
        channels = _foreign(path, (mapping or Mapping()).time)
    else:
        channels = of_tables(convert.read_file(path).tables)
        if not channels:
            raise InputError(f"{path}: only CAN frames in it: allowed: a recording of signals, or --dbc with their DBC")
    found = list(_proposed(channels))
    if motion_capture.kind(path) is not None:  # the axes of a rigid body need not be the platform's
        return [item if item.quantity in quantity.POSITION else replace(item, quantity=None) for item in found]
    return found


def by_signals(found: list[Found], bound: dict[str, str]) -> list[Found]:
    """The channels with the quantities that a robot's [signals] give them: bound is "MESSAGE.signal" -> quantity.

    found as it is where no channel is bound.
    """
    if not any(item.channel.name in bound for item in found):
        return found
    return [Found(item.channel, bound.get(item.channel.name)) for item in found]


def _proposed(channels: list[Channel]) -> Iterator[Found]:
    taken: set[str] = set()
    names = [channel.name for channel in channels]
    from_zero = any(
        recognise(name) is None and recognise(name[:-1] + "1") == "f_1" for name in names if name[-1:] == "0"
    )
    for channel in channels:
        found = recognise(channel.name, channel.unit)
        if from_zero and (shifted := _one_more(channel.name)) is not None:
            force = recognise(shifted, channel.unit)
            found = force if force is not None and force.startswith("f_") else found
        if found is None or found in ("t", "counter") or found in taken:
            yield Found(channel, None)
        else:
            taken.add(found)
            yield Found(channel, found)


def _one_more(name: str) -> str | None:
    """A name with the number at its end raised by one; None: it has none."""
    head = name.rstrip("0123456789")
    return f"{head}{int(name[len(head) :]) + 1}" if head != name else None


def n_forces(found: list[Found]) -> int:
    """Number of cables whose forces a recording holds."""
    return max((int(f.quantity[2:]) for f in found if f.quantity and f.quantity.startswith("f_")), default=0)


def rate_of(found: list[Found], name: str) -> float | None:
    """Hz of a quantity's channel, to four digits; None: there is none."""
    rates = [f.channel.rate for f in found if f.quantity == name]
    return float(f"{rates[0]:.4g}") if rates else None


def _guessed_unit(channel: Channel, name: str) -> tuple[str, str]:
    """Unit of a channel without one, and the reason: from the size of its values where they tell."""
    size = float(np.percentile(np.abs(channel.value), 95))
    dimension = quantity.dimension(name)
    if dimension == "length" and size > 100.0:
        return "mm", "values above 100"
    if dimension == "rate" and size > 20.0:
        return "deg/s", "values above 20"
    if dimension == "angle" and size > 2.0 * np.pi:
        return "deg", "values above 2 pi"
    return {"acceleration": "m/s2", "rate": "rad/s", "angle": "rad", "length": "m", "force": "N"}.get(dimension, ""), ""


def _accelerations_in_g(found: list[Found]) -> bool:
    """Whether accelerometers without a unit have 1, not 9.81, as their usual length."""
    axes = [f.channel.value for f in found if f.quantity in quantity.ACC and not f.channel.unit]
    if len(axes) < 3 or len({len(axis) for axis in axes}) > 1:
        return False
    return 0.3 < float(np.median(np.linalg.norm(axes, axis=0))) < 3.0


def unit_of(item: Found, in_g: bool) -> tuple[str, str]:
    """Unit of a recognised channel, and the reason for it: "" where the file gives it."""
    name, channel = item.quantity, item.channel
    if channel.unit or name is None:
        return channel.unit, ""
    if in_g and name in quantity.ACC:
        return "g", "usual length 1"
    unit, reason = _guessed_unit(channel, name)
    return unit, reason or "nothing against it"


def unit_remarks(found: list[Found]) -> list[str]:
    """Units that were assumed, a line per unit and reason."""
    in_g, assumed = _accelerations_in_g(found), dict[tuple[str, str], list[str]]()
    for item in found:
        unit, reason = unit_of(item, in_g)
        if item.quantity is not None and reason and unit:
            assumed.setdefault((unit, reason), []).append(item.quantity)
    return [
        f"no unit in the file: {unit} assumed for {', '.join(names)} ({reason})"
        for (unit, reason), names in assumed.items()
    ]


def mapping_text(path: Path, found: list[Found], options: str = "") -> str:
    """The proposed mapping of a recording as TOML, with every channel it has as a comment.

    options: of import besides those that every mapping needs.
    """
    in_g = _accelerations_in_g(found)
    lines = [f"# Mapping of the channels of {path.name} to quantities; check units, then:"]
    command = f"inertiactl import {path.name} --map run/{path.stem}.map.toml --robot robot.toml{options} -o run"
    lines += [f"# {command}", ""]
    for item in found:
        name, channel = item.quantity, item.channel
        lines.append(f"# {item.text}")
        if name is None:
            continue
        unit, reason = unit_of(item, in_g)
        note = f"  # the file gives no unit; assumed: {reason}" if reason and unit else ""
        lines += [f"[channels.{name}]", f"channel = {toml_value(channel.name)}", f"unit = {toml_value(unit)}{note}"]
        lines += [f"scale = {item.scale!r}"] if item.scale != 1.0 else []
    return "\n".join(lines) + "\n"


def read_mapping(path: Path) -> Mapping:
    """A mapping file. InputError: a line per mistake."""
    return validate(Mapping, read_toml(path), str(path))


def proposed_mapping(path: Path, found: list[Found]) -> Mapping:
    """The mapping of mapping_text()."""
    import tomllib

    return validate(Mapping, tomllib.loads(mapping_text(path, found)), f"{path}: proposed mapping")


def mapped(path: Path, found: list[Found], mapping: Mapping) -> dict[str, Channel]:
    """Each quantity of a mapping over its own time, SI. InputError: no such channel, or a unit of something else."""
    by_name = {item.channel.name: item.channel for item in found}
    result, wrong = {}, []
    for name, source in mapping.channels.items():
        channel = by_name.get(source.channel)
        if channel is None:
            wrong.append(
                f'{path}: {name}: no channel "{source.channel}"{nearest_or_known(source.channel, list(by_name))}'
            )
            continue
        unit = channel.unit if source.unit is None else source.unit
        try:
            factor = units.unit_factor(unit, quantity.dimension(name))
        except KeyError as error:
            wrong.append(
                f'{path}: {name}: unit "{unit}" of "{source.channel}": allowed: {error.args[0]}; name it in --map'
            )
            continue
        result[name] = Channel(name, "", channel.t, channel.value * factor * source.scale + source.offset)
    if wrong:
        raise InputError(*wrong)
    return result
