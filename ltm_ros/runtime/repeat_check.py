"""Tells pictures that a camera sends again from new ones: a camera that stands still adds no look of the landscape."""

from __future__ import annotations


class RepeatCheck:
    """Of one camera's pictures, in the order in which they come."""

    def __init__(self) -> None:
        self._last = ""

    def repeats(self, content: str) -> bool:
        """Whether a picture is the one before, byte for byte; `content`: its digest. From here on it is the one before.

        Two pictures of a living camera never are: its sensor's noise differs.
        """
        same, self._last = content == self._last, content
        return same
