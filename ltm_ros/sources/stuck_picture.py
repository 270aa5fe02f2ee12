"""Whether a camera shows what is there now: its pictures change, and turning its head changes them."""

from __future__ import annotations

from ltm_core.types import UInt8Array
from ltm_ros.sources.direction import Reading, difference_deg
from ltm_ros.sources.thumbnail import contrast, difference_hash, same_share

SAME_SHARE = 0.99
"""Of a thumbnail's pixels that are equal to the digit: a caption's clock may run on in a frozen picture."""
LEAST_CONTRAST = 4.0
"""Below it (fog, darkness) a picture that stays the same says nothing."""
TURNED_DEG = 5.0
"""By which a head has turned for its picture to change."""
SAME_BITS = 4
"""Of 64 of a difference hash, in which two pictures of one view differ at most."""


class StuckPicture:
    """Compares each picture with the first that looked as it does, from which the light of a living one soon departs,
    and after a turn with the one before the turn.

    Args:
        after_s: for how long the same picture may come again.
    """

    def __init__(self, after_s: float) -> None:
        self._after_s = after_s
        self._first: UInt8Array | None = None
        self._same_since: float | None = None
        self._turned_from: tuple[int, Reading] | None = None
        self._turns_unseen = 0

    def look(self, thumbnail: UInt8Array, direction: Reading | None, now: float) -> None:
        """Take a picture, of a head at rest in `direction` where it has one."""
        telling = contrast(thumbnail) >= LEAST_CONTRAST
        if self._first is None or not telling or same_share(self._first, thumbnail) < SAME_SHARE:
            self._first, self._same_since = thumbnail, now
        if direction is not None and telling:
            self._compare_turn(difference_hash(thumbnail), direction)

    def repeated(self, now: float) -> None:
        """The camera sent the very bytes of before, or says that nothing has changed."""
        if self._same_since is None:
            self._same_since = now

    def said(self, now: float) -> str:
        """Why it is stuck; empty: it is not."""
        if self._turns_unseen >= 2:
            return f"the head says that it turned by {TURNED_DEG:g} deg or more, and the picture stays the same"
        if self._same_since is not None and now - self._same_since >= self._after_s:
            return f"the same picture for {now - self._same_since:.0f} s"
        return ""

    def _compare_turn(self, bits: int, direction: Reading) -> None:
        if self._turned_from is None:
            self._turned_from = bits, direction
            return
        former, before = self._turned_from
        turn = max(
            difference_deg(before.pan_deg, direction.pan_deg), difference_deg(before.tilt_deg, direction.tilt_deg)
        )
        unseen = (former ^ bits).bit_count() <= SAME_BITS
        if turn < TURNED_DEG:
            if not unseen:
                self._turns_unseen = 0
            return
        self._turned_from = bits, direction
        self._turns_unseen = self._turns_unseen + 1 if unseen else 0
