"""`label_head: auto`: which of the heads there are is for what a camera sees, told by its last pictures.

Each picture has log odds for each head against the network's own (`picture_domain`); what counts is their mean over the
pictures of the last while, a minute apart, so that clouds and passing light do not change the head from one frame to
the next. The same pictures, with the same stamps, from the same first one on, give the same heads.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Sequence
from typing import Final

import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Float64Array
from ltm_core.vision.label_head import LabelHead
from ltm_core.vision.manifest import SHIPPED_LABEL_HEAD
from ltm_core.vision.picture_domain import DomainSpace

_APART: Final = 60.0  # seconds, of pictures that are remembered: what follows shows the same
_REMEMBERED: Final = 36
LIKELIER: Final = 0.1
"""By which another head's mean log odds must exceed those of the present one; at first that is the network's own, for a
head is worse than none on other kinds of land."""


class HeadChoice:
    """Chooses among heads that say where their photos lie (`heads_to_choose`); None stands for the network's own,
    `landscape`, which is taken where no head is clearly likelier."""

    def __init__(self, space: DomainSpace, heads: Sequence[LabelHead]) -> None:
        self._space = space
        self.heads = tuple(heads)
        self._seen: deque[Float64Array] = deque(maxlen=_REMEMBERED)
        self._last = -np.inf
        self._present = 0

    @property
    def maps(self) -> tuple[str, ...]:
        """Names of the maps that it and any of its heads read."""
        return tuple(dict.fromkeys([self._space.map, *(name for head in self.heads for name in head.maps)]))

    @property
    def described(self) -> str:
        """Among how many it chooses, and their common checksum; once pictures came in their order, which it is."""
        every = hashlib.sha256("".join([self._space.checksum, *(h.described for h in self.heads)]).encode())
        among = f"auto of {len(self.heads)} heads {every.hexdigest()[:12]}"
        if not self._seen:
            return among
        head = self.present
        return f"{among}: {SHIPPED_LABEL_HEAD if head is None else head.described}"

    @property
    def present(self) -> LabelHead | None:
        """The head that the pictures up to now speak for."""
        return ([None, *self.heads])[self._present]

    @property
    def told(self) -> str:
        """The present head and the log odds of all, for diagnostics."""
        name = SHIPPED_LABEL_HEAD if self.present is None else self.present.name
        if not self._seen:
            return name
        odds = zip(self.heads, np.mean(self._seen, axis=0)[1:], strict=True)
        return f"{name} (log odds: {', '.join(f'{head.name} {value:.2f}' for head, value in odds)})"

    def odds(self, maps: dict[str, Float32Array], land: BoolArray) -> Float64Array | None:
        """(1 + heads,) log odds of a picture by the network's maps and where it shows land (H, W); the first, of the
        network's own, is 0. None where it shows too little. Raises ModelError as `DomainSpace.point` does."""
        point = self._space.point(maps[self._space.map], land)
        if point is None:
            return None
        return np.array([0.0, *(h.domain.log_odds(point) for h in self.heads if h.domain is not None)])

    def alone(self, odds: Float64Array | None) -> LabelHead | None:
        """The head for one picture by itself; nothing is remembered of it."""
        return None if odds is None else ([None, *self.heads])[_likelier(odds, 0)]

    def look(self, odds: Float64Array | None, seconds: float) -> LabelHead | None:
        """The head for a picture of that time, which comes after those that were looked at before; where time goes
        back, these are forgotten. A picture that shows too little has the present head."""
        if seconds < self._last:
            self._seen.clear()
            self._present, self._last = 0, -np.inf
        if odds is not None and seconds - self._last >= _APART:
            self._last = seconds
            self._seen.append(odds)
            self._present = _likelier(np.mean(self._seen, axis=0), self._present)
        return self.present


def _likelier(odds: Float64Array, present: int) -> int:
    """The place of the likeliest head; the present one where none is clearly likelier."""
    best = int(np.argmax(odds))
    return best if odds[best] > odds[present] + LIKELIER else present
