"""Join messages of several topics into frames by their stamps."""

from collections import OrderedDict, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ltm_core.base.errors import LtmError
from ltm_core.site.sections import MessageLimits
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.handler import ConfigT, Handler, NodeConfig, Topic
from ltm_ros.runtime.health import Health, cause_of

WAITING_BYTES = MessageLimits().waiting_bytes
REMEMBERED = 1000
"""Number of finished frames whose duplicates are detected, and of messages of a part that is matched by nearness."""


class JoinConfig(NodeConfig):
    """Parameters of a node that joins the results of other nodes for a frame."""

    max_wait: float = Field(60.0, gt=0)
    """Seconds for which a frame waits for its parts: longer than the slowest node is late on a busy machine, or
    restarts."""


MAX_GAP_NS = 250_000_000
"""Maximum time in nanoseconds between two messages to interpolate between."""


class Match(Enum):
    """Rule that selects the message of a part for a frame's stamp."""

    EXACT = "the one of equal stamp"
    NEAREST = "one between those around the frame if `Part.between` is given, else the nearest within a tolerance"
    LATEST = "the newest up to the frame's stamp, or the first there is"


@dataclass(frozen=True)
class Part:
    """A part of a frame.

    `tolerance_ns`: of `Match.NEAREST`. `between`: interpolates two messages around a frame, at most `MAX_GAP_NS` apart,
    at a share of the way. `wait_s`: seconds for which a frame that has all else waits for this part before
    it continues without; None: the part is required. `remembered`: messages kept of a part that begins no frames.
    `topic`: of its messages, for subscriptions and reports."""

    name: str
    match: Match = Match.EXACT
    tolerance_ns: int = 0
    wait_s: float | None = None
    remembered: int = REMEMBERED
    between: Callable[[Any, Any, float], Any] | None = None
    topic: Topic | None = None

    @property
    def shown(self) -> str:
        """Return topic and type, or the name without a topic."""
        return self.name if self.topic is None else f"{self.topic.name} ({type_name_of(self.topic.type())})"

    @property
    def begins(self) -> bool:
        """Return whether a message begins a frame, because it belongs to exactly one."""
        return self.match is Match.EXACT and self.wait_s is None


@dataclass
class _FrameParts:
    parts: dict[str, Any] = field(default_factory=dict)
    waited: float = 0.0
    """Seconds since its first message."""
    lacking_optional: float = 0.0
    """Seconds since it had all required parts."""
    whole: bool = False


def data_bytes(message: Any) -> int:
    """Return the bytes of a message's `data`."""
    return len(getattr(message, "data", ()))


def _held(messages: Mapping[Any, Any]) -> int:
    return sum(map(data_bytes, messages.values()))


