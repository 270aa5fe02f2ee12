"""Sighting: one mark in one image, the terrain around its direction, and the likelihood of places."""

import math
from dataclasses import dataclass, replace

import numpy as np

from ltm_core.base.errors import PoseError, RegionError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, checked_covariance
from ltm_core.locating.directions import (
    MOST_TURNED,
    DirectionTable,
    MarkedDirections,
    SightLikelihood,
    direction_table,
    level_errors,
    marked_directions,
    sight_likelihood,
    turned_table,
)
from ltm_core.locating.region import ImageMark
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sight_fan import SightFan, sight_fan
from ltm_core.raster.dem import Dem

Bounds = tuple[float, float, float, float]  # bounds x_min, y_min, x_max, y_max in metres

IMPOSSIBLE = math.exp(-15.0)  # misfit above which a place does not explain a mark
_SIGMAS = 5.0  # number of sigmas of the azimuth that a fan covers
_FIRST, _MOST = 40, 120  # initial number of azimuths of a fan, and the maximum after refinement
_WING, _WINGS = math.radians(3.0), 12  # width and azimuths that a fan adds at each side for drifting plumes
_CREST = 16  # number of azimuths above the mark in every smoke fan, where the plume rises wherever its base is
_PER_CELL = 1.5  # number of samples per cell side; with fewer, some cells get none


@dataclass(frozen=True, eq=False)
class Sighting:
    """Mark in one image. `covariance`: (6, 6) of the pose, as in geometry_msgs/PoseWithCovariance."""

    name: str
    """Name of the camera; sightings with the same name share its pose error."""
    camera: Camera
    pose: Pose
    covariance: Float64Array
    mark: ImageMark


@dataclass(frozen=True, eq=False)
class Sight:
    """Sighting with its fan. `cell`: metres, the smallest cells that all have a sample of the fan."""

    sighting: Sighting
    directions: MarkedDirections
    fan: SightFan
    likelihood: SightLikelihood
    cell: float

    @property
    def name(self) -> str:
        return self.sighting.name

    @property
    def position(self) -> Float64Array:
        return self.sighting.pose.position


