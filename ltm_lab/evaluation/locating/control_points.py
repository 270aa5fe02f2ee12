"""Scores a located place against the true one, and surveyed control points located by the pose of the others."""

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.locating.locator import Locator, Posterior, reach_in_ellipse
from ltm_core.locating.region import marked_pixel
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting
from ltm_core.pose_estimation.points.control_points import ControlPoints
from ltm_core.pose_estimation.points.resection import resect
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.visibility.footprint import pixel_rays


def credibility(posterior: Posterior, x: float, y: float) -> float:
    """Return the share of the probability in cells more probable than that of a place; 1 if it is in none."""
    row, col = (int(v) for v in posterior.geometry.cell_of(x, y))
    here = np.flatnonzero((posterior.rows == row) & (posterior.cols == col))
    return float(posterior.probability[: here[0]].sum()) if len(here) else 1.0


@dataclass(frozen=True)
class PlaceScore:
    """A located place against the true one.

    `error`, `likeliest_error`: metres from the true place to the posterior's mean and to its likeliest place.
    `densest`: share of the densest region at whose edge the true place lies. `in_50`, `in_95`: the ellipse holds it.
    `major`, `minor`: half axes of the 95 % ellipse, metres. `unlocated`: why there is no answer."""

    error: float = math.nan
    likeliest_error: float = math.nan
    densest: float = 1.0
    in_50: bool = False
    in_95: bool = False
    major: float = math.nan
    minor: float = math.nan
    unlocated: str = ""

    @classmethod
    def of(cls, posterior: Posterior, x: float, y: float) -> "PlaceScore":
        half, most = posterior.ellipse(0.5), posterior.ellipse(0.95)
        return PlaceScore(
            math.hypot(posterior.mean[0] - x, posterior.mean[1] - y),
            math.hypot(posterior.likeliest[0] - x, posterior.likeliest[1] - y),
            credibility(posterior, x, y),
            bool(reach_in_ellipse(half, np.array([[x, y]]))[0] <= 1),
            bool(reach_in_ellipse(most, np.array([[x, y]]))[0] <= 1),
            most.major,
            most.minor,
        )


@dataclass(frozen=True)
class LocatedPoint:
    """A control point at `range` metres. `traced_error`: metres to the end of the tracer's ray, NaN if it hits none."""

    name: str
    range: float
    traced_error: float
    place: PlaceScore


def located_points(
    points: ControlPoints, camera: Camera, position: Float64Array, dem: Dem, bend: float, config: LocatingConfig
) -> list[LocatedPoint]:
    """Leave out each point, fit angles, focal length and k1 to the others, and locate the point with the sigmas of the
    pixel and of the focal length that the fit gives."""
    tracer = TerrainTracer(dem, bend > 0)
    found = []
    for k, name in enumerate(points.names):
        others = np.arange(len(points.names)) != k
        kept = ControlPoints(tuple(np.array(points.names)[others]), points.places[others], points.pixels[others])
        fit = resect(kept, camera, position, bend=bend)
        fitted = config.model_copy(
            update={"pixel_sigma": fit.sigma_px, "focal_sigma": fit.sigmas.get("fx", 0.0) / fit.camera.fx}
        )
        x, y, _ = (float(v) for v in points.places[k])
        ray = pixel_rays(fit.camera, points.pixels[k : k + 1]) @ fit.pose.rotation.T
        end = fit.pose.position + ray[0] * float(tracer.trace_rays(fit.pose.position, ray)[0])
        mark = marked_pixel(fit.camera, points.pixels[k], fitted.pixel_sigma)
        sighting = Sighting("camera", fit.camera, fit.pose, fit.pose_covariance, mark)
        try:
            place = PlaceScore.of(Locator(dem, bend, fitted).locate([sighting]).posterior, x, y)
        except RegionError as error:
            place = PlaceScore(unlocated=str(error))
        away = math.hypot(x - fit.pose.position[0], y - fit.pose.position[1])
        traced = math.hypot(end[0] - x, end[1] - y) if np.isfinite(end).all() else math.nan
        found.append(LocatedPoint(name, away, traced, place))
    return found
