# SPDX-License-Identifier: Apache-2.0
"""Decoding of arbitrary signals in arbitrary bytes against cantools."""

import math
from dataclasses import dataclass

import numpy as np
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import Q, checked, cogiro

import inertiad_core as core
from inertiad_lcm import signal_config_t

REQUIRED = ["acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z", "q_w", "q_x", "q_y", "q_z"]
REQUIRED += [f"f_{i + 1}" for i in range(8)]


@dataclass
class Layout:
    """One signal anywhere in a message of n_bytes; signals of a message may overlap: reading does not care."""

    start: int
    length: int
    big_endian: bool
    is_signed: bool
    is_float: bool
    scale: float
    offset: float
    mux_value: int | None


def dbc_start(first, big_endian):
    """DBC start bit of a signal whose first bit is `first`, counted as its byte order counts."""
    return first // 8 * 8 + 7 - first % 8 if big_endian else first


@st.composite
def layouts(draw, n_bytes, muxed):
    is_float = draw(st.booleans()) and n_bytes >= 4
    lengths = [n for n in (32, 64) if n <= 8 * n_bytes]
    length = draw(st.sampled_from(lengths)) if is_float else draw(st.integers(1, min(64, 8 * n_bytes)))
    big_endian = draw(st.booleans())
    return Layout(
        start=dbc_start(draw(st.integers(0, 8 * n_bytes - length)), big_endian),
        length=length,
        big_endian=big_endian,
        is_signed=draw(st.booleans()) or is_float,
        is_float=is_float,
        scale=draw(st.sampled_from([1, 0.5, -0.01, 1e-7, 360 / 65536, 1000])),
        offset=draw(st.sampled_from([0, -40, 0.125, 1e6])),
        mux_value=draw(st.integers(0, 7)) if muxed else None,
    )


@st.composite
def messages(draw):
    """Identifier, bytes, and per signal its layout; the multiplexer, if any, is somewhere in 3 bits."""
    n_bytes = draw(st.sampled_from([1, 2, 3, 5, 7, 8, 12, 24, 32, 48, 64]))
    muxed = draw(st.booleans())
    big_endian = draw(st.booleans())
    selector = (dbc_start(draw(st.integers(0, 8 * n_bytes - 3)), big_endian), big_endian) if muxed else None
    signals = draw(st.lists(layouts(n_bytes, muxed), min_size=1, max_size=18))
    data = draw(st.lists(st.binary(min_size=n_bytes, max_size=n_bytes), min_size=1, max_size=4))
    return n_bytes, selector, signals, data, draw(st.booleans()), draw(st.integers(0, 0x7FF))


def order(big_endian):
    return "big_endian" if big_endian else "little_endian"


def cantools_message(n_bytes, selector, signals, extended, can_id):
    found = []
    if selector is not None:
        found.append(Signal("selector", selector[0], 3, order(selector[1]), is_multiplexer=True))
    for i, s in enumerate(signals):
        mux = {} if selector is None else {"multiplexer_ids": [s.mux_value], "multiplexer_signal": "selector"}
        conversion = BaseConversion.factory(scale=s.scale, offset=s.offset, is_float=s.is_float)
        found.append(Signal(f"s{i}", s.start, s.length, order(s.big_endian), s.is_signed, conversion=conversion, **mux))
    return Message(can_id, "M", n_bytes, found, is_extended_frame=extended, is_fd=n_bytes > 8, strict=False)


def core_signal(s, quantity, n_bytes, selector, can_id):
    result = signal_config_t()
    result.quantity, result.can_id, result.frame_length = quantity, can_id, n_bytes
    result.start, result.length, result.big_endian, result.is_signed = s.start, s.length, s.big_endian, s.is_signed
    result.kind = 0 if not s.is_float else result.FLOAT32 if s.length == 32 else result.FLOAT64
    result.scale, result.offset, result.mux_start = s.scale, s.offset, -1
    if selector is not None:
        result.mux_start, result.mux_length = selector[0], 3
        result.mux_big_endian, result.mux_value = selector[1], s.mux_value
    return result


