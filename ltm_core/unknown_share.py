"""How much of a picture a depth image leaves unknown, and why that is likely so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.types import Float32Array

MOST_UNKNOWN = 0.5
"""Share of a picture from which on it is said that little of it is explained."""
_EVERY = 4  # pixels looked at, each way


@dataclass(frozen=True)
class UnknownShare:
    """Shares of a picture that are unknown: `beyond` known ground, up to the sky; `between` known ground; `before` the
    first known ground; and in columns that meet `no_ground`.
    """

    beyond: float
    between: float
    before: float
    no_ground: float

    @property
    def whole(self) -> float:
        return self.beyond + self.between + self.before + self.no_ground

    @property
    def reason(self) -> str:
        """The share, and what most of it likely comes from."""
        likely = max(
            (self.beyond, "the camera looks over the DEM's edge; give a coarser DEM around it, or possible_ground"),
            (self.between, "the DEM has holes there"),
            (self.before, "the camera stands beyond the DEM's edge or beside a hole of it"),
            (self.no_ground, "the camera looks past the DEM; check position and azimuth, or give a larger DEM"),
        )
        return f"{self.whole:.0%} of the picture is unknown ground: {likely[1]}"


def unknown_share(depth: Float32Array) -> UnknownShare:
    """Of ranges or depths (H, W): finite, +inf sky, NaN unknown; every fourth pixel each way is looked at."""
    part = depth[::_EVERY, ::_EVERY]
    unknown, known = np.isnan(part), np.isfinite(part)
    above = np.logical_or.accumulate(known, axis=0)
    below = np.logical_or.accumulate(known[::-1], axis=0)[::-1]
    return UnknownShare(
        float((unknown & below & ~above).mean()),
        float((unknown & below & above).mean()),
        float((unknown & ~below & above).mean()),
        float((unknown & ~below & ~above).mean()),
    )
