"""Locate marks in the images of one or several cameras: from sightings to a posterior over the map.

For a place x, camera c and its marked direction m_c (`directions`), with the chance that a plume is higher than h,
S(h) = exp(-h / plume_height), and the chance to notice a fire at range r, D(r) = 1 / (1 + (r / detection_range)^2):

    p(x | m) ~ S(max_c lift_c(x)) prod_c D(r_c(x)) p(m_c | x)

The prior is flat over the ground. Densities of sightings of one camera, and of cameras that look in one direction, are
averaged geometrically, because they share errors. The cameras disagree if the evidence that one of them is turned
exceeds that of none by `wrong_odds`; the answer is then the mixture of what the others say without each.

`misfit` is T = -2 log of S and of the densities at the best place, each over the greatest that it could have.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.locating.directions import OTHER_SLOPE
from ltm_core.locating.fusion import Fused, fused_closely, mixture
from ltm_core.locating.posterior import Posterior
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import LocatingTerrain, Sighting
from ltm_core.raster.dem import Dem

MOST_SIGHTINGS = 64
_NEGLIGIBLE = 0.02
"""Probability of a wrong camera below which the solution without it is ignored."""
_ELSEWHERE = 0.02 * OTHER_SLOPE / (2 * math.pi)
"""Density of marks, in any azimuth, of the one in fifty wrong cameras that mark another object."""


@dataclass(frozen=True)
class CameraAgreement:
    """Agreement of the cameras. `statistic`: log likelihood ratio of one wrong camera to none; +inf if no place fits
    all. `limit`: of it. `suspicion`: by camera, the probability that it is wrong if they disagree, else empty."""

    statistic: float
    limit: float
    suspicion: dict[str, float]

    @property
    def agree(self) -> bool:
        return not self.suspicion


@dataclass(frozen=True, eq=False)
class Location:
    """Result of `locate`. `posterior`: in the map frame; if cameras disagree, a mixture over the wrong camera.
    `misfit`: T at the best place, also of one camera's sightings. `agreement`: None with one camera. `lift`: metres
    above the ground from which the camera with the worst view sees smoke, mean over the posterior."""

    posterior: Posterior
    misfit: float
    agreement: CameraAgreement | None
    lift: float


class Locator:
    """Locator of marks on one terrain. `dem`: the visible surface (`Site.open_surface`), in the frame of the poses.
    `bend`: curvature coefficient of rays, `geodesy.ray_bend`."""

    def __init__(self, dem: Dem, bend: float, config: LocatingConfig = LocatingConfig()) -> None:
        self.dem = dem
        self.bend = bend
        self.config = config

    def locate(self, sightings: Sequence[Sighting], smoke: bool = False) -> Location:
        """Locate the marked object by one or several sightings of it. `smoke`: its lowest visible part is marked, and
        its foot may be hidden; else it stands on the ground that is marked.

        Raises RegionError: no sighting, too many, one of sky or unknown terrain; PoseError for a camera under the
        ground or an invalid covariance.
        """
        if not 1 <= len(sightings) <= MOST_SIGHTINGS:
            raise RegionError(f"give 1 to {MOST_SIGHTINGS} sightings, got {len(sightings)}")
        terrain = LocatingTerrain(self.dem, self.bend, self.config, smoke)
        names = list(dict.fromkeys(sighting.name for sighting in sightings))
        sights = [terrain.look(sighting) for sighting in sightings]
        fused = fused_closely(terrain, sights)
        if len(names) == 1:
            return _location(fused, None)
        limit = math.log(self.config.wrong_odds)
        parted = {
            name: ([s for s in sights if s.name != name], [s for s in sights if s.name == name]) for name in names
        }
        turned = [fused_closely(terrain, others, wrong) for others, wrong in parted.values()]
        evidences = np.array([part.log_evidence for part in turned])
        statistic = _log_mean(evidences) - fused.log_evidence if np.isfinite(fused.log_evidence) else math.inf
        if not statistic > limit:
            return _location(fused, CameraAgreement(statistic, limit, {}))
        # What a wrong camera marks may be another thing, in any direction.
        without = [fused_closely(terrain, others) for others, _ in parted.values()]
        elsewhere = np.array([part.log_evidence for part in without]) + math.log(_ELSEWHERE)
        chances = _shares(np.logaddexp(evidences, elsewhere))
        agreement = CameraAgreement(statistic, limit, dict(zip(names, chances, strict=True)))
        likely = [k for k, chance in enumerate(chances) if chance >= _NEGLIGIBLE]
        return _location(mixture([without[k] for k in likely], [chances[k] for k in likely]), agreement)

    @property
    def limit(self) -> float:
        """Return the maximum misfit of one camera's sightings of one object."""
        return float(chdtri(2, self.config.false_alarm))


def _location(fused: Fused, agreement: CameraAgreement | None) -> Location:
    posterior = Posterior.of_raster(fused.weight, fused.window)
    if posterior is None:
        raise RegionError("no place on the map fits all sightings; they show different objects")
    lift = float(posterior.probability @ fused.lift[posterior.rows, posterior.cols])
    return Location(posterior, fused.least, agreement, lift)


def _shares(evidences: Float64Array) -> list[float]:
    """Return the probabilities of hypotheses that are equally likely before; where nothing is possible under any, still
    equal."""
    if not np.isfinite(evidences.max()):
        return [1 / len(evidences)] * len(evidences)
    weights = np.exp(evidences - evidences.max())
    return [float(w) for w in weights / weights.sum()]


def _log_mean(values: Float64Array) -> float:
    greatest = float(values.max())
    return greatest + math.log(float(np.exp(values - greatest).mean())) if np.isfinite(greatest) else greatest
