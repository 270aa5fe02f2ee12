"""Locates what is marked in the pictures of one or several cameras: from sightings to a posterior over the map.

For a place x, camera c and its marked direction m_c (`sight_likelihood`), with the chance that a plume is higher than
h, S(h) = exp(-h / plume_height), and the chance to notice a fire at range r, D(r) = 1 / (1 + (r / detection_range)^2):

    p(x | m) ~ S(max_c lift_c(x)) prod_c D(r_c(x)) p(m_c | x)

The prior is flat over the ground. One plume has one height, so S stands once. Sightings of one camera share its pose's
error: their densities are averaged (geometrically) and no number of them makes the camera better than one. Cameras that
look in one direction share what is wrong of the terrain model and of the plume: they too are averaged, the more so the
smaller the angle between them, and those at right angles are multiplied.

Whether cameras agree is judged at the best place. T = -2 log of S and of the densities there, each over the greatest
that it could have. A camera that is wrong is most often turned, for mounts slip and encoders lose their zero about the
vertical: then its slope still agrees with the right place, its azimuth does not. So T is found again with the azimuth
of each camera let go; where that lowers it by more than chance would (one degree of freedom, Baarda's test of a network
made for densities), the cameras disagree, and the least T tells which one is wrong. Two cameras tell no more than that
one of them is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ltm_core.dem import Dem
from ltm_core.errors import RegionError
from ltm_core.locating.fusion import Fused, fused_closely, mixture
from ltm_core.locating.posterior import Posterior
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import LocatingTerrain, Sighting

MOST_SIGHTINGS = 64


@dataclass(frozen=True)
class Agreement:
    """`statistic`: T of all cameras; +inf where no place is possible for all. `limit`: of what one camera may cause.
    `suspicion`: by camera, the probability that it is the wrong one, where they disagree; else empty. `wrong`: the one
    that is named.
    """

    statistic: float
    limit: float
    suspicion: dict[str, float]
    wrong: str | None

    @property
    def agree(self) -> bool:
        return not self.suspicion


@dataclass(frozen=True, eq=False)
class Location:
    """`posterior`: in the map frame; of the cameras but the wrong one. `misfit`: T at the best place, of one camera's
    sightings too. `agreement`: None where one camera has seen it. `lift`: metres above the ground from which the camera
    that sees least of it sees smoke, mean over the posterior.
    """

    posterior: Posterior
    misfit: float
    agreement: Agreement | None
    lift: float


class Locator:
    """Locates over one terrain.

    Args:
        dem: what cameras see of the terrain (`Site.open_surface`), in the frame of the poses; a stack too.
        bend: curvature coefficient of rays, `geodesy.ray_bend`.
        config: what is assumed.
    """

    def __init__(self, dem: Dem, bend: float, config: LocatingConfig = LocatingConfig()) -> None:
        self.dem = dem
        self.bend = bend
        self.config = config

    def locate(self, sightings: Sequence[Sighting], smoke: bool = False) -> Location:
        """Where the marked thing stands.

        Args:
            sightings: one or several, of one or several cameras, of the same thing.
            smoke: its lowest visible part is marked, and its foot may be hidden; else it stands on the ground that is
                marked.

        Raises RegionError: no sighting, too many, one that shows sky or terrain that is not known; PoseError for a
        camera under the ground or a covariance that is none.
        """
        if not 1 <= len(sightings) <= MOST_SIGHTINGS:
            raise RegionError(f"1 to {MOST_SIGHTINGS} sightings are located at once, got {len(sightings)}")
        terrain = LocatingTerrain(self.dem, self.bend, self.config, smoke)
        names = list(dict.fromkeys(sighting.name for sighting in sightings))
        sights = [terrain.look(sighting) for sighting in sightings]
        fused = fused_closely(terrain, sights)
        if len(names) == 1:
            return _location(fused, None)
        limit = self.limit(len(names))
        if fused.least <= limit:
            return _location(fused, Agreement(fused.least, limit, {}, None))
        parted = {
            name: ([s for s in sights if s.name != name], [s for s in sights if s.name == name]) for name in names
        }
        misfits = [fused_closely(terrain, others, wrong).least for others, wrong in parted.values()]
        if len(names) > 2 and fused.least - min(misfits) <= limit:
            return _location(fused, Agreement(fused.least, limit, {}, None))
        chances = _shares(misfits)
        suspicion = dict(zip(names, chances, strict=True))
        suspect = max(suspicion, key=lambda name: suspicion[name])
        named = suspicion[suspect] >= self.config.sure_of_wrong and len(names) > 2
        agreement = Agreement(fused.least, limit, suspicion, suspect if named else None)
        if named:
            return _location(fused_closely(terrain, parted[suspect][0]), agreement)
        without = [fused_closely(terrain, others) for others, _ in parted.values()]
        return _location(mixture(without, chances), agreement)

    def limit(self, cameras: int) -> float:
        """By how much T may fall when a camera's azimuth is let go, where all are right; of two cameras, T itself."""
        share = self.config.false_alarm
        return float(chdtri(1, share / cameras) if cameras > 2 else chdtri(2, share))


def _location(fused: Fused, agreement: Agreement | None) -> Location:
    posterior = Posterior.of_raster(fused.weight, fused.window)
    if posterior is None:
        raise RegionError("no place on the map is possible for all sightings: they show different things")
    lift = float(posterior.probability @ fused.lift[posterior.rows, posterior.cols])
    return Location(posterior, fused.least, agreement, lift)


def _shares(misfits: Sequence[float]) -> list[float]:
    """Probabilities of hypotheses from their misfits."""
    values = np.array([min(m, 1e6) for m in misfits])
    weights = np.exp(-0.5 * (values - values.min()))
    return [float(w) for w in weights / weights.sum()]
