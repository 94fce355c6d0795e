# SPDX-License-Identifier: Apache-2.0
"""What listeners are to see: items of several kinds, a bounded number of each, encoded once for all listeners."""

import json
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any, Final

NONE_SEEN: Final = 0


class Feed:
    """Rings of items in the order in which they came. Any thread may put and wait."""

    def __init__(self, kept: Mapping[str, int]) -> None:
        """kept: number of items that each kind keeps for a listener that comes late."""
        self._ring: dict[str, deque[tuple[int, str]]] = {kind: deque(maxlen=n) for kind, n in kept.items()}
        self._news = threading.Condition()
        self._number = NONE_SEEN
        self._waiting = 0
        """number of the newest item when announce() was last called"""

    def put(self, kind: str, **item: Any) -> None:
        """Add an item of finite numbers, text, lists and None; listeners see it at the next announce()."""
        text = json.dumps({"kind": kind, **item}, separators=(",", ":"), allow_nan=False)
        with self._news:
            self._number += 1
            self._ring[kind].append((self._number, text))

    def clear(self, *kinds: str) -> None:
        """Forget the items of these kinds."""
        with self._news:
            for kind in kinds:
                self._ring[kind].clear()

    def announce(self) -> None:
        """Wake the listeners."""
        with self._news:
            self._waiting = self._number
            self._news.notify_all()

    def since(self, seen: int, patience: float) -> tuple[str, int]:
        """JSON array of all items after number `seen`, and the number of the last; waits for one up to `patience` s."""
        with self._news:
            self._news.wait_for(lambda: self._waiting > seen, patience)
            last = self._waiting
            new = [item for ring in self._ring.values() for item in _after(ring, seen) if item[0] <= last]
        new.sort()
        return f"[{','.join(text for _, text in new)}]", last


def _after(ring: deque[tuple[int, str]], seen: int) -> list[tuple[int, str]]:
    found = []
    for item in reversed(ring):
        if item[0] <= seen:
            break
        found.append(item)
    return found
