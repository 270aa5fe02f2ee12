"""Joins messages of several topics on equal stamps."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any

from ltm_ros.runtime.health import Health


class StampJoin:
    """Collects one message a topic for each stamp and hands complete sets on, each once.

    Derived messages carry their source's stamp, so equality is the whole rule. At most `capacity` incomplete sets
    wait; then the oldest is dropped and counted as `unjoined`, naming what was missing.
    """

    def __init__(self, names: Sequence[str], complete: Callable[..., None], health: Health, capacity: int = 30) -> None:
        self._names = tuple(names)
        self._complete = complete
        self._health = health
        self._capacity = capacity
        self._waiting: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self._done: OrderedDict[int, None] = OrderedDict()

    def add(self, name: str, stamp_ns: int, message: Any) -> None:
        """Take a message; calls `complete(**{name: message})` when its set is whole."""
        if stamp_ns in self._done or name in self._waiting.get(stamp_ns, ()):
            self._health.drop("duplicate", f"a second {name} of stamp {stamp_ns} ns; stamps must be unique a camera")
            return
        parts = self._waiting.setdefault(stamp_ns, {})
        parts[name] = message
        if len(parts) == len(self._names):
            del self._waiting[stamp_ns]
            self._done[stamp_ns] = None
            if len(self._done) > 4 * self._capacity:
                self._done.popitem(last=False)
            self._complete(**parts)
        elif len(self._waiting) > self._capacity:
            oldest, parts = self._waiting.popitem(last=False)
            self._report(oldest, parts)

    def finish(self) -> None:
        """Count what is still incomplete as dropped."""
        while self._waiting:
            self._report(*self._waiting.popitem(last=False))

    def _report(self, stamp_ns: int, parts: dict[str, Any]) -> None:
        missing = ", ".join(name for name in self._names if name not in parts)
        self._health.drop("unjoined", f"stamp {stamp_ns} ns never got its {missing}")
