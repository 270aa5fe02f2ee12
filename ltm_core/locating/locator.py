"""Locates what is marked in the pictures of one or several cameras: from sightings to a posterior over the map.

For a place x, camera c and its marked direction m_c (`sight_likelihood`), with the chance that a plume is higher than
h, S(h) = exp(-h / plume_height), and the chance to notice a fire at range r, D(r) = 1 / (1 + (r / detection_range)^2):

    p(x | m) ~ S(max_c lift_c(x)) prod_c D(r_c(x)) p(m_c | x)

The prior is flat over the ground. One plume has one height, so S stands once. All cameras look at one terrain model:
its error is theirs in common, and its variance counts once for each camera in each factor, so that their product has it
as if measured once. Sightings of one camera share its pose's error: their densities are averaged (geometrically) and no
number of them makes the camera better than one.

Whether cameras agree is judged at the best place: T = -2 log of its density over the greatest one there could be is of
a chi-squared distribution with 2 n - 2 degrees of freedom where all are right (Baarda's test of a network, made for
densities). Where they disagree, T without each camera says how likely it is that one that is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.errors import PoseError, RegionError
from ltm_core.grid import GridGeometry
from ltm_core.locating.directions import MarkedDirections, marked_directions
from ltm_core.locating.posterior import Posterior
from ltm_core.locating.region import Mark
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sight_fan import SightFan, sight_fan
from ltm_core.locating.sight_likelihood import direction_table, level_sigmas, sight_likelihood
from ltm_core.locating.splat import SightRaster, sight_raster
from ltm_core.pose import Pose
from ltm_core.types import Float32Array, Float64Array
from ltm_core.visibility.point_uncertainty import checked_covariance

MOST_SIGHTINGS = 64
_SIGMAS = 5.0
"""Of the azimuth, to which a fan reaches."""
_WING, _WINGS = math.radians(3.0), 12
"""How far a fan reaches on either side for what plumes drift, and its azimuths there."""
_AZIMUTHS = 64, 160
"""Of a fan at first, and at most when it is looked at closely."""
_SIDE = 480
"""Cells along the longer side of a window."""
_FINEST = 0.5
"""Metres: no cell is smaller."""
_IMPOSSIBLE = 60.0
"""T beyond which a place is as good as excluded."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """One mark in one picture. `covariance`: (6, 6) of the pose, as in geometry_msgs/PoseWithCovariance."""

    name: str
    """The camera's: sightings of one name share its pose's error."""
    camera: Camera
    pose: Pose
    covariance: Float64Array
    mark: Mark


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


@dataclass(frozen=True, eq=False)
class _Sight:
    """A sighting with its terrain."""

    sighting: Sighting
    directions: MarkedDirections
    fan: SightFan
    density: Float64Array
    lifts: Float32Array
    peak: float

    @property
    def position(self) -> Float64Array:
        return self.sighting.pose.position


@dataclass(frozen=True, eq=False)
class _Fused:
    """`misfit`: (H, W) T by cell, +inf where a camera excludes it. `weight`: (H, W) densities of the posterior."""

    window: GridGeometry
    misfit: Float64Array
    weight: Float64Array
    lift: Float64Array

    @cached_property
    def least(self) -> float:
        return float(self.misfit.min())


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
        self._sigmas = level_sigmas(dem, config)

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
        names = list(dict.fromkeys(sighting.name for sighting in sightings))
        sights = [self._sight(sighting, len(names), smoke) for sighting in sightings]
        if len(names) == 1:
            return self._location(self._combined(sights, smoke), None)
        fused = self._combined(sights, smoke)
        limit = self.limit(len(names))
        if fused.least <= limit:
            return self._location(fused, Agreement(fused.least, limit, {}, None))
        without = {}
        for name in names:
            others = [sight for sight in sights if sight.sighting.name != name]
            without[name] = self._combined(others, smoke)
        chances = _shares([without[name].least for name in names])
        suspicion = dict(zip(names, chances, strict=True))
        suspect = max(suspicion, key=lambda name: suspicion[name])
        explained = without[suspect].least <= self.limit(len(names) - 1)
        named = suspicion[suspect] >= self.config.sure_of_wrong and explained and len(names) > 2
        agreement = Agreement(fused.least, limit, suspicion, suspect if named else None)
        if named:
            return self._location(without[suspect], agreement)
        return self._location(_mixture(list(without.values()), chances), agreement)

    def limit(self, cameras: int) -> float:
        """T up to which sightings of so many cameras agree."""
        return float(chdtri(max(2 * cameras - 2, 2), self.config.false_alarm))

    def _sight(self, sighting: Sighting, cameras: int, smoke: bool) -> _Sight:
        covariance = checked_covariance(sighting.covariance)
        x, y, z = (float(v) for v in sighting.pose.position)
        clearance = z - float(self.dem.elevation_at(x, y))
        if clearance <= 0:
            raise PoseError(f"camera {sighting.name} is {-clearance:.2f} m under the ground; check its height")
        directions = marked_directions(
            sighting.mark, sighting.camera, sighting.pose, covariance, self.config.focal_sigma
        )
        reach = _SIGMAS * directions.azimuth_sigma
        azimuths = np.linspace(directions.azimuth.min() - reach, directions.azimuth.max() + reach, _AZIMUTHS[0])
        if smoke and self.config.plume_lean > 0:
            beside = np.arange(1, _WINGS + 1) * (_WING / _WINGS)
            azimuths = np.concatenate([azimuths[0] - beside[::-1], azimuths, azimuths[-1] + beside])
        sight = self._looked(sighting, directions, azimuths, None, cameras, smoke)
        self._check(sight, smoke)
        return sight

    def _looked(
        self,
        sighting: Sighting,
        directions: MarkedDirections,
        azimuths: Float64Array,
        fine: tuple[float, float, float] | None,
        cameras: int,
        smoke: bool,
    ) -> _Sight:
        position = sighting.pose.position
        fan = sight_fan(self.dem, position, azimuths, self.config.max_range, fine)
        table = direction_table(directions, fan.azimuths, smoke)
        sigmas = self._sigmas * math.sqrt(cameras)
        lean = self.config.plume_lean
        density, lifts = sight_likelihood(fan, table, float(position[2]), self.bend, sigmas, smoke, lean)
        return _Sight(sighting, directions, fan, density, lifts, table.peak)

    def _check(self, sight: _Sight, smoke: bool) -> None:
        """Raises RegionError where nothing on the ground explains the mark."""
        if sight.density.max() > sight.peak * math.exp(-_IMPOSSIBLE / 4):
            return
        name, fan = sight.sighting.name, sight.fan
        if not np.isfinite(fan.heights).any():
            raise RegionError(f"{name}: no terrain is known in the direction of the mark; is the DEM large enough?")
        with np.errstate(invalid="ignore"):
            slopes = (fan.heights - sight.position[2]) / fan.ranges - self.bend * fan.ranges
        highest, lowest = float(np.nanmax(slopes)), float(np.nanmin(slopes))
        marked = float(sight.directions.slope @ sight.directions.weights)
        if marked > highest:
            above = math.degrees(math.atan(marked) - math.atan(highest))
            what = "smoke that stands clear of the ground" if smoke else "sky"
            raise RegionError(
                f"{name}: the mark shows {what}: it is {above:.1f} degrees above the highest ground known there; mark "
                + ("its foot, or where it rises from a ridge" if smoke else "a place on the ground")
            )
        if marked < lowest:
            raise RegionError(f"{name}: the mark shows ground nearer than {fan.ranges[0]:g} m, too near to be located")
        raise RegionError(f"{name}: the mark shows ground that the terrain model does not know (a hole, or its edge)")

    def _combined(self, sights: Sequence[_Sight], smoke: bool) -> _Fused:
        """First over all places that any camera allows, then closely over those that all do."""
        window = self._window([self._support(sight, smoke) for sight in sights])
        coarse = self._fused(sights, window, smoke)
        if not np.isfinite(coarse.least):
            return coarse
        rows, cols = np.nonzero(coarse.misfit < max(_IMPOSSIBLE / 2, coarse.least + _IMPOSSIBLE / 2))
        x_min, y_max = (float(v) for v in window.to_map(rows.min() - 1.5, cols.min() - 1.5))
        x_max, y_min = (float(v) for v in window.to_map(rows.max() + 1.5, cols.max() + 1.5))
        bounds = (x_min, y_min, x_max, y_max)
        cameras = len({sight.sighting.name for sight in sights})
        resolution = max(_FINEST, max(x_max - x_min, y_max - y_min) / _SIDE)
        closer = [self._closer(sight, bounds, resolution, cameras, smoke) for sight in sights]
        for sight, (r_min, r_max) in zip(closer, (_ranges_of(sight.position, bounds) for sight in sights), strict=True):
            inside = (sight.fan.ranges >= r_min) & (sight.fan.ranges <= r_max)
            resolution = max(resolution, sight.fan.spacing * r_max, float(sight.fan.steps[inside].max(initial=0.0)))
        return self._fused(closer, _covering(bounds, resolution), smoke)

    def _support(self, sight: _Sight, smoke: bool) -> tuple[float, float, float, float]:
        """Bounds of the places that a sighting allows."""
        weight = sight.density * self._chance(sight.lifts, smoke)
        a, k = np.nonzero(weight > weight.max() * math.exp(-_IMPOSSIBLE / 4))
        r, azimuth = sight.fan.ranges[k], sight.fan.azimuths[a]
        x, y = sight.position[0] + r * np.sin(azimuth), sight.position[1] + r * np.cos(azimuth)
        pad = 0.02 * float(r.max())
        return float(x.min()) - pad, float(y.min()) - pad, float(x.max()) + pad, float(y.max()) + pad

    @staticmethod
    def _window(supports: Sequence[tuple[float, float, float, float]]) -> GridGeometry:
        bounds = np.array(supports)
        low, high = bounds[:, :2].max(axis=0), bounds[:, 2:].min(axis=0)
        if (high <= low).any():  # no place for all: the raster says so of every cell
            low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
        whole = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        return _covering(whole, max(_FINEST, float((high - low).max()) / _SIDE))

    def _closer(
        self, sight: _Sight, bounds: tuple[float, float, float, float], resolution: float, cameras: int, smoke: bool
    ) -> _Sight:
        """The same sighting with a fan that is sampled closely over the window."""
        azimuths = sight.fan.azimuths
        low, high = _azimuths_of(sight.position, bounds, float(azimuths.mean()))
        low, high = max(low, float(azimuths[0])), min(high, float(azimuths[-1]))
        if high <= low:
            low, high = float(azimuths[0]), float(azimuths[-1])
        r_min, r_max = _ranges_of(sight.position, bounds)
        count = int(np.clip(math.ceil((high - low) * r_max / resolution) + 1, *_AZIMUTHS))
        return self._looked(
            sight.sighting,
            sight.directions,
            np.linspace(low, high, count),
            (r_min, r_max, 0.8 * resolution),
            cameras,
            smoke,
        )

    def _fused(self, sights: Sequence[_Sight], window: GridGeometry, smoke: bool) -> _Fused:
        by_camera: dict[str, list[tuple[_Sight, SightRaster]]] = {}
        for sight in sights:
            raster = sight_raster(sight.fan, sight.density, sight.lifts, sight.position, window)
            by_camera.setdefault(sight.sighting.name, []).append((sight, raster))
        possible = np.ones(window.shape, np.bool_)
        for of_one in by_camera.values():
            for _, raster in of_one:
                possible &= raster.reached
        rows, cols = np.nonzero(possible)
        misfit, weight, lift = np.full(window.shape, np.inf), np.zeros(window.shape), np.zeros(window.shape)
        if not len(rows):
            return _Fused(window, misfit, weight, lift)
        x, y = window.to_map(rows, cols)
        fit, noticed, raised = np.zeros(len(rows)), np.ones(len(rows)), np.zeros(len(rows))
        for of_one in by_camera.values():
            for sight, raster in of_one:
                fit += np.log(raster.density[rows, cols] / sight.peak) / len(of_one)
                raised = np.maximum(raised, raster.lift[rows, cols])
            squared = (x - of_one[0][0].position[0]) ** 2 + (y - of_one[0][0].position[1]) ** 2
            noticed /= 1 + squared / self.config.detection_range**2
        fit += np.log(self._chance(raised, smoke))
        misfit[rows, cols] = -2 * fit
        weight[rows, cols] = np.exp(fit - fit.max()) * noticed
        lift[rows, cols] = raised
        return _Fused(window, misfit, weight, lift)

    def _chance(self, lift: Float64Array | Float32Array, smoke: bool) -> Float64Array:
        """That a plume is higher."""
        return np.exp(-np.asarray(lift, np.float64) / self.config.plume_height) if smoke else np.ones(lift.shape)

    def _location(self, fused: _Fused, agreement: Agreement | None) -> Location:
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


def _mixture(parts: Sequence[_Fused], shares: Sequence[float]) -> _Fused:
    """Several posteriors of which one is true, on one raster."""
    bounds = np.array([part.window.bounds for part in parts])
    low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    resolution = max(min(part.window.resolution for part in parts), float((high - low).max()) / _SIDE)
    window = _covering((float(low[0]), float(low[1]), float(high[0]), float(high[1])), resolution)
    weight, lift = np.zeros(window.shape), np.zeros(window.shape)
    for part, share in zip(parts, shares, strict=True):
        if not part.weight.any():
            continue
        rows, cols = np.nonzero(part.weight)
        i, j = window.cell_of(*part.window.to_map(rows, cols))
        values = part.weight[rows, cols] * share / part.weight.sum()
        np.add.at(weight, (i, j), values)
        np.add.at(lift, (i, j), values * part.lift[rows, cols])
    with np.errstate(invalid="ignore", divide="ignore"):
        lift = np.where(weight > 0, lift / weight, 0.0)
    return _Fused(window, np.where(weight > 0, 0.0, np.inf), weight, lift)


def _covering(bounds: tuple[float, float, float, float], resolution: float) -> GridGeometry:
    """Whole multiples of the resolution from the map's origin, so that equal places give equal rasters."""
    return GridGeometry.snapped(bounds, resolution, 0.0)


