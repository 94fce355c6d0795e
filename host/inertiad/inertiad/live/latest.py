# SPDX-License-Identifier: Apache-2.0
"""The newest message of each kind that a daemon sent, and a minute of its estimates."""

import time
from collections import deque
from typing import Final

from inertiad.base.body import of_message
from inertiad.live.findings import State
from inertiad.live.incoming import Decoder, finite
from inertiad_lcm import estimate_t, event_t, health_t, host_t

EVENTS_KEPT: Final = 100
HISTORY: Final = 120
HISTORY_PERIOD: Final = 0.5
"""s of the daemon's time between two estimates of the history"""
HEALTHS_KEPT: Final = 10


class Latest:
    """take() messages; read what is newest."""

    def __init__(self) -> None:
        self.estimate: estimate_t | None = None
        self.host: host_t | None = None
        self.events: deque[event_t] = deque(maxlen=EVENTS_KEPT)
        self.history: deque[tuple[float, ...]] = deque(maxlen=HISTORY)
        """ten values each, in the order of base.body"""
        self.is_heard = False
        self._healths: deque[health_t] = deque(maxlen=HEALTHS_KEPT)
        self._heard = time.monotonic()
        self._history_ns = 0
        self._decoder = Decoder()

    def take(self, channel: str, data: bytes) -> estimate_t | health_t | event_t | host_t | None:
        """Keep a message; channel without prefix. The message, or None where it is none; nothing in data raises."""
        kind = {"ESTIMATE": estimate_t, "HEALTH": health_t, "EVENT": event_t, "HOST": host_t}.get(channel)
        message = None if kind is None else self._decoder.decode(kind, data)
        if message is None:
            return None
        self._heard, self.is_heard = time.monotonic(), True
        match channel:
            case "ESTIMATE":
                self._keep_estimate(message)
            case "HEALTH":
                self._healths.append(message)
            case "EVENT":
                self.events.append(message)
            case "HOST":
                self.host = message
        return message

    def _keep_estimate(self, message: estimate_t) -> None:
        self.estimate = message
        value = of_message(message).value
        if finite(value) and not 0 <= message.t_ns - self._history_ns < 1e9 * HISTORY_PERIOD:
            self.history.append(value)
            self._history_ns = message.t_ns

    @property
    def n_undecodable(self) -> int:
        """Messages that were none of their type."""
        return self._decoder.n_undecodable

    @property
    def health(self) -> health_t | None:
        """The newest HEALTH."""
        return self._healths[-1] if self._healths else None

    @property
    def before(self) -> health_t | None:
        """The HEALTH before that, for rates."""
        return self._healths[-2] if len(self._healths) > 1 else None

    @property
    def silence(self) -> float:
        """s since the last message."""
        return time.monotonic() - self._heard

    @property
    def state(self) -> State:
        """For findings."""
        return State(self.estimate, self.health, self._healths[0] if len(self._healths) > 1 else None, self.silence)
