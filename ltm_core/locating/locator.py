"""Locates what is marked in the pictures of one or several cameras: from sightings to a posterior over the map.

For a place x, camera c and its marked direction m_c (`sight_likelihood`), with the chance that a plume is higher than
h, S(h) = exp(-h / plume_height), and the chance to notice a fire at range r, D(r) = 1 / (1 + (r / detection_range)^2):

    p(x | m) ~ S(max_c lift_c(x)) prod_c D(r_c(x)) p(m_c | x)

The prior is flat over the ground. One plume has one height, so S stands once. Sightings of one camera share its pose's
error: their densities are averaged (geometrically) and no number of them makes the camera better than one. Cameras that
look in one direction share what is wrong of the terrain model and of the plume: they too are averaged, the more so the
smaller the angle between them, and those at right angles are multiplied.

Whether cameras agree is judged at the best place: T = -2 log of S and of the densities there, each over the greatest
one that it could have. Where all are right it is of a chi-squared distribution with 2 n - 2 degrees of freedom, of
which -2 log S, of exponential heights, adds two (Baarda's test of a network, made for densities). Where they disagree,
T without each camera says how likely it is that one that is wrong.
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
    """`statistic`: T of all cameras; +inf where no place is possible for all. `limit`: above it they disagree.
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
        limit = self.limit(len(names), smoke)
        if fused.least <= limit:
            return _location(fused, Agreement(fused.least, limit, {}, None))
        without = {name: fused_closely(terrain, [sight for sight in sights if sight.name != name]) for name in names}
        chances = _shares([without[name].least for name in names])
        suspicion = dict(zip(names, chances, strict=True))
        suspect = max(suspicion, key=lambda name: suspicion[name])
        explained = without[suspect].least <= self.limit(len(names) - 1, smoke)
        named = suspicion[suspect] >= self.config.sure_of_wrong and explained and len(names) > 2
        agreement = Agreement(fused.least, limit, suspicion, suspect if named else None)
        if named:
            return _location(without[suspect], agreement)
        return _location(mixture(list(without.values()), chances), agreement)

    def limit(self, cameras: int, smoke: bool) -> float:
        """T up to which sightings of so many cameras agree."""
        return float(chdtri(max(2 * cameras - 2, 2) + (2 if smoke else 0), self.config.false_alarm))


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
