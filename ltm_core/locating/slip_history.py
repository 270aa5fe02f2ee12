"""When a camera may have slipped, and what marks and pictures say of that: each belongs before the slip or after it.

What was seen before a slip says nothing against it. So a picture of this morning does not protect a camera that was
turned at noon, and fires of the morning that it has marked rightly do not either; the newer they are, the less time is
left in which it can have slipped since.

It says something of the direction, though. Where a skyline misleads it does so again and again, by what the terrain
model has wrong there, and would have shown a turn before. One that showed none while the camera was right, or on which
its mount was fitted, is to be believed when it shows one later.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.base.utc_time import DAY_NS
from ltm_core.locating.turn_evidence import STEP, TURNS
from ltm_core.pose_estimation.mount.skyline_turns import SKYLINE_TURNS, SkylineTurns

_SHORTEST_NS = 10_000_000_000
"""Of the age of a slip, which is taken for log-uniform between about ten seconds and a day before all that was seen:
how often mounts slip is not known, and what turns them, a storm or a climber, may well be there still."""
_MISLED = 0.1
"""Share of directions in which a skyline says nothing of the angle, whenever: plants or what the terrain model has
wrong there look like another part of it. Of single views about the true pose, one in ten on a rendered site."""
_PASSING = 0.01
"""Of a direction that does not mislead, the chance that its pictures do before a slip, and again that they do after it:
haze, or a cloud that lies on the ridge. It bounds what one direction can say, however well it is known."""
_ERROR = math.radians(0.1)
"""Sigma of an angle by a skyline that is right, over what its own likelihood has: terrain model, lens, refraction."""


def picture_likelihood(seen: SkylineTurns) -> Float64Array:
    """(T,) how likely a picture is by the angle of TURNS that its camera is turned by, against one that says nothing of
    it, where its direction does not mislead.
    """
    likely = np.exp(seen.logs - seen.logs.max())
    likely /= likely.mean()
    here = np.interp(TURNS, SKYLINE_TURNS, likely, left=1.0, right=1.0)
    reach = math.ceil(4 * _ERROR / STEP)
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) * STEP / _ERROR) ** 2)
    smooth = np.convolve(np.pad(here, reach, mode="edge"), bell / bell.sum(), mode="valid")
    return np.asarray((1 - _PASSING) * smooth + _PASSING, np.float64)


def misled_share(agreement: Float64Array) -> Float64Array:
    """Probability that a direction misleads, by the logarithm of how much likelier its pictures were before the slip,
    with no turn, than ones that say nothing.
    """
    return np.asarray(_MISLED / (_MISLED + (1 - _MISLED) * np.exp(agreement)), np.float64)


def shared_views(pictures: Sequence[SkylineTurns]) -> Float64Array:
    """(N, N) of each picture, the share that each other one shows too, whatever its height."""
    azimuths = np.array([seen.azimuth for seen in pictures], np.float64)
    wide = np.array([seen.hfov for seen in pictures], np.float64)[:, None]
    apart = np.abs((azimuths[:, None] - azimuths + np.pi) % (2 * np.pi) - np.pi)
    return np.asarray(np.maximum(0.0, 1.0 - apart / wide), np.float64)


def turned_ratios(
    fires: Sequence[tuple[int, Float64Array]], pictures: Sequence[SkylineTurns]
) -> tuple[Float64Array, Float64Array]:
    """Of one camera, (T,) logarithms of how much likelier all that was seen is where it is turned by an angle than
    where it is not: since before all of it, and since nobody knows when.

    Args:
        fires: stamp and (T,) ratio by marks (`TurnEvidence.ratios`).
        pictures: what its skylines say. Those of one direction count as one: they share the terrain model's errors. So
            do those from before a slip, as evidence of whether their direction misleads.
    """
    stamps = sorted({*(stamp for stamp, _ in fires), *(seen.stamp_ns for seen in pictures)})
    if not stamps:
        return np.zeros(len(TURNS)), np.zeros(len(TURNS))
    likely = np.array([picture_likelihood(seen) for seen in pictures]).reshape(-1, len(TURNS))
    middle = len(TURNS) // 2
    alike = shared_views(pictures)
    since = []
    for begin in stamps:
        later = np.array([seen.stamp_ns >= begin for seen in pictures], np.bool_)
        total = np.sum([ratio for stamp, ratio in fires if stamp >= begin] or [np.zeros(len(TURNS))], axis=0)
        earlier = alike[np.ix_(later, ~later)]
        agreement = earlier @ np.log(likely[~later, middle]) / np.maximum(earlier.sum(axis=1), 1.0)
        misled = misled_share(agreement)[:, None]
        logs = np.log((1 - misled) * likely[later] + misled)
        total += ((logs - logs[:, middle : middle + 1]) / alike[np.ix_(later, later)].sum(axis=1)[:, None]).sum(axis=0)
        since.append(total)
    ages = (stamps[-1] - np.array(stamps, np.float64)) + _SHORTEST_NS
    older = np.concatenate([[ages[0] + DAY_NS], ages[:-1]])
    chances = np.log(np.log(older / ages)) - math.log(math.log((ages[0] + DAY_NS) / _SHORTEST_NS))
    whole = np.logaddexp.reduce(np.array(since) + chances[:, None], axis=0)
    return np.asarray(since[0], np.float64), np.asarray(whole, np.float64)
