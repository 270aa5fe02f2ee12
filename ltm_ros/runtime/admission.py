"""Admit a camera's frames to its nodes only while they have room, so that every admitted frame is finished."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Set
from dataclasses import dataclass
from typing import Generic, TypeVar

from ltm_core.base.errors import LtmError
from ltm_ros.runtime.health import Health, cause_of

FrameT = TypeVar("FrameT")

HEARS_WITHIN = 0.4
"""Share of `finish_within` that a frame waits for a worker without any finished frame: DDS names it before it receives
everything, and its first frame may take longer."""

VIEWS = 1000
"""Number of remembered views per camera."""


@dataclass
class _InFlight:
    awaited: dict[str, float]
    """Workers that have not finished it: seconds since they received it or finished another."""
    whole: bool = True
    """Whether all awaited workers have finished it, as far as is known."""

    def give_up(self, workers: Set[str]) -> None:
        for worker in self.awaited.keys() & workers:
            del self.awaited[worker]
            self.whole = False


class Admission(Generic[FrameT]):
    """Admission of one camera's frames. At most `capacity` frames are in flight. Of the others the newest waits, or for
    a moving camera, the newest of the view that was admitted longest ago.

    A frame is in flight until every worker that was known at its admission has finished it. A worker that disappears is
    not awaited any more; one that finishes a later frame has finished all earlier ones; one that finishes no frame for
    `finish_within` is ignored until it does. So the slowest living worker sets the pace, and without workers there is
    no limit. A worker without any finished frame may not receive messages yet, so a frame waits less for it.

    Args: admit: takes an admitted frame. May raise LtmError: then it is not in flight. workers: names of the nodes that
    acknowledge frames, as known now. health: counts dropped frames as `shed` and unfinished ones as `unfinished`;
    states the numbers in flight, waiting and finished. capacity: maximum number of frames in flight. finish_within:
    seconds. shed: False: all frames wait in order, up to `waiting_bytes` (for recordings). size_of: bytes of a waiting
    frame. waiting_bytes: maximum of all waiting frames; a single frame is always accepted. more_waits: whether further
    frames follow at once; meanwhile none is admitted, because a newer one may follow, and `idle` is called then.
    view_of: returns equal values for frames of the same view."""

    def __init__(
        self,
        admit: Callable[[FrameT], None],
        workers: Callable[[], Set[str]],
        health: Health,
        capacity: int,
        finish_within: float,
        shed: bool,
        size_of: Callable[[FrameT], int],
        waiting_bytes: int,
        more_waits: Callable[[], bool] = bool,
        view_of: Callable[[FrameT], Hashable] = lambda _: None,
    ) -> None:
        self._admit, self._workers, self._health = admit, workers, health
        self._capacity, self._finish_within, self._shed = capacity, finish_within, shed
        self._size_of, self._waiting_bytes = size_of, waiting_bytes
        self._more_waits, self._view_of = more_waits, view_of
        self._views: OrderedDict[Hashable, int] = OrderedDict()
        """Admitted views, longest ago first, with the number of the frame."""
        self._let_in_ever = 0
        self._waiting: OrderedDict[int, FrameT] = OrderedDict()
        self._held = 0
        self._in_flight: OrderedDict[int, _InFlight] = OrderedDict()
        self._late: set[str] = set()
        """Workers that exceeded the time limit and have finished no frame since."""
        self._heard: set[str] = set()
        """Workers that have finished a frame since they appeared."""
        self._finished = 0

    def offer(self, stamp_ns: int, frame: FrameT) -> None:
        """Admit a frame, queue it, or drop one. Raises the last LtmError of admitted frames."""
        self._waiting[stamp_ns] = frame
        self._held += self._size_of(frame)
        errors = self._let_in()
        if self._shed:
            while len(self._waiting) > 1:
                least = min(self._waiting, key=self._claim)
                newer = any(stamp > least for stamp in self._waiting)
                why = (
                    "a newer one is queued"
                    if newer
                    else "an older one is queued, of a view that was admitted longer ago"
                )
                self._turn_away(least, why)
        while len(self._waiting) > 1 and self._held > self._waiting_bytes:
            self._turn_away(next(iter(self._waiting)), f"{self._held >> 20} MB are queued")
        self._state(errors)

    def finished(self, worker: str, stamp_ns: int) -> None:
        """Record that a worker has finished a frame. Raises as `offer`."""
        self._late.discard(worker)
        self._heard.add(worker)
        if stamp_ns in self._in_flight:
            self._in_flight[stamp_ns].awaited.pop(worker, None)
            for stamp in list(self._in_flight):
                if stamp == stamp_ns:
                    break
                self._in_flight[stamp].give_up({worker})
            for frame in self._in_flight.values():
                if worker in frame.awaited:
                    frame.awaited[worker] = 0.0
            self._release()
        self._state(self._let_in())

    def idle(self, prompt: Set[str]) -> None:
        """Admit one frame, now that none follows at once. `prompt`: workers that are done with all frames in flight;
        frames that they have not finished have failed there. Raises as `offer`."""
        for frame in self._in_flight.values():
            frame.give_up(prompt)
        self._release()
        self._state(self._let_in(1))

    def tick(self, waited: float) -> None:
        """Advance time by `elapsed_s` seconds. Raises as `offer`."""
        there = self._workers() if self._in_flight else set()
        if self._in_flight:
            self._heard &= there
        for stamp, frame in self._in_flight.items():
            frame.give_up(frame.awaited.keys() - there)
            frame.awaited = {worker: silent + waited for worker, silent in frame.awaited.items()}
            new = frame.awaited.keys() - self._heard
            frame.give_up({worker for worker in new if frame.awaited[worker] > HEARS_WITHIN * self._finish_within})
            late = {worker for worker, silent in frame.awaited.items() if silent > self._finish_within}
            if late - self._late:
                self._health.trouble(
                    "unfinished",
                    f"{', '.join(sorted(late))} did not finish the frame of stamp {stamp} ns, nor any other, within "
                    f"{self._finish_within:g} s; see their diagnostics, or raise finish_within of capture",
                )
            self._late |= late
        for frame in self._in_flight.values():
            frame.give_up(self._late)
        self._release()
        self._state(self._let_in())

    def finish(self) -> None:
        """Admit no more frames, and drop the queued ones."""
        for stamp in list(self._waiting):
            self._turn_away(stamp, "the node ended")
        self._state([])

    def _let_in(self, most: int | None = None) -> list[LtmError]:
        errors: list[LtmError] = []
        if self._more_waits():
            return errors
        left = most
        while self._waiting and len(self._in_flight) < self._capacity and left != 0:
            stamp, frame = self._waiting.popitem(last=False)
            self._held -= self._size_of(frame)
            awaited = dict.fromkeys(self._workers() - self._late, 0.0)
            try:
                self._admit(frame)
            except LtmError as error:
                errors.append(error)
                continue
            left = None if left is None else left - 1
            self._note_view(frame)
            if awaited:
                self._in_flight[stamp] = _InFlight(awaited)
        return errors

    def _claim(self, stamp: int) -> tuple[int, int]:
        """Take a place in the queue; the frame with the lowest priority is dropped."""
        return -self._views.get(self._view_of(self._waiting[stamp]), 0), stamp

    def _note_view(self, frame: FrameT) -> None:
        self._let_in_ever += 1
        view = self._view_of(frame)
        self._views[view] = self._let_in_ever
        self._views.move_to_end(view)
        if len(self._views) > VIEWS:
            self._views.popitem(last=False)

    def _release(self) -> None:
        for stamp in [stamp for stamp, frame in self._in_flight.items() if not frame.awaited]:
            if self._in_flight.pop(stamp).whole:
                self._finished += 1
            else:
                self._health.note("unfinished")

    def _turn_away(self, stamp: int, why: str) -> None:
        self._held -= self._size_of(self._waiting.pop(stamp))
        awaited = sorted({worker for frame in self._in_flight.values() for worker in frame.awaited})
        others = (
            f"{len(self._in_flight)} are in flight (at {', '.join(awaited)})" if awaited else "others are in flight"
        )
        self._health.drop(
            "shed",
            f"the frame of stamp {stamp} ns: {why}, and {others}; reduce the frame rate or add cores",
        )

    def _state(self, errors: list[LtmError]) -> None:
        self._health.gauge("in_flight", len(self._in_flight))
        self._health.gauge("waiting", len(self._waiting))
        self._health.gauge("finished", self._finished)
        for earlier in errors[:-1]:
            self._health.drop(cause_of(earlier), str(earlier))
        if errors:
            raise errors[-1]


class RepeatCheck:
    """Detects repeated images of one camera, in order of arrival."""

    def __init__(self) -> None:
        self._last = ""

    def repeats(self, content: str) -> bool:
        """Return whether an image equals the previous one; `content`: its digest. Sensor noise makes working cameras'
        images differ."""
        same, self._last = content == self._last, content
        return same
