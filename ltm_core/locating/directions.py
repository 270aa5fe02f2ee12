"""Compute directions of marked pixels on the map, their densities, and the likelihood of a mark along a fan.

A direction is (azimuth, slope): radians clockwise from grid north, and rise over horizontal range at the camera. To
first order, with the camera moved by o and turned by the small rotation w, a point at horizontal range r seems to lie
at (azimuth, slope) + [G / r, -T] (o, w): its covariance is a quadratic in 1 / r.

Something on the ground is marked at its own direction. Smoke is marked at the lowest part of it that is visible: its
foot, or behind a crest the highest of the terrain's slopes from the camera to the place, where it has drifted sideways
the more, the farther that is above the foot's slope. Slopes of the place and of crests have errors by the terrain
model's, the larger the nearer they are (`sight_kernels`)."""

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.locating.region import ImageMark
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sight_fan import Rays, SightFan, SmokeDensities
from ltm_core.locating.sight_kernels import ROOT_2PI, add_drifted, ground_along, smoke_along
from ltm_core.raster.dem import Dem
from ltm_core.visibility.footprint import pixel_rays

STEEPEST_DEG = 80.0  # maximum angle to the horizon; a camera that points more steeply has no reliable azimuth
LEAST_KNOWN_DEG = 20.0  # standard deviation of an azimuth in degrees above which a camera's direction counts as unknown
KNOTS = np.geomspace(5.0, 80_000.0, 15)  # ranges in metres at which covariances are computed


@dataclass(frozen=True, eq=False)
class MarkedDirections:
    """Directions of a mark. `azimuth`, `slope`, `weights`: (K,). `covariance`: (K, J, 2, 2) at the ranges KNOTS."""

    azimuth: Float64Array
    slope: Float64Array
    weights: Float64Array
    covariance: Float64Array

    @property
    def azimuth_sigma(self) -> float:
        """Return the largest standard deviation of the azimuth beyond 150 m."""
        return float(np.sqrt(self.covariance[:, KNOTS > 150.0, 0, 0].max()))


def marked_directions(
    mark: ImageMark, camera: Camera, pose: Pose, covariance: Float64Array, focal_sigma: float
) -> MarkedDirections:
    """Compute the directions of a mark. Raises RegionError for pixels without a ray, and for steep ones."""
    rays = pixel_rays(camera, mark.pixels)
    if np.isnan(rays).any():
        u, v = mark.pixels[np.isnan(rays).any(axis=1)][0]
        raise RegionError(f"pixel ({u:g}, {v:g}) is outside the lens model and has no ray; check k1 to k3")
    d = rays @ pose.rotation.T
    level = np.hypot(d[:, 0], d[:, 1])
    slope = d[:, 2] / np.maximum(level, 1e-12)
    steep = np.abs(slope) > math.tan(math.radians(STEEPEST_DEG))
    if steep.any():
        u, v = mark.pixels[steep][0]
        off = math.degrees(math.atan(slope[steep][0]))
        raise RegionError(
            f"pixel ({u:g}, {v:g}) is {off:.0f} degrees from the horizon; at most {STEEPEST_DEG:g} are located"
        )
    first = np.arctan2(d[0, 0], d[0, 1])
    azimuth = first + (np.arctan2(d[:, 0], d[:, 1]) - first + np.pi) % (2 * np.pi) - np.pi
    per_pixel = _per_pixel(camera, pose, azimuth, slope)
    own = np.einsum("kij,kj,klj->kil", per_pixel, mark.sigmas**2, per_pixel)
    off_axis = np.einsum("kij,kj->ki", per_pixel, mark.pixels - np.array([camera.cx, camera.cy]))
    own += focal_sigma**2 * off_axis[:, :, None] * off_axis[:, None, :]

    sine, cosine = np.sin(azimuth), np.cos(azimuth)
    zero = np.zeros_like(sine)
    # Of the direction with respect to the vector to the point, times its horizontal length.
    rise = np.stack([-slope * sine, -slope * cosine, np.ones_like(sine)], -1)
    grad = np.stack([np.stack([cosine, -sine, zero], -1), rise], 1)
    unit = d / level[:, None]
    turned = np.cross(unit[:, None, :], grad)
    rows = np.concatenate([-grad[:, None] / KNOTS[:, None, None], np.repeat(-turned[:, None], len(KNOTS), 1)], -1)
    total = np.einsum("kjab,bc,kjdc->kjad", rows, covariance, rows) + own[:, None]
    found = MarkedDirections(azimuth, slope, mark.weights, np.asarray(total, np.float64))
    if not found.azimuth_sigma < math.radians(LEAST_KNOWN_DEG):
        sigma = math.degrees(found.azimuth_sigma)
        raise RegionError(
            f"the mark's azimuth has a sigma of {sigma:.3g} degrees, too large; check the pose covariance"
        )
    return found