class StampJoin:
    """Collects the parts of each frame and passes complete frames on, each once.

    Derived messages carry their source's stamp, so stamps are equal by default; a part may be matched otherwise
    (`Match`), or be optional (`Part.wait_s`). At most `capacity` frames wait, `whole_capacity` of them only for
    optional parts, none longer than `max_wait` seconds, and all with at most `capacity_bytes` of data; a single message
    is always accepted.

    Args: parts: the parts of a frame; a name, also with its topic, is a required part of equal stamp. complete: takes
    `**{name: message}`; None for a missing optional part. May raise LtmError. health: counts duplicates, and incomplete
    frames as `unjoined`. give_up: called instead of `health` for an incomplete frame: its stamp, its missing parts, and
    why it no longer waits. camera: camera of the frames, if the node has several."""

    def __init__(
        self,
        parts: Mapping[str, Topic] | Sequence[Part | str],
        complete: Callable[..., None],
        health: Health,
        capacity: int = 30,
        whole_capacity: int = 30,
        max_wait: float = JoinConfig.model_fields["max_wait"].default,
        give_up: Callable[[int, list[str], str], None] | None = None,
        capacity_bytes: int = WAITING_BYTES,
        camera: str = "",
    ) -> None:
        if isinstance(parts, Mapping):
            parts = [Part(name, topic=topic) for name, topic in parts.items()]
        self._parts = {p.name: p for p in (Part(p) if isinstance(p, str) else p for p in parts)}
        self._complete, self._health = complete, health
        self._capacity, self._whole_capacity, self._max_wait = capacity, whole_capacity, max_wait
        self._capacity_bytes, self._camera = capacity_bytes, camera
        self._give_up = self._count_unjoined if give_up is None else give_up
        self._waiting: OrderedDict[int, _FrameParts] = OrderedDict()
        # In one block of memory: a set's small blocks would fragment the heap.
        self._done: NDArray[np.int64] = np.full(REMEMBERED, np.iinfo(np.int64).min)
        self._finished = 0
        self._memory: dict[str, OrderedDict[int, Any]] = {
            name: OrderedDict() for name, part in self._parts.items() if not part.begins
        }

    @property
    def subscriptions(self) -> dict[Topic, Callable[[Any], None]]:
        """Return the topics of the parts, with callbacks that add their messages."""
        return {p.topic: partial(self._add_stamped, p.name) for p in self._parts.values() if p.topic is not None}

    def _add_stamped(self, name: str, message: Any) -> None:
        self.add(name, stamp_of(message), message)

    def known(self, name: str, stamp_ns: int) -> bool:
        """Return whether a message of this part and stamp would be a duplicate."""
        frame = self._waiting.get(stamp_ns)
        has = name in frame.parts if frame is not None else bool((self._done == stamp_ns).any())
        return self._parts[name].begins and has

    def add(self, name: str, stamp_ns: int, message: Any) -> None:
        """Add a message and complete each frame that has all parts. Raises the last of their errors."""
        part = self._parts[name]
        if self.known(name, stamp_ns):
            why = f"a second {part.shown} of stamp {stamp_ns} ns; stamps of a camera must be unique"
            self._health.drop("duplicate", why)
            return
        if part.begins:
            self._waiting.setdefault(stamp_ns, _FrameParts()).parts[name] = message
        else:
            memory = self._memory[name]
            memory[stamp_ns] = message
            while len(memory) > part.remembered or (len(memory) > 1 and _held(memory) > self._capacity_bytes):
                memory.popitem(last=False)
        concerned = [stamp_ns] if part.match is Match.EXACT else sorted(self._waiting)
        self._complete_ready([stamp for stamp in concerned if stamp in self._waiting])

    def discard(self, stamp_ns: int) -> None:
        """Forget a frame that is counted elsewhere."""
        self._waiting.pop(stamp_ns, None)

    def tick(self, waited: float) -> None:
        """Advance time: old frames continue without optional parts, or are dropped."""
        for stamp, frame in list(self._waiting.items()):
            frame.waited += waited
            frame.lacking_optional += waited if frame.whole else 0.0
            if not frame.whole and frame.waited > self._max_wait:
                self._drop(stamp, f"waited {self._max_wait:g} s")
        self._complete_ready(list(self._waiting))

    def finish(self) -> None:
        """Finish: frames that lack only optional parts continue, the others are dropped."""
        self._complete_ready(list(self._waiting), at_once=True)
        for stamp in list(self._waiting):
            self._drop(stamp, "the recording or the node ended")

    def _complete_ready(self, stamps: Sequence[int], at_once: bool = False) -> None:
        errors = [self._try(stamp, at_once) for stamp in stamps]
        whole = [stamp for stamp, frame in self._waiting.items() if frame.whole]
        errors += [self._try(stamp, True) for stamp in whole[: max(0, len(whole) - self._whole_capacity)]]
        incomplete = sorted(stamp for stamp, frame in self._waiting.items() if not frame.whole)
        for stamp in incomplete[: max(0, len(incomplete) - self._capacity)]:
            self._drop(stamp, f"{self._capacity} later ones are queued")
        held = {stamp: _held(frame.parts) for stamp, frame in self._waiting.items()}
        while len(held) > 1 and sum(held.values()) > self._capacity_bytes:
            del held[oldest := min(held)]  # whatever it lacks
            self._drop(oldest, f"later ones with {sum(held.values()) >> 20} MB of data are queued")
        _raise_last(errors, self._health)

    def _try(self, stamp: int, at_once: bool) -> LtmError | None:
        """Complete the frame if it has its required parts, and no optional part must be waited for; return its
        error."""
        frame = self._waiting[stamp]
        found = frame.parts | {name: self._matched(name, stamp) for name in self._memory}
        missing = [part for name, part in self._parts.items() if found.get(name) is None]
        frame.whole = all(part.wait_s is not None for part in missing)
        patience = max((part.wait_s or 0.0 for part in missing), default=0.0)
        if not frame.whole or not (at_once or patience == 0.0 or frame.lacking_optional > patience):
            return None
        del self._waiting[stamp]
        self._done[self._finished % REMEMBERED] = stamp
        self._finished += 1
        for name, memory in self._memory.items():
            if self._parts[name].match is Match.EXACT:
                memory.pop(stamp, None)
        try:
            self._complete(**{name: found.get(name) for name in self._parts})
        except LtmError as error:
            return error
        return None

    def _matched(self, name: str, stamp: int) -> Any:
        part, memory = self._parts[name], self._memory[name]
        if part.match is Match.EXACT or stamp in memory or not memory:
            return memory.get(stamp)
        before = max((other for other in memory if other < stamp), default=None)
        if part.match is Match.LATEST:
            return memory[min(memory) if before is None else before]
        after = min((other for other in memory if other > stamp), default=None)
        if part.between is not None and before is not None and after is not None and after <= before + MAX_GAP_NS:
            return part.between(memory[before], memory[after], (stamp - before) / (after - before))
        # A nearer one may still come until there is one from after the frame.
        nearest = min(memory, key=lambda other: abs(other - stamp))
        return memory[nearest] if after is not None and abs(nearest - stamp) <= part.tolerance_ns else None

    def _drop(self, stamp: int, why: str) -> None:
        frame = self._waiting.pop(stamp)
        found = frame.parts | {name: self._matched(name, stamp) for name in self._memory}
        lacking = [name for name, part in self._parts.items() if part.wait_s is None and found.get(name) is None]
        self._give_up(stamp, lacking, why)

    def _count_unjoined(self, stamp: int, lacking: list[str], why: str) -> None:
        whose, key = (f"{self._camera}: ", f"{self._camera}.") if self._camera else ("", "")
        parts = ", ".join(self._parts[name].shown for name in lacking)
        self._health.drop("unjoined", f"{whose}stamp {stamp} ns is incomplete, without {parts} ({why})")
        for name in lacking:
            self._health.note(f"unjoined.{key}{name}")