def _ranges_of(position: Float64Array, bounds: tuple[float, float, float, float]) -> tuple[float, float]:
    """Least and greatest horizontal distance to a rectangle."""
    x_min, y_min, x_max, y_max = bounds
    x, y = float(position[0]), float(position[1])
    near = math.hypot(max(x_min - x, x - x_max, 0.0), max(y_min - y, y - y_max, 0.0))
    far = math.hypot(max(abs(x_min - x), abs(x_max - x)), max(abs(y_min - y), abs(y_max - y)))
    return near, far


def _azimuths_of(
    position: Float64Array, bounds: tuple[float, float, float, float], around: float
) -> tuple[float, float]:
    """Azimuths between which a rectangle is seen, within half a turn of `around`; all where one stands in it."""
    x_min, y_min, x_max, y_max = bounds
    x, y = float(position[0]), float(position[1])
    if x_min <= x <= x_max and y_min <= y <= y_max:
        return around - math.pi, around + math.pi
    corners = [math.atan2(cx - x, cy - y) for cx in (x_min, x_max) for cy in (y_min, y_max)]
    first = corners[0]
    turned = [first + (c - first + math.pi) % (2 * math.pi) - math.pi for c in corners]
    shift = 2 * math.pi * round((around - (min(turned) + max(turned)) / 2) / (2 * math.pi))
    return min(turned) + shift, max(turned) + shift