def _per_pixel(camera: Camera, pose: Pose, azimuth: Float64Array, slope: Float64Array) -> Float64Array:
    """Return (K, 2, 2): change of (azimuth, slope) a pixel of u and of v, by differences of the projection."""
    step = 1e-5

    def pixels(a: Float64Array, t: Float64Array) -> Float64Array:
        return camera.project(np.stack([np.sin(a), np.cos(a), t], axis=-1) @ pose.rotation)

    here, columns = pixels(azimuth, slope), []
    for da, dt in ((step, 0.0), (0.0, step)):
        ahead, behind = pixels(azimuth + da, slope + dt) - here, here - pixels(azimuth - da, slope - dt)
        # One-sided where the other side leaves the lens's model.
        ahead, behind = np.where(np.isnan(ahead), behind, ahead), np.where(np.isnan(behind), ahead, behind)
        columns.append((ahead + behind) / 2 / step)
    jacobian = np.stack(columns, axis=-1)
    if not np.isfinite(jacobian).all() or (np.abs(np.linalg.det(jacobian)) < 1e-9).any():
        raise RegionError("the region is at the edge of the lens model, where pixels have no direction; check k1")
    return np.asarray(np.linalg.inv(jacobian), np.float64)


DRIFTS = np.array([0.0, 0.0015, 0.004, 0.01, 0.025])  # sigmas of sideways drift (rad) with azimuths of their own
NEXT_DRIFT = np.concatenate([[DRIFTS[1] / 2], np.sqrt(DRIFTS[1:-1] * DRIFTS[2:])])
TURN_SCALE = math.radians(2.0)
MOST_TURNED = math.radians(15.0)
"""Scale and cut-off of the Cauchy distribution of an unnoticed turn of a camera. Small slips are only slightly more
frequent than large ones, and the distribution of their size is unknown."""


@dataclass(frozen=True, eq=False)
class DirectionTable:
    """Marked directions by drift, azimuth and knot: `density` (D, A, J); `slope`, `variance` (A, J) without drift."""

    density: Float64Array
    slope: Float64Array
    variance: Float64Array


def direction_table(directions: MarkedDirections, azimuths: Float64Array, drifting: bool) -> DirectionTable:
    """Tabulate marked places, normal distributions of azimuth and slope; at each azimuth, slopes have one mean."""
    c = directions.covariance
    off = azimuths[:, None, None] - directions.azimuth[None, :, None]
    drifts = DRIFTS if drifting else DRIFTS[:1]
    density = np.zeros((len(drifts), len(azimuths), len(KNOTS)))
    for number, drift in enumerate(drifts):
        variance = c[..., 0, 0] + drift**2
        parts = directions.weights[:, None] / np.sqrt(2 * np.pi * variance) * np.exp(-0.5 * off**2 / variance)
        density[number] = parts.sum(axis=1)
        if number == 0:
            slope = directions.slope[:, None] + c[..., 0, 1] / c[..., 0, 0] * off
            left = c[..., 1, 1] - c[..., 0, 1] ** 2 / c[..., 0, 0]
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = (parts * slope).sum(axis=1) / density[0]
                spread = (parts * (left + slope**2)).sum(axis=1) / density[0] - mean**2
    none = density[0] < 1e-7 * density[0].max()
    density[0][none] = 0.0
    middle, variance = _slope(directions)
    return DirectionTable(density, np.where(none, middle, mean), np.where(none, variance, spread))


