"""Chooses frames of an archive: looks of one view within a day tell nearly the same, so a few of them tell almost all.

A choice hangs on the frames' stamps alone, camera by camera and span by span: leaving one out moves no other span's.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ltm_core.errors import ArchiveError
from ltm_ros.archive.manifest import DAY_NS, ArchiveFrame

_SPANS = {"hour": DAY_NS // 24, "day": DAY_NS}


@dataclass(frozen=True)
class Sample:
    """`count` frames of each camera a span of `span_ns`; 0: all."""

    count: int = 0
    span_ns: int = DAY_NS

    @classmethod
    def parsed(cls, text: str) -> Sample:
        """From `all`, `4/day` or `1/hour`. Raises ArchiveError."""
        if text == "all":
            return cls()
        found = re.fullmatch(r"([1-9][0-9]*)/(hour|day)", text)
        if found is None:
            raise ArchiveError(f"sample {text!r}: write all, or a number a span such as 4/day or 1/hour")
        return cls(int(found[1]), _SPANS[found[2]])

    @property
    def described(self) -> str:
        if self.count == 0:
            return "all"
        return f"{self.count}/{next(name for name, span in _SPANS.items() if span == self.span_ns)}"


def sampled(frames: Sequence[ArchiveFrame], sample: Sample) -> list[ArchiveFrame]:
    """Of frames by camera and stamp: those nearest to the middles of the equal parts of what a camera's span holds."""
    if sample.count == 0:
        return list(frames)
    spans: dict[tuple[str, int], list[ArchiveFrame]] = {}
    for frame in frames:
        spans.setdefault((frame.camera, frame.stamp_ns // sample.span_ns), []).append(frame)
    return [frame for found in spans.values() for frame in _spread(found, sample.count)]


def _spread(frames: Sequence[ArchiveFrame], count: int) -> Iterable[ArchiveFrame]:
    if len(frames) <= count:
        return frames
    return [frames[(2 * k + 1) * len(frames) // (2 * count)] for k in range(count)]
