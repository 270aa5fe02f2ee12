"""Surveyed control points, located by their pixels with a pose that the *other* points gave."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.locating.locator import Locator
from ltm_core.locating.region import marked_pixel
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting
from ltm_core.pose_estimation.points.control_points import ControlPoints
from ltm_core.pose_estimation.points.resection import resect
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.visibility.point_visibility import pixel_rays


@dataclass(frozen=True)
class LocatedPoint:
    """One point. `error`, `likeliest_error`, `traced_error`: horizontal metres from the surveyed place to the
    posterior's mean, to its likeliest place, and to where the tracer's ray ends (NaN: nowhere). `densest`: the share of
    the densest region at whose edge it lies. `major`, `minor`: half axes of the 95 % ellipse.
    """

    name: str
    range: float
    error: float
    likeliest_error: float
    traced_error: float
    densest: float
    in_50: bool
    in_95: bool
    major: float
    minor: float
    unlocated: str = ""

    def row(self) -> dict[str, Any]:
        """For JSON."""
        return {key: value if value == value else None for key, value in asdict(self).items()}


def located_points(
    points: ControlPoints,
    camera: Camera,
    position: Float64Array,
    dem: Dem,
    bend: float,
    config: LocatingConfig,
) -> Iterator[LocatedPoint]:
    """Leave each point out, fit angles, focal length and k1 to the others, and locate it. The pixel's sigma and the
    focal length's are the fit's own.
    """
    tracer = TerrainTracer(dem, bend > 0)
    for k, name in enumerate(points.names):
        others = np.arange(len(points.names)) != k
        kept = ControlPoints(tuple(np.array(points.names)[others]), points.places[others], points.pixels[others])
        fit = resect(kept, camera, position, bend=bend)
        told = config.model_copy(
            update={"pixel_sigma": fit.sigma_px, "focal_sigma": fit.sigmas.get("fx", 0.0) / fit.camera.fx}
        )
        x, y, _ = (float(v) for v in points.places[k])
        away = math.hypot(x - fit.pose.position[0], y - fit.pose.position[1])
        ray = pixel_rays(fit.camera, points.pixels[k : k + 1]) @ fit.pose.rotation.T
        end = fit.pose.position + ray[0] * float(tracer.trace_rays(fit.pose.position, ray)[0])
        traced = math.hypot(end[0] - x, end[1] - y) if np.isfinite(end).all() else math.nan
        mark = marked_pixel(fit.camera, points.pixels[k], told.pixel_sigma)
        try:
            location = Locator(dem, bend, told).locate(
                [Sighting("camera", fit.camera, fit.pose, fit.pose_covariance, mark)]
            )
        except RegionError as error:
            yield LocatedPoint(
                name, away, math.nan, math.nan, traced, 1.0, False, False, math.nan, math.nan, str(error)
            )
            continue
        posterior = location.posterior
        half, most = posterior.ellipse(0.5), posterior.ellipse(0.95)
        yield LocatedPoint(
            name,
            away,
            math.hypot(posterior.mean[0] - x, posterior.mean[1] - y),
            math.hypot(posterior.likeliest[0] - x, posterior.likeliest[1] - y),
            traced,
            posterior.credibility(x, y),
            posterior.holds(half, x, y),
            posterior.holds(most, x, y),
            most.major,
            most.minor,
        )