def config_with(signals):
    """CoGiRo with the first quantities bound to these signals and the others to a frame of their own."""
    config = cogiro()
    own = {s.quantity: s for s in config.signal[: config.n_signals]}
    bound = signals + [own[Q[name]] for name in REQUIRED[len(signals) :]]
    for s in bound[len(signals) :]:
        s.can_id = -(1 << 31) | 0x1FFFFFFF  # extended, used by nobody else
    config.n_signals = len(bound)
    config.signal = bound + [signal_config_t()] * (64 - len(bound))
    return checked(config)


@settings(max_examples=300, deadline=None)
@given(messages())
def test_decoded_frames_equal_cantools(message):
    n_bytes, selector, signals, data, extended, can_id = message
    reference = cantools_message(n_bytes, selector, signals, extended, can_id)
    id_field = can_id - (1 << 31) if extended else can_id
    config = config_with([core_signal(s, Q[name], n_bytes, selector, id_field)
                          for s, name in zip(signals, REQUIRED, strict=False)])  # fmt: skip
    for payload in data:
        values = core.decode_frame(config, 0, can_id | (1 << 31 if extended else 0), payload)
        expected = {}
        for i, s in enumerate(signals):
            if selector is None or core.decode_raw(payload, selector[0], 3, selector[1], False) == s.mux_value:
                # One signal at a time: cantools does not unpack multiplexers that share bits with signals.
                expected[Q[REQUIRED[i]]] = cantools_value(reference, i, payload)
        expected = {k: v for k, v in expected.items() if math.isfinite(v)}
        assert values.keys() == expected.keys()
        for k, value in expected.items():
            np.testing.assert_allclose(values[k], value, rtol=1e-14, atol=0)


def cantools_value(reference, i, payload):
    s = reference.get_signal_by_name(f"s{i}")
    alone = Signal("s", s.start, s.length, s.byte_order, s.is_signed, conversion=s.conversion)
    message = Message(1, "M", reference.length, [alone], is_fd=reference.length > 8, strict=False)
    return float(message.decode(payload, decode_choices=False)["s"])


@settings(max_examples=300, deadline=None)
@given(st.integers(1, 64).flatmap(lambda n: st.tuples(st.binary(min_size=n, max_size=n), layouts(n, False))))
def test_raw_bits_equal_cantools(case):
    data, s = case
    alone = Signal("s", s.start, s.length, order(s.big_endian), s.is_signed and not s.is_float)
    message = Message(1, "M", len(data), [alone], is_fd=len(data) > 8, strict=False)
    raw = core.decode_raw(data, s.start, s.length, s.big_endian, s.is_signed and not s.is_float)
    assert raw == message.decode(data, scaling=False, decode_choices=False)["s"] % (1 << 64)


@settings(max_examples=100, deadline=None)
@given(selector=st.integers(0, 255), values=st.lists(st.integers(0, 255), min_size=3, max_size=3, unique=True))
def test_multiplexed_frames_equal_cantools(selector, values):
    layout = [Layout(8 + 8 * i, 16, False, True, False, 0.1, -3.0, v) for i, v in enumerate(values)]
    found = [Signal("selector", 7, 8, "big_endian", is_multiplexer=True)]
    for i, s in enumerate(layout):
        conversion = BaseConversion.factory(scale=s.scale, offset=s.offset)
        found.append(Signal(f"s{i}", s.start, s.length, "little_endian", True, conversion=conversion,
                            multiplexer_ids=[s.mux_value], multiplexer_signal="selector"))  # fmt: skip
    reference = Message(5, "M", 8, found, strict=True)
    signals = [core_signal(s, Q[name], 8, (7, True), 5) for s, name in zip(layout, REQUIRED, strict=False)]
    for s in signals:
        s.mux_length = 8
    payload = bytes([selector, 1, 2, 3, 4, 5, 6, 7])
    present = core.decode_frame(config_with(signals), 0, 5, payload)
    if selector not in values:  # cantools refuses such a frame
        assert not present
        return
    expected = reference.decode(payload, decode_choices=False)
    index = values.index(selector)
    assert present.keys() == {Q[REQUIRED[index]]}
    np.testing.assert_allclose(present[Q[REQUIRED[index]]], expected[f"s{index}"], rtol=1e-14)
