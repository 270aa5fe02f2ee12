"""Bounded caches of a tracer between frames: horizon profiles of positions, and ranges of fixed cameras."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

_Value = TypeVar("_Value")


@dataclass(frozen=True)
class TracerStatistics:
    """Counts since the tracer was made, and what it holds.

    A frame is a hit of `frame_hits` where camera and pose were as before, so that nothing was traced; a hit of
    `profile_hits` where all of the position's profile that it needs was there.
    """

    frames: int = 0
    frame_hits: int = 0
    profile_hits: int = 0
    profile_bytes: int = 0
    frame_bytes: int = 0


class BoundedCache(Generic[_Value]):
    """Values by key, of which the least recently used go when together they exceed `most_bytes`. Thread-safe."""

    def __init__(self, most_bytes: int, size_of: Callable[[_Value], int]) -> None:
        self._most = most_bytes
        self._size_of = size_of
        self._values: OrderedDict[Hashable, _Value] = OrderedDict()
        self._held = 0
        self._lock = threading.Lock()

    @property
    def held_bytes(self) -> int:
        """Memory that the values take now."""
        return self._held

    def get(self, key: Hashable) -> _Value | None:
        """The value, now the most recently used; None where there is none."""
        with self._lock:
            if key not in self._values:
                return None
            self._values.move_to_end(key)
            return self._values[key]

    def put(self, key: Hashable, value: _Value) -> None:
        """Keep or replace a value; one that alone exceeds the bound is not kept."""
        with self._lock:
            if key in self._values:
                self._held -= self._size_of(self._values.pop(key))
            self._values[key] = value
            self._held += self._size_of(value)
            while self._held > self._most:
                _, oldest = self._values.popitem(last=False)
                self._held -= self._size_of(oldest)
