"""Draw a traced photo, a fitted pose and the coverage of a viewshed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.types import Float32Array, Float64Array, RgbImage, UInt8Array, UInt32Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.pictures import (
    MapCamera,
    RangeScale,
    fuel_map_picture,
    overlay_depth,
    range_legend,
    terrain_map_picture,
    with_legend,
)
from ltm_core.pictures.legend import Palette, draw_texts
from ltm_core.pictures.relief import brightness_at
from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon
from ltm_core.raster.dem import Dem
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.visibility.viewshed import Coverage, PosedCamera

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


_SKY_TOP, _SKY_HORIZON = (150, 186, 220), (228, 236, 242)
_UNKNOWN = (70, 70, 74)
_SKYLINE = (255, 255, 255)
_WIDEST_TRACE = 2200


def depth_picture(traced: RangeImage, dem: Dem, photo: RgbImage | None = None) -> RgbImage:
    """Return the ranges in colour over the photo (H, W, 3), or over shaded terrain without one, with skyline and
    legend; at every n-th pixel if wider than 2200 pixels."""
    step = -(-traced.camera.width // _WIDEST_TRACE)
    ranges = traced.range[::step, ::step]
    traced = RangeImage(ranges, traced.camera.scaled(step), traced.pose, traced.bend, traced.geometry)
    if photo is None:
        base, opacity = shaded_view(traced, dem), 0.6
    else:
        base, opacity = _shrunk(photo, ranges.shape), 0.5
    scale = RangeScale.of(ranges)
    picture = draw_skyline(overlay_depth(base, ranges, scale, opacity), ranges)
    return with_legend(picture, range_legend(picture.shape[1], scale, sky=False))


def map_picture(traced: RangeImage, dem: Dem, counts: UInt32Array, title: str | None = None) -> RgbImage:
    """Return the shaded relief with the cells that the photo sees, its camera and its field of view. `counts`: pixels
    per cell, of the DEM's shape."""
    horizontal = traced.horizontal()
    known = horizontal[np.isfinite(horizontal)]
    reach = float(known.max()) if known.size else 20 * dem.geometry.resolution
    x, y, _ = (float(v) for v in traced.pose.position)
    camera = MapCamera("camera", traced.camera, (x, y), traced.pose.angles_deg[0], reach)
    return terrain_map_picture(dem, counts > 0, [camera], title=title)


def shaded_view(traced: RangeImage, dem: Dem) -> RgbImage:
    """Return the traced terrain as a camera would see it, grey under the relief's lights, under a plain sky, (H, W,
    3)."""
    height, width = traced.range.shape
    fade = np.linspace(0, 1, height)[:, None, None]
    picture = np.broadcast_to(
        (1 - fade) * np.array(_SKY_TOP) + fade * np.array(_SKY_HORIZON), (height, width, 3)
    ).copy()
    picture[np.isnan(traced.range)] = _UNKNOWN
    known = np.isfinite(traced.range)
    points = traced.points()[known]
    light = brightness_at(dem, points[:, 0], points[:, 1])
    picture[known] = (35 + 250 * np.nan_to_num(light, nan=0.7))[:, None]
    return np.asarray(np.clip(picture, 0, 255), np.uint8)


def draw_skyline(picture: RgbImage, ranges: Float32Array) -> RgbImage:
    """Return `picture` with a line, two pixels thick at 1080p, where terrain meets the sky above it; not where unknown
    ground does."""
    edge = np.isposinf(ranges[:-1]) & np.isfinite(ranges[1:])
    thickness = max(1, round(picture.shape[0] / 540))
    drawn = picture.copy()
    for shift in range(thickness):
        drawn[: edge.shape[0] - shift][edge[shift:]] = _SKYLINE
    return drawn


def _shrunk(photo: RgbImage, shape: tuple[int, ...]) -> RgbImage:
    if photo.shape[:2] == shape:
        return photo
    return np.asarray(cv2.resize(photo, shape[::-1], interpolation=cv2.INTER_AREA), np.uint8)


BANDS = (
    "cameras that see the cell",
    "best footprint of a pixel, longer side, m",
    "height above ground that becomes visible, m",
)


_PALETTE = Palette(
    ("not seen", "1 camera", "2 cameras", "3 cameras", "4 or more"),
    ((92, 98, 112), (253, 190, 92), (243, 130, 62), (214, 68, 66), (140, 32, 92)),
)


def write_coverage(path: Path | str, coverage: Coverage, frame: SiteFrame) -> None:
    """Write the three bands of BANDS as float32 in the frame's CRS, NaN where there is no value."""
    import rasterio

    count = np.where(coverage.count < 0, np.nan, coverage.count).astype(np.float32)
    geometry = coverage.geometry.translated(frame.x_origin, frame.y_origin, crs=frame.crs)
    write_geotiff(path, np.stack([count, coverage.footprint, coverage.height]), geometry, nodata=float("nan"))
    with rasterio.open(path, "r+") as sink:
        sink.descriptions = BANDS


def coverage_picture(
    coverage: Coverage, dem: Dem, views: Sequence[PosedCamera], title: str | None = None
) -> UInt8Array:
    """Return the number of cameras that see each cell over shaded relief, RGB (H, W, 3), with cameras and legend.
    `dem`: in the frame of the coverage."""
    classes = np.clip(coverage.count, 0, len(_PALETTE.names) - 1).astype(np.uint8)
    classes[coverage.count < 0] = 255
    reach = 0.08 * max(
        coverage.geometry.x_max - coverage.geometry.x_min, coverage.geometry.y_max - coverage.geometry.y_min
    )
    cameras = [
        MapCamera(
            view.name,
            view.camera,
            (float(view.pose.position[0]), float(view.pose.position[1])),
            view.pose.angles_deg[0],
            reach,
        )
        for view in views
    ]
    return fuel_map_picture(classes, coverage.geometry, _PALETTE, dem, cameras, coverage.geometry.bounds, title=title)
