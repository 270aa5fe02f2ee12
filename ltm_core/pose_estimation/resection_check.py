"""Checks a resection against the terrain: traces the marked pixels and compares with the surveyed points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.pose_estimation.resection import Resection
from ltm_core.tracing import TerrainTracer
from ltm_core.types import BoolArray, Float64Array
from ltm_core.visibility.line_of_sight import line_of_sight_vectors, pixel_rays

HIDDEN_BY = 5.0
"""Metres: a ray aimed at a surveyed point that ends this far from it met other ground: the DEM hides the point, or cuts
off the edge on which it stands."""


@dataclass(frozen=True, eq=False)
class TracedErrors:
    """`errors`: (N,) metres from the traced to the surveyed place, +inf where the pixel meets no known terrain.
    `visible`: (N,) whether the ray aimed at the surveyed place itself ends there.
    """

    errors: Float64Array
    visible: BoolArray


def traced_errors(result: Resection, tracer: TerrainTracer, hidden_by: float = HIDDEN_BY) -> TracedErrors:
    """Trace the marked sub-pixel places of all control points, outliers too."""
    pose, places = result.pose, result.points.places
    directions = pixel_rays(result.camera, result.points.pixels) @ pose.rotation.T
    ranges = tracer.trace_rays(pose.position, directions).astype(np.float64)
    with np.errstate(invalid="ignore"):
        traced = directions * ranges[:, None]
    traced[:, 2] += tracer.bend * (traced[:, 0] ** 2 + traced[:, 1] ** 2)
    errors = np.linalg.norm(traced + pose.position - places, axis=1)
    sights = line_of_sight_vectors(pose.position, places, tracer.bend)
    met = tracer.trace_rays(pose.position, sights)
    visible = np.abs(met - np.linalg.norm(sights, axis=1)) < hidden_by
    return TracedErrors(np.where(np.isfinite(errors), errors, np.inf), visible)
