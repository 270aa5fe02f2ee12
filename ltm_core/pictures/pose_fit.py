"""Draw the horizon and the ridges of the terrain over a photo, by one pose and by another."""

from __future__ import annotations

import math

import cv2
import numpy as np

from ltm_core.base.types import Float64Array, RgbImage
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pictures.legend import draw_texts
from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon

_HORIZON, _OPEN, _RIDGE, _HALO = (255, 230, 60), (255, 150, 40), (80, 230, 255), (20, 20, 20)
_WIDEST = 1600


def pose_fit_picture(
    photo: RgbImage, camera: Camera, horizon: TerrainHorizon, poses: list[tuple[str, Camera, Pose]]
) -> RgbImage:
    """Return the photo (H, W, 3) of `camera` once for each (title, camera, pose), one under the other, with the
    terrain's horizon (orange where land beyond the DEM may stand over it) and ridges drawn in."""
    step = max(1, -(-camera.width // _WIDEST))
    small = cv2.resize(photo, (camera.width // step, camera.height // step), interpolation=cv2.INTER_AREA)
    sheets = []
    for title, lens, pose in poses:
        drawn = small.copy()
        lens = lens.resized(small.shape[1], small.shape[0])
        width = max(1, round(small.shape[1] / 900))
        c = horizon.contours
        ends = np.flatnonzero(c.following >= 0)
        ridge = (c.azimuth, c.tangent, c.range)
        lines = [
            (_pixels(ridge, ends, lens, pose, horizon), _pixels(ridge, c.following[ends], lens, pose, horizon), _RIDGE)
        ]
        sky = (horizon.azimuths, horizon.tangent, np.maximum(horizon.range, 1.0))
        known = np.flatnonzero((horizon.range[:-1] > 0) & (horizon.range[1:] > 0))
        for kind, color in ((horizon.open[known], _OPEN), (~horizon.open[known], _HORIZON)):
            at = known[kind]
            lines.append((_pixels(sky, at, lens, pose, horizon), _pixels(sky, at + 1, lens, pose, horizon), color))
        for halo in (True, False):
            for here, there, color in lines:
                _draw(drawn, here, there, _HALO if halo else color, width + 2 if halo else width)
        sheets.append(draw_texts(drawn, [(title, 8, 6, "lt")], max(13, small.shape[1] / 60), (255, 255, 255), _HALO))
    return np.concatenate(sheets)


def _pixels(
    points: tuple[Float64Array, Float64Array, Float64Array],
    at: np.ndarray[tuple[int, ...], np.dtype[np.int64]],
    camera: Camera,
    pose: Pose,
    horizon: TerrainHorizon,
) -> Float64Array:
    azimuth, tangent, ranges = (values[at] for values in points)
    directions = np.column_stack([np.sin(azimuth), np.cos(azimuth), tangent])
    moved = directions - (pose.position - horizon.position) / ranges[:, None]
    optical = moved @ pose.rotation
    wide = np.hypot(camera.width, camera.height) / camera.fx
    beside = np.hypot(optical[:, 0], optical[:, 1]) > math.tan(min(math.atan(wide), 1.4)) * optical[:, 2]
    optical[beside | (optical[:, 2] <= 0)] = np.nan
    return camera.project(optical)


def _draw(picture: RgbImage, here: Float64Array, there: Float64Array, color: tuple[int, int, int], width: int) -> None:
    seen = np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1)
    lines = np.rint(np.stack([here[seen], there[seen]], axis=1) * 16).astype(np.int32)
    cv2.polylines(picture, list(lines), False, color, width, cv2.LINE_AA, 4)
