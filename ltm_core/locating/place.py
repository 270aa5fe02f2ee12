"""The way back: where cameras see a place of the map, or what hides it, and where to turn them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.locating.sight_fan import sight_fan
from ltm_core.visibility.point_visibility import TOLERANCE, PointState, PointVisibility, line_of_sight_vectors
from ltm_core.visibility.viewshed import PosedCamera

_MARGIN = 3.0
"""A picture that shows a place should be that many times as wide as what is not known of the place."""
_NARROWEST_DEG = 2.0


@dataclass(frozen=True)
class PlaceView:
    """A place as one camera has it.

    `pixel`: u, v, where it lies in the picture, hidden or not; None behind the camera or outside. `state`: seen,
    hidden, outside or unknown. `lift`: metres above the place from which the camera sees it; 0 where it is seen, NaN
    where unknown ground decides. `hidden_by`: x, y, z of the crest before it. `azimuth_deg` (from grid north),
    `pitch_deg`: where to turn. `hfov_deg`: how wide to look, so that what is not known of the place is in view.
    `distance`: horizontal, metres.
    """

    camera: str
    pixel: tuple[float, float] | None
    state: PointState
    lift: float
    hidden_by: tuple[float, float, float] | None
    azimuth_deg: float
    pitch_deg: float
    hfov_deg: float
    distance: float

    @property
    def seen(self) -> bool:
        return self.state is PointState.VISIBLE


def place_views(
    sight: PointVisibility, cameras: Sequence[PosedCamera], place: Float64Array, extent: float = 0.0
) -> list[PlaceView]:
    """Views of a place (3,) by all cameras, in their order. `extent`: metres by which the place may be off.

    Raises RegionError for a place that is not finite, as beside the DEM, where no height is known.
    """
    target = np.asarray(place, np.float64)
    if target.shape != (3,) or not np.isfinite(target).all():
        raise RegionError(f"a place needs three finite coordinates, got {target.tolist()}: is it on the DEM?")
    return [_view(sight, camera, target, extent) for camera in cameras]


def _view(sight: PointVisibility, camera: PosedCamera, place: Float64Array, extent: float) -> PlaceView:
    seen = sight.visible(camera.camera, camera.pose, place[None])
    vector = line_of_sight_vectors(camera.pose.position, place, sight.bend)
    level = math.hypot(vector[0], vector[1])
    state, lift = PointState(int(seen.states[0])), float(seen.lifts[0])
    pixel = seen.pixels[0]
    there = state is not PointState.OUTSIDE and bool(np.isfinite(pixel).all())
    hfov = math.degrees(2 * math.atan2(_MARGIN * extent, max(level, 1.0)))
    return PlaceView(
        camera.name,
        (float(pixel[0]), float(pixel[1])) if there else None,
        state,
        lift,
        _crest(sight, camera, place) if lift > TOLERANCE else None,
        math.degrees(math.atan2(vector[0], vector[1])) % 360.0,
        math.degrees(math.atan2(vector[2], level)),
        min(max(hfov, _NARROWEST_DEG), 120.0),
        level,
    )


def _crest(sight: PointVisibility, camera: PosedCamera, place: Float64Array) -> tuple[float, float, float] | None:
    """The ground that stands highest in the line of sight, as finely as a fan has it; None where none is known."""
    x, y, z = (float(v) for v in camera.pose.position)
    distance = math.hypot(place[0] - x, place[1] - y)
    azimuth = math.atan2(place[0] - x, place[1] - y)
    fan = sight_fan(sight.dem, camera.pose.position, np.array([azimuth, azimuth + 1e-6]), max(distance, 10.0))
    heights = fan.heights[0].astype(np.float64)
    before = np.isfinite(heights) & (fan.ranges < distance)
    if not before.any():
        return None
    slopes = np.where(before, (heights - z) / fan.ranges - sight.bend * fan.ranges, -np.inf)
    at = int(slopes.argmax())
    r = float(fan.ranges[at])
    return x + r * math.sin(azimuth), y + r * math.cos(azimuth), float(heights[at])
