"""Evidence of marks for a turn of a camera about the vertical: their probability density by the angle.

One fire cannot always tell which camera is turned, but the turn is the same for all fires: densities are kept by angle,
and those of several fires are multiplied (`wrong_camera`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_core.locating.directions import KNOTS, MOST_TURNED, MarkedDirections, turn_density

if TYPE_CHECKING:
    from ltm_core.locating.sighting import Sight

STEP = math.radians(0.05)
TURNS: Float64Array = STEP * np.arange(-round(MOST_TURNED / STEP), round(MOST_TURNED / STEP) + 1, dtype=np.float64)
"""Angles in radians by which a stated azimuth may be too large, (T,)."""
_LEAST_SIGMA = 0.8 * STEP
"""Minimum standard deviation of a mark's azimuth; narrower ones would fall between the angles."""
_FAR = 1_000.0
"""Distance in metres beyond which the position error has little effect on an azimuth."""


@dataclass(frozen=True, eq=False)
class TurnProfile:
    """Turn profile of one fire and one camera. `density`: (T,) logarithm of the density of all marks by the camera's
    turn. `apart`: the same of the other cameras' marks only."""

    density: Float64Array
    apart: float


@dataclass(frozen=True, eq=False)
class TurnEvidence:
    """Turn evidence of one fire. `ratios`: by camera, (T,) log likelihood ratio of its marks with the camera turned to
    none turned. `sigmas`: of the azimuth of the camera's pose, radians, by its covariance. `azimuths`: marked by it,
    radians."""

    ratios: Mapping[str, Float64Array]
    sigmas: Mapping[str, float]
    azimuths: Mapping[str, float]


def turn_profile(
    evidence: Float64Array,
    apart: Float64Array,
    x: Float64Array,
    y: Float64Array,
    turned: Sequence[Sight],
    resolution: float,
) -> TurnProfile:
    """Compute the profile from the possible cells of a raster, at x, y (N,). `evidence`: (N,) logarithm of the density
    of all marks, with `turned` sightings of one camera turned by any angle; `apart`: of the other cameras' marks."""
    off, prior, variance = np.zeros(len(x)), np.zeros(len(x)), 0.0
    for sight in turned:
        directions, to_x, to_y = sight.directions, x - sight.position[0], y - sight.position[1]
        # The stated azimuth over the true one.
        here = (_azimuth(directions) - np.arctan2(to_x, to_y) + np.pi) % (2 * np.pi) - np.pi
        off += here / len(turned)
        prior += np.log(turn_density(directions, here)) / len(turned)
        wide = resolution**2 / np.maximum(to_x**2 + to_y**2, resolution**2) / 12
        variance += (_mark_variance(sight) + float(wide.mean())) / len(turned)
    greatest = float(evidence.max())
    weights = np.exp(evidence - greatest - prior + prior.max())
    bins = np.rint(off / STEP).astype(np.int64) + len(TURNS) // 2
    inside = (bins >= 0) & (bins < len(TURNS))
    counts = np.bincount(bins[inside], weights[inside], len(TURNS))
    sigma = max(math.sqrt(variance), _LEAST_SIGMA)
    reach = math.ceil(6 * sigma / STEP)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * STEP / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
    smooth = np.convolve(counts, kernel)[reach : reach + len(TURNS)] * resolution**2
    with np.errstate(divide="ignore"):
        density = np.log(smooth) + greatest - float(prior.max())
    most = float(apart.max())
    alone = most + math.log(float(np.exp(apart - most).sum()) * resolution**2)
    return TurnProfile(np.asarray(density, np.float64), alone)


def turn_evidence(
    profiles: Mapping[str, TurnProfile | None],
    log_evidence: float,
    elsewhere: float,
    marked: Mapping[str, Sequence[Sight]],
) -> TurnEvidence:
    """Compute the evidence of one fire, by camera that may be turned.

    `profiles`: None if no place is possible with that camera turned. `log_evidence`: of all marks with no camera
    turned. `elsewhere`: density of a mark of another object, times its probability. `marked`: the sightings of each
    camera.
    """
    sigmas = {name: _pose_sigma(sights) for name, sights in marked.items()}
    azimuths = {name: _azimuth(sights[-1].directions) for name, sights in marked.items()}
    others = [profile.apart for profile in profiles.values() if profile is not None]
    if not others:
        return TurnEvidence({name: np.zeros(len(TURNS)) for name in profiles}, sigmas, azimuths)
    floor = float(np.logaddexp.reduce(others)) + math.log(elsewhere)
    none = float(np.logaddexp(log_evidence, floor))
    ratios = {}
    for name, profile in profiles.items():
        density = np.full(len(TURNS), -math.inf) if profile is None else profile.density
        ratios[name] = np.logaddexp(density, floor) - none
    return TurnEvidence(ratios, sigmas, azimuths)


def _pose_sigma(sights: Sequence[Sight]) -> float:
    """Return the radians: of the azimuth of a camera's pose, as its covariance has it; the greatest of its
    sightings."""
    return math.sqrt(max(float(sight.sighting.covariance[5, 5]) for sight in sights))


def _azimuth(directions: MarkedDirections) -> float:
    """Return the radians, mean over the marked places."""
    return float(directions.azimuth @ directions.weights)


def _mark_variance(sight: Sight) -> float:
    """Of the azimuth, without what the pose's has: that is the camera's, not the mark's."""
    directions = sight.directions
    far = int(np.searchsorted(KNOTS, _FAR))
    here = directions.covariance[:, far, 0, 0] + (directions.azimuth - _azimuth(directions)) ** 2
    return max(float(directions.weights @ here) - _pose_sigma([sight]) ** 2, 0.0)
