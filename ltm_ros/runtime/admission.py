"""Admit a camera's frames to its nodes one at a time: while they work, only the newest waits."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

from ltm_ros.runtime.health import Health

FrameT = TypeVar("FrameT")


class Admission(Generic[FrameT]):
    """Admission of one camera's frames; they wait while further ones follow at once, because these are newer.

    Args: admit: takes an admitted frame. health: counts dropped frames as `shed` and states the number waiting. shed:
    False: all frames wait in order, up to `waiting_bytes` (for recordings). size_of: bytes of a waiting frame.
    waiting_bytes: maximum of all waiting frames; a single frame is always accepted. more_waits: whether further frames
    follow at once; `idle` is called then."""

    def __init__(
        self,
        admit: Callable[[FrameT], None],
        health: Health,
        shed: bool,
        size_of: Callable[[FrameT], int],
        waiting_bytes: int,
        more_waits: Callable[[], bool],
    ) -> None:
        self._admit, self._health, self._shed = admit, health, shed
        self._size_of, self._waiting_bytes, self._more_waits = size_of, waiting_bytes, more_waits
        self._waiting: OrderedDict[int, FrameT] = OrderedDict()

    def offer(self, stamp_ns: int, frame: FrameT) -> None:
        """Admit a frame, or queue it and drop older ones. Raises the error of `admit`."""
        if not self._more_waits():
            self._admit(frame)
            return
        self._waiting[stamp_ns] = frame
        while len(self._waiting) > 1:
            held = sum(map(self._size_of, self._waiting.values()))
            if self._shed:
                self._drop(min(self._waiting), "a newer one is queued; reduce the frame rate or add cores")
            elif held > self._waiting_bytes:
                self._drop(next(iter(self._waiting)), f"{held >> 20} MB are queued; reduce the frame rate or add cores")
            else:
                break
        self._health.gauge("waiting", len(self._waiting))

    def idle(self) -> None:
        """Admit one frame, now that none follows at once. Raises as `offer`."""
        if self._waiting:
            _, frame = self._waiting.popitem(last=False)
            self._health.gauge("waiting", len(self._waiting))
            self._admit(frame)

    def finish(self) -> None:
        """Drop the queued frames."""
        for stamp in list(self._waiting):
            self._drop(stamp, "the node ended")
        self._health.gauge("waiting", 0)

    def _drop(self, stamp: int, why: str) -> None:
        del self._waiting[stamp]
        self._health.drop("shed", f"the frame of stamp {stamp} ns: {why}")