@dataclass(frozen=True, eq=False)
class LocatingTerrain:
    """Terrain for locating. `dem`: the surface that cameras see. `bend`: curvature coefficient of rays."""

    dem: Dem
    bend: float
    config: LocatingConfig
    smoke: bool

    def look(self, sighting: Sighting) -> Sight:
        """Return the likelihood of all places that a sighting may show. Raises PoseError for a camera under the ground
        or an invalid covariance, RegionError for a mark without a direction, or that nothing on the ground explains."""
        covariance = checked_covariance(sighting.covariance)
        x, y, z = (float(v) for v in sighting.pose.position)
        clearance = z - float(self.dem.elevation_at(x, y))
        if clearance <= 0:
            raise PoseError(f"camera {sighting.name} is {-clearance:.2f} m under the ground; check its height")
        focal, pose = self.config.focal_sigma, sighting.pose
        directions = marked_directions(sighting.mark, sighting.camera, pose, covariance, focal)
        reach = _SIGMAS * directions.azimuth_sigma
        azimuths = np.linspace(directions.azimuth.min() - reach, directions.azimuth.max() + reach, _FIRST)
        if self._drifts:
            beside = np.arange(1, _WINGS + 1) * (_WING / _WINGS)
            azimuths = np.concatenate([azimuths[0] - beside[::-1], azimuths, azimuths[-1] + beside])
        farthest = min(self.config.max_range, ranges_of(sighting.pose.position, self.dem.levels[-1].geometry.bounds)[1])
        fan = sight_fan(self.dem, sighting.pose.position, azimuths, max(farthest, 10.0))
        sight = self._sight(sighting, directions, fan, 0.0)
        self._check(sight)
        return sight

    def look_closer(self, sight: Sight, bounds: Bounds, resolution: float, turned: bool = False) -> Sight:
        """Return the sighting over a part of the map for cells of a resolution; `turned`: by an unknown angle."""
        marked, azimuths = sight.directions.azimuth, sight.fan.azimuths
        around = float(marked @ sight.directions.weights) if turned else float(azimuths.mean())
        first, last = (around - MOST_TURNED, around + MOST_TURNED) if turned else (azimuths[0], azimuths[-1])
        low, high = _azimuths_of(sight.position, bounds, around)
        low, high = max(low, float(first)), min(high, float(last))
        if high <= low:
            low, high = float(first), float(last)
        near, far = ranges_of(sight.position, bounds)
        far = min(far, float(sight.fan.ranges[-1]))
        count = int(np.clip(math.ceil(_PER_CELL * (high - low) * far / resolution) + 1, 16, _MOST))
        inside = np.linspace(low, high, count)
        if self._drifts and not turned:
            reach = 2 * sight.directions.azimuth_sigma
            inside = np.union1d(inside, np.linspace(marked.min() - reach, marked.max() + reach, _CREST))
        fan = sight_fan(self.dem, sight.position, inside, max(far, 10.0), (near, far, resolution / _PER_CELL))
        spacing = (high - low) / (count - 1) * far
        if turned:
            likelihood = self._likelihood(sight.sighting, fan, turned_table(sight.directions, inside), turned)
            return replace(sight, fan=fan, likelihood=likelihood, cell=_PER_CELL * spacing)
        within = fan.steps[(fan.ranges >= near) & (fan.ranges <= far)][1:]  # the first is a step from before
        cell = _PER_CELL * max(spacing, float(within.max(initial=0.0)))
        return self._sight(sight.sighting, sight.directions, fan, cell)

    def chance(self, lift: Float64Array | Float32Array) -> Float64Array:
        """Return the probability that a plume is higher."""
        if not self.smoke:
            return np.ones(lift.shape)
        return np.exp(-np.asarray(lift, np.float64) / self.config.plume_height)

    def support(self, sight: Sight) -> tuple[Bounds, float]:
        """Return the bounds of the places that a sighting allows, and the size of cells that all have a sample."""
        weight = sight.likelihood.density * self.chance(sight.likelihood.lifts)
        a, k = np.nonzero(weight > weight.max() * IMPOSSIBLE)
        r, azimuth, fan = sight.fan.ranges[k], sight.fan.azimuths[a], sight.fan
        x, y = sight.position[0] + r * np.sin(azimuth), sight.position[1] + r * np.cos(azimuth)
        cell = _PER_CELL * max(float((fan.widths[a] * r).max()), float(fan.steps[k].max()))
        return ((float(x.min()) - cell, float(y.min()) - cell, float(x.max()) + cell, float(y.max()) + cell), cell)

    @property
    def _drifts(self) -> bool:
        return self.smoke and self.config.plume_lean > 0

    def _sight(self, sighting: Sighting, directions: MarkedDirections, fan: SightFan, cell: float) -> Sight:
        table = direction_table(directions, fan.azimuths, self._drifts)
        return Sight(sighting, directions, fan, self._likelihood(sighting, fan, table), cell)

    def _likelihood(
        self, sighting: Sighting, fan: SightFan, table: DirectionTable, turned: bool = False
    ) -> SightLikelihood:
        height, lean = float(sighting.pose.position[2]), self.config.plume_lean
        errors = level_errors(self.dem, self.config)
        found = sight_likelihood(fan, table, height, self.bend, *errors, self.smoke, lean, turned)
        near = fan.ranges < self.config.min_range
        found.density[:, near], found.fit[:, near] = 0.0, 0.0
        return found

    def _check(self, sight: Sight) -> None:
        """Raise RegionError where nothing on the ground explains the mark."""
        if sight.likelihood.fit.max() > IMPOSSIBLE:
            return
        name, fan = sight.name, sight.fan
        if not np.isfinite(fan.heights).any():
            raise RegionError(f"{name}: no known terrain in the direction of the mark; check the extent of the DEM")
        with np.errstate(invalid="ignore"):
            slopes = (fan.heights - sight.position[2]) / fan.ranges - self.bend * fan.ranges
        highest, lowest = float(np.nanmax(slopes)), float(np.nanmin(slopes))
        marked = float(sight.directions.slope @ sight.directions.weights)
        if marked > highest:
            above = math.degrees(math.atan(marked) - math.atan(highest))
            what = "smoke clear of the ground" if self.smoke else "sky"
            raise RegionError(
                f"{name}: the mark shows {what}: it is {above:.1f} degrees above the highest ground known there; mark "
                + ("its base, or where it rises from a ridge" if self.smoke else "a place on the ground")
            )
        near = fan.ranges < self.config.min_range
        if marked < lowest or (near.any() and marked < float(np.nanmax(slopes[:, near], initial=-np.inf))):
            raise RegionError(f"{name}: the mark is nearer than {self.config.min_range:g} m, too near to be located")
        raise RegionError(f"{name}: the mark is on unknown terrain (a hole or the edge of the DEM)")


def ranges_of(position: Float64Array, bounds: Bounds) -> tuple[float, float]:
    """Return the minimum and maximum horizontal distance to a rectangle."""
    x_min, y_min, x_max, y_max = bounds
    x, y = float(position[0]), float(position[1])
    near = math.hypot(max(x_min - x, x - x_max, 0.0), max(y_min - y, y - y_max, 0.0))
    far = math.hypot(max(abs(x_min - x), abs(x_max - x)), max(abs(y_min - y), abs(y_max - y)))
    return near, far


def _azimuths_of(position: Float64Array, bounds: Bounds, around: float) -> tuple[float, float]:
    """Return the azimuths between which a rectangle is visible, within half a turn of `around`; all from inside."""
    x_min, y_min, x_max, y_max = bounds
    x, y = float(position[0]), float(position[1])
    if x_min <= x <= x_max and y_min <= y <= y_max:
        return around - math.pi, around + math.pi
    corners = [math.atan2(cx - x, cy - y) for cx in (x_min, x_max) for cy in (y_min, y_max)]
    first = corners[0]
    turned = [first + (c - first + math.pi) % (2 * math.pi) - math.pi for c in corners]
    shift = 2 * math.pi * round((around - (min(turned) + max(turned)) / 2) / (2 * math.pi))
    return min(turned) + shift, max(turned) + shift