def turned_table(directions: MarkedDirections, azimuths: Float64Array) -> DirectionTable:
    """Return the table of a camera turned by an unknown angle: the marked slope, and an equally uncertain azimuth."""
    middle = float(directions.azimuth @ directions.weights)
    spread = float(directions.weights @ (directions.azimuth - middle) ** 2)
    scale, shape = math.sqrt(TURN_SCALE**2 + spread), (len(azimuths), len(KNOTS))
    turned = scale / (scale**2 + (azimuths - middle) ** 2) / (2 * math.atan(MOST_TURNED / scale))
    slope, variance = _slope(directions)
    density = np.broadcast_to(turned[:, None], shape)[None].copy()
    return DirectionTable(density, np.full(shape, slope), np.broadcast_to(variance, shape).copy())


def _slope(directions: MarkedDirections) -> tuple[float, Float64Array]:
    """Return the marked slope, and its variance (J,), over all marked places."""
    slope = float(directions.slope @ directions.weights)
    own = np.asarray(directions.weights @ directions.covariance[..., 1, 1], np.float64)
    return slope, own + float(directions.weights @ (directions.slope - slope) ** 2)


LEVEL_SHARE = 0.1  # minimum standard deviation of heights between nodes, as a share of the raster's cell size
APART_CELLS = 4.0  # distance in cells beyond which height errors of a raster are independent
OTHERWISE = 0.2  # share of wrong cameras whose slope is wrong too
OTHER_SLOPE = 1 / (math.radians(2.0) * ROOT_2PI)
"""Density of the slope of a wrong camera: that of a normal distribution with a sigma of two degrees."""


def level_errors(dem: Dem, config: LocatingConfig) -> tuple[Float64Array, Float64Array]:
    """Return, by raster of the terrain (L,), the variance of heights and their correlation length in metres."""
    resolutions = np.array([level.geometry.resolution for level in dem.levels])
    return np.maximum(config.dem_sigma, LEVEL_SHARE * resolutions) ** 2, APART_CELLS * resolutions


@dataclass(frozen=True, eq=False)
class SightLikelihood:
    """Likelihood of the samples of a fan, (A, R) each. `density`: of the marked direction. `fit`: that over the
    sample's maximum for the best mark. `lifts`: metres above the ground from which something is visible."""

    density: Float64Array
    fit: Float32Array
    lifts: Float32Array


def sight_likelihood(
    fan: SightFan,
    table: DirectionTable,
    height: float,
    bend: float,
    variances: Float64Array,
    apart: Float64Array,
    smoke: bool,
    lean: float = 0.0,
    turned: bool = False,
) -> SightLikelihood:
    """Return the likelihood of each sample given the mark.

    `height`: of the camera, metres. `variances`: of the terrain's heights, by raster of the stack, square metres;
    `apart`: metres beyond which their errors are independent. `smoke`: the lowest visible part of smoke is marked, else
    something on the ground. `lean`: `LocatingConfig.plume_lean`. `turned`: the table is a `turned_table`."""
    shape = fan.heights.shape
    knots = np.clip(np.searchsorted(KNOTS, fan.ranges), 0, len(KNOTS) - 1)
    mark = table.density[0], table.slope, table.variance
    rays = Rays(fan.heights, fan.levels, fan.ranges, knots, height, bend, *mark, variances, apart)
    density, fit, lifts = np.zeros(shape), np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    if not smoke:
        ground_along(rays, density, fit, lifts)
    else:
        hidden, hidden_fit, unseen = np.zeros(shape), np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        found = SmokeDensities(density, hidden, fit, hidden_fit, unseen, lifts)
        rise = math.inf if turned or lean <= 0 else NEXT_DRIFT[0] / lean
        smoke_along(rays, rise, found)
        if not turned:
            add_drifted(rays, fan.widths, table.density, lean, NEXT_DRIFT, found)
            return SightLikelihood(density, fit, lifts)
        # Over all azimuths that a turned camera may have, drift moves nothing in the mean.
        density, fit = density + hidden, fit + hidden_fit
    azimuth = table.density[0][:, knots]
    if turned:
        known = np.isfinite(fan.heights)
        density = (1 - OTHERWISE) * density + OTHERWISE * known * OTHER_SLOPE
        fit = np.where(known, np.maximum(fit, OTHERWISE), 0.0).astype(np.float32)
    peak = table.density[0].max(axis=0)[knots]
    return SightLikelihood(density * azimuth, (fit * (azimuth / peak)).astype(np.float32), lifts)
