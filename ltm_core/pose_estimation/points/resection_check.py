"""Check a resection against the terrain: trace the marked pixels and compare with the surveyed points."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ltm_core.base.types import BoolArray, Float64Array
from ltm_core.pose_estimation.points.resection import Resection
from ltm_core.tracing import TerrainTracer
from ltm_core.visibility.footprint import line_of_sight_vectors, pixel_rays

HIDDEN_BY = 5.0
"""Distance in metres from a surveyed point above which its ray met other ground: the DEM hides the point, or cuts off
the edge on which it is."""


class SurveyedState(StrEnum):
    """State of a surveyed point in the DEM as seen from the fitted camera."""

    SEEN = "seen"
    HIDDEN = "hidden"
    """Other ground is in front of the point."""
    BESIDE = "beside the DEM"
    """No ground is known at the point or on the way to it."""
    BELOW = "below its surface"
    """The point is below the DEM's surface, on which it would be seen."""
    ABOVE = "above its surface"
    """The ray passes above the DEM there: it cuts off the edge or tree on which the point is."""


@dataclass(frozen=True, eq=False)
class TracedErrors:
    """Tracing errors. `errors`: (N,) metres from the traced to the surveyed place, +inf where the pixel meets no known
    terrain. `states`: of each point. `above_ground`: (N,) metres from the DEM's surface up to a point, NaN outside."""

    errors: Float64Array
    states: tuple[SurveyedState, ...]
    above_ground: Float64Array

    @property
    def visible(self) -> BoolArray:
        """Return (N,) whether the ray aimed at the surveyed place itself ends there."""
        return np.array([state is SurveyedState.SEEN for state in self.states])

    @property
    def met(self) -> BoolArray:
        """Return (N,) whether the marked pixel meets known terrain."""
        return np.isfinite(self.errors)


def traced_errors(result: Resection, tracer: TerrainTracer, hidden_by: float = HIDDEN_BY) -> TracedErrors:
    """Trace the marked sub-pixel places of all control points, outliers too."""
    pose, places = result.pose, result.points.places
    directions = pixel_rays(result.camera, result.points.pixels) @ pose.rotation.T
    ranges = tracer.trace_rays(pose.position, directions).astype(np.float64)
    with np.errstate(invalid="ignore"):
        traced = directions * ranges[:, None]
        traced[:, 2] += tracer.bend * (traced[:, 0] ** 2 + traced[:, 1] ** 2)
    errors = np.linalg.norm(traced + pose.position - places, axis=1)
    ground = np.asarray(tracer.dem.elevation_at(places[:, 0], places[:, 1]), np.float64)
    above = places[:, 2] - ground
    # A point that stands off the surface is asked for again where it would stand on it.
    settled = places.copy()
    settled[:, 2] = np.where(np.isnan(ground), places[:, 2], ground)
    beyond, settled_beyond = (_beyond(tracer, pose.position, aims).tolist() for aims in (places, settled))
    states = tuple(_state(*values, hidden_by) for values in zip(above.tolist(), beyond, settled_beyond, strict=True))
    return TracedErrors(np.where(np.isfinite(errors), errors, np.inf), states, above)


def _beyond(tracer: TerrainTracer, position: Float64Array, places: Float64Array) -> Float64Array:
    """Return the metres by which the rays aimed at places end beyond them; negative before them, NaN where that is not
    known."""
    sights = line_of_sight_vectors(position, places, tracer.bend)
    return np.asarray(tracer.trace_rays(position, sights) - np.linalg.norm(sights, axis=1), np.float64)


def _state(above: float, beyond: float, settled_beyond: float, hidden_by: float) -> SurveyedState:
    if abs(beyond) < hidden_by:
        return SurveyedState.SEEN
    if np.isnan(above):
        return SurveyedState.BESIDE
    if abs(settled_beyond) < hidden_by:
        return SurveyedState.ABOVE if above > 0 else SurveyedState.BELOW
    if np.isnan(beyond):
        return SurveyedState.BESIDE
    return SurveyedState.ABOVE if beyond > 0 else SurveyedState.HIDDEN
