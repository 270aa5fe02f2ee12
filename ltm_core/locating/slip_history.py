"""When a camera may have slipped, and what marks and pictures say of that: each belongs before the slip or after it.

What was seen before a slip says nothing against it. So a picture of this morning does not protect a camera that was
turned at noon, and fires of the morning that it has marked rightly do not either; the newer they are, the less time is
left in which it can have slipped since.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ltm_core.locating.turn_evidence import STEP, TURNS
from ltm_core.pose_estimation.skyline_turns import SKYLINE_TURNS, SkylineTurns
from ltm_core.types import Float64Array
from ltm_core.utc_time import DAY_NS

_SHORTEST_NS = 10_000_000_000
"""Of the age of a slip, which is taken for log-uniform between about ten seconds and a day before all that was seen:
how often mounts slip is not known, and what turns them, a storm or a climber, may well be there still."""
_MISLED = 0.1
"""Share of directions in which a skyline says nothing of the angle: plants, haze or what the terrain model has wrong
there look like another part of it. Of single views about the true pose, one in ten on a rendered site."""
_ERROR = math.radians(0.1)
"""Sigma of an angle by a skyline that is right, over what its own likelihood has: terrain model, lens, refraction."""


def picture_logs(seen: SkylineTurns) -> Float64Array:
    """(T,) logarithm of how likely a picture is by the angle of TURNS that its camera is turned by, against one that
    says nothing of it.
    """
    likely = np.exp(seen.logs - seen.logs.max())
    likely /= likely.mean()
    here = np.interp(TURNS, SKYLINE_TURNS, likely, left=1.0, right=1.0)
    reach = math.ceil(4 * _ERROR / STEP)
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) * STEP / _ERROR) ** 2)
    smooth = np.convolve(np.pad(here, reach, mode="edge"), bell / bell.sum(), mode="valid")
    return np.asarray(np.log((1 - _MISLED) * smooth + _MISLED), np.float64)


def turned_ratios(
    fires: Sequence[tuple[int, Float64Array]], pictures: Sequence[SkylineTurns]
) -> tuple[Float64Array, Float64Array]:
    """Of one camera, (T,) logarithms of how much likelier all that was seen is where it is turned by an angle than
    where it is not: since before all of it, and since nobody knows when.

    Args:
        fires: stamp and (T,) ratio by marks (`TurnEvidence.ratios`).
        pictures: what its skylines say. Those of one direction count as one: they share the terrain model's errors.
    """
    stamps = sorted({*(stamp for stamp, _ in fires), *(seen.stamp_ns for seen in pictures)})
    if not stamps:
        return np.zeros(len(TURNS)), np.zeros(len(TURNS))
    logs = [picture_logs(seen) for seen in pictures]
    alike = np.array([[_alike(one, other) for other in pictures] for one in pictures])
    since = []
    for begin in stamps:
        later = np.array([seen.stamp_ns >= begin for seen in pictures], np.bool_)
        total = np.sum([ratio for stamp, ratio in fires if stamp >= begin] or [np.zeros(len(TURNS))], axis=0)
        for k in np.flatnonzero(later):
            total = total + (logs[k] - logs[k][len(TURNS) // 2]) / alike[k, later].sum()
        since.append(total)
    ages = (stamps[-1] - np.array(stamps, np.float64)) + _SHORTEST_NS
    older = np.concatenate([[ages[0] + DAY_NS], ages[:-1]])
    chances = np.log(np.log(older / ages)) - math.log(math.log((ages[0] + DAY_NS) / _SHORTEST_NS))
    whole = np.logaddexp.reduce(np.array(since) + chances[:, None], axis=0)
    return np.asarray(since[0], np.float64), np.asarray(whole, np.float64)


def _alike(one: SkylineTurns, other: SkylineTurns) -> float:
    """Of two pictures, the share of the one that the other shows too, whatever its height."""
    apart = abs(math.remainder(one.azimuth - other.azimuth, 2 * math.pi))
    return max(0.0, 1.0 - apart / one.hfov)