class JoiningHandler(Handler[ConfigT]):
    """A handler that works on frames; subclasses set `_joins`, which collect them."""

    _joins: Sequence[StampJoin]

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        found: defaultdict[Topic, list[Callable[[Any], None]]] = defaultdict(list)
        for join in self._joins:
            for topic, take in join.subscriptions.items():
                found[topic].append(take)
        return {topic: partial(_each, self.health, takes) for topic, takes in found.items()}

    def discard(self, stamp_ns: int) -> None:
        for join in self._joins:
            join.discard(stamp_ns)

    def tick(self, waited: float) -> None:
        _each(self.health, [join.tick for join in self._joins], waited)

    def finish(self) -> None:
        _each(self.health, [join.finish for join in self._joins])


def _each(health: Health, calls: Sequence[Callable[..., None]], *given: Any) -> None:
    """Make all calls: an error in one camera's frame must not keep the others' from going on."""
    errors: list[LtmError | None] = []
    for call in calls:
        try:
            call(*given)
        except LtmError as error:
            errors.append(error)
    _raise_last(errors, health)


def _raise_last(errors: Sequence[LtmError | None], health: Health) -> None:
    """Raise the last of the errors, which its caller counts; count the earlier ones."""
    raised = [error for error in errors if error is not None]
    for earlier in raised[:-1]:
        health.drop(cause_of(earlier), str(earlier))
    if raised:
        raise raised[-1]
