"""Lets a camera's frames into its chain of nodes only while the chain has room, so that all that enter are finished."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Set
from dataclasses import dataclass
from typing import Generic, TypeVar

from ltm_core.base.errors import LtmError
from ltm_ros.runtime.health import Health, cause_of

FrameT = TypeVar("FrameT")

HEARS_WITHIN = 0.4
"""Share of `finish_within` for which a frame waits for a worker that has finished none yet: DDS names it before it
hears all that it needs, and its first frame may take longer than others."""

VIEWS = 1000
"""Of a camera that are remembered."""


@dataclass
class _InFlight:
    awaited: dict[str, float]
    """Workers that have not finished with it: seconds since they were given it or last finished another."""
    whole: bool = True
    """Whether all that were awaited have finished it, as far as is known."""

    def give_up(self, workers: Set[str]) -> None:
        for worker in self.awaited.keys() & workers:
            del self.awaited[worker]
            self.whole = False


class Admission(Generic[FrameT]):
    """The door of one camera's chain. At most `capacity` frames are in flight; of the others the newest waits, or where
    the camera looks here and there, the newest of the view that was let in longest ago.

    A frame is in flight until every node has finished it that was known as a worker when it was let in. Nothing is
    asked of who works on it: a worker that goes is not awaited any more, one that finishes a later frame has done with
    those before, and one that has a frame and finishes none for `finish_within` is left out of account until it does.
    So the slowest worker that lives sets the pace, and where there is none nothing limits. One that has finished none
    yet may not hear us, so a frame waits less for it.

    Args:
        admit: takes a frame that is let in. May raise LtmError: then it is not in flight.
        workers: names of the nodes that will say when they have finished a frame, as known now.
        health: counts frames that are turned away as `shed`, notes those that some worker has not finished as
            `unfinished`; states how many are in flight, waiting and finished.
        capacity: frames in flight at most.
        finish_within: seconds.
        shed: False: all frames wait, in order, while there is room for what they hold (a recording's frames).
        size_of: bytes that a waiting frame holds.
        waiting_bytes: that waiting frames hold at most; a frame alone always has room.
        more_waits: whether further frames may be offered at once. While it says so none is let in, for a newer one may
            be among them; `idle` is called then.
        view_of: what is the same for frames that show the same.
    """

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
        """Those that were let in, longest ago first, and the number of the frame that was."""
        self._let_in_ever = 0
        self._waiting: OrderedDict[int, FrameT] = OrderedDict()
        self._held = 0
        self._in_flight: OrderedDict[int, _InFlight] = OrderedDict()
        self._late: set[str] = set()
        """Workers that let a frame grow too old, and have finished none since."""
        self._heard: set[str] = set()
        """Workers that have finished a frame since they came."""
        self._finished = 0

    def offer(self, stamp_ns: int, frame: FrameT) -> None:
        """Let a frame in, have it wait, or turn one away. Raises the last LtmError of frames that are let in."""
        self._waiting[stamp_ns] = frame
        self._held += self._size_of(frame)
        errors = self._let_in()
        if self._shed:
            while len(self._waiting) > 1:
                least = min(self._waiting, key=self._claim)
                newer = any(stamp > least for stamp in self._waiting)
                why = "a newer one waits" if newer else "an older one waits, of a view that was let in longer ago"
                self._turn_away(least, why)
        while len(self._waiting) > 1 and self._held > self._waiting_bytes:
            self._turn_away(next(iter(self._waiting)), f"{self._held >> 20} MB wait")
        self._state(errors)

    def finished(self, worker: str, stamp_ns: int) -> None:
        """A worker has finished a frame. Raises as `offer`."""
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
        """Let one frame in, now that no further one is offered at once. `prompt`: workers that have done all that they
        will do with frames in flight: what they have not finished has failed there. Raises as `offer`."""
        for frame in self._in_flight.values():
            frame.give_up(prompt)
        self._release()
        self._state(self._let_in(1))

    def tick(self, waited: float) -> None:
        """So many seconds have passed. Raises as `offer`."""
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
        """No more will be let in: those that wait are turned away."""
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
        """Of those that wait, the one with the least is turned away."""
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
        others = f"{len(self._in_flight)} are in flight (at {', '.join(awaited)})" if awaited else "others are at work"
        self._health.drop(
            "shed",
            f"the frame of stamp {stamp} ns: {why}, and {others}; slow the camera down or give it more cores",
        )

    def _state(self, errors: list[LtmError]) -> None:
        self._health.gauge("in_flight", len(self._in_flight))
        self._health.gauge("waiting", len(self._waiting))
        self._health.gauge("finished", self._finished)
        for earlier in errors[:-1]:
            self._health.drop(cause_of(earlier), str(earlier))
        if errors:
            raise errors[-1]
