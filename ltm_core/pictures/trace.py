"""Draw a traced photo, a fitted pose, the coverage of a viewshed and the cameras of a site."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from ltm_core.base.number_text import percent
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, RgbImage, UInt32Array
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.pictures import MapCamera, RangeScale, overlay_depth, range_legend, with_legend
from ltm_core.pictures.fuel_maps import FuelCanvas
from ltm_core.pictures.legend import UNKNOWN_COLOR, UNLABELLED, Palette, draw_texts
from ltm_core.pictures.maps import interesting_bounds, padded
from ltm_core.pictures.photo_overlays import panel, where_known
from ltm_core.pictures.relief import brightness_at
from ltm_core.raster.dem import Dem
from ltm_core.raster.raster_io import write_geotiff

if TYPE_CHECKING:  # a fifth of a second to load, which `ltm trace` does not need
    from ltm_core.fuel.prior import FuelPrior
    from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon
    from ltm_core.visibility.viewshed import Coverage, PosedCamera

_HORIZON, _OPEN, _RIDGE, _HALO = (255, 230, 60), (255, 150, 40), (80, 230, 255), (20, 20, 20)
_WIDEST = 1600


def pose_fit_picture(
    photo: RgbImage, camera: Camera, horizon: "TerrainHorizon", poses: list[tuple[str, Camera, Pose]]
) -> RgbImage:
    """Return the photo (H, W, 3) of `camera` once for each (title, camera, pose), one under the other, with the
    terrain's horizon (orange where land beyond the DEM may stand over it) and ridges drawn in."""
    step = max(1, -(-camera.width // _WIDEST))
    small = _resized(photo, camera.width // step, camera.height // step)
    width = max(1, round(small.shape[1] / 900))
    c, sheets = horizon.contours, []
    ends = np.flatnonzero(c.following >= 0)
    known = np.flatnonzero((horizon.range[:-1] > 0) & (horizon.range[1:] > 0))
    opened = horizon.open[known]
    ground = horizon.azimuths, np.where(horizon.range > 0, horizon.tangent, 0.0), np.maximum(horizon.range, 1.0)
    for title, lens, pose in poses:
        drawn, lens = small.copy(), lens.resized(small.shape[1], small.shape[0])
        ridge = _pixels(c.azimuth, c.tangent, c.range, lens, pose, horizon.position)
        sky = _pixels(*ground, lens, pose, horizon.position)
        lines = [(ridge[ends], ridge[c.following[ends]], _RIDGE)]
        lines += [(sky[k], sky[k + 1], color) for k, color in ((known[opened], _OPEN), (known[~opened], _HORIZON))]
        for halo in (True, False):
            for here, there, color in lines:
                pairs = np.rint(np.stack([here, there], axis=1) * 16)
                seen = np.isfinite(pairs).all(axis=(1, 2))
                style = (_HALO, width + 2) if halo else (color, width)
                cv2.polylines(drawn, list(pairs[seen].astype(np.int32)), False, *style, cv2.LINE_AA, 4)
        sheets.append(draw_texts(drawn, [(title, 8, 6, "lt")], max(13, small.shape[1] / 60), (255, 255, 255), _HALO))
    return np.concatenate(sheets)


_MEDIAN_ARROW = 0.03  # length of the median arrow of a residual picture, as a share of its width


def residual_picture(
    camera: Camera, pixels: Float64Array, errors: Float64Array, used: BoolArray, photo: RgbImage | None = None
) -> RgbImage:
    """Return the photo, or a grey frame, with an arrow from each marked pixel (N, 2) to its projection, enlarged by the
    factor in the title. Points that were not `used` are red. Arrows along the radius show an error of the lens."""
    scale = min(1.0, _WIDEST / camera.width)
    size = (round(camera.width * scale), round(camera.height * scale))
    drawn = np.full((size[1], size[0], 3), 60, np.uint8) if photo is None else _resized(photo, *size) // 2
    known = np.isfinite(errors).all(axis=1)
    typical = float(np.median(np.hypot(*errors[known].T))) if known.any() else 1.0
    wanted = _MEDIAN_ARROW * size[0] / max(typical * scale, 1e-6)
    factor = max(f for f in (1, 2, 5, 10, 20, 50, 100, 200, 500) if f <= max(wanted, 1))
    for at, error, kept in zip(pixels[known], errors[known], used[known], strict=True):
        # errors are marked minus projected
        tail, head = ((p * scale).round().astype(int).tolist() for p in (at, at - factor * error))
        for line in ((_HALO, 5), (_HORIZON if kept else (255, 80, 60), 2)):
            cv2.arrowedLine(drawn, tail, head, *line, cv2.LINE_AA, tipLength=0.2)
        cv2.circle(drawn, tail, 3, (255, 255, 255), -1, cv2.LINE_AA)
    title = f"marked to projected, x {factor}; median residual {typical:.2f} px"
    return draw_texts(drawn, [(title, 8, 6, "lt")], max(13, size[0] / 60), (255, 255, 255), _HALO)


def _pixels(
    azimuth: Float64Array, tangent: Float64Array, ranges: Float64Array, lens: Camera, pose: Pose, origin: Float64Array
) -> Float64Array:
    """Return the pixels (N, 2) of ground seen from `origin`; NaN beside the image or behind the camera."""
    moved = np.column_stack([np.sin(azimuth), np.cos(azimuth), tangent]) - (pose.position - origin) / ranges[:, None]
    optical = moved @ pose.rotation
    wide = np.hypot(lens.width, lens.height) / lens.fx
    beside = np.hypot(optical[:, 0], optical[:, 1]) > math.tan(min(math.atan(wide), 1.4)) * optical[:, 2]
    optical[beside | (optical[:, 2] <= 0)] = np.nan
    return lens.project(optical)


_SKY_TOP, _SKY_HORIZON = (150, 186, 220), (228, 236, 242)
_SKYLINE = (255, 255, 255)
_SEEN = Palette(("seen",), ((225, 87, 20),))
_WIDEST_TRACE = 2200


def depth_picture(traced: RangeImage, dem: Dem, photo: RgbImage | None = None) -> RgbImage:
    """Return the ranges in colour over the photo or shaded terrain; every n-th pixel if wider than 2200."""
    step = -(-traced.camera.width // _WIDEST_TRACE)
    ranges = traced.range[::step, ::step]
    if step > 1:
        traced = RangeImage(ranges, traced.camera.scaled(step), traced.pose, traced.bend, traced.geometry)
    shown = (shaded_view(traced, dem), 0.6) if photo is None else (_resized(photo, *ranges.shape[::-1]), 0.5)
    base, opacity = shown
    scale = RangeScale.of(ranges)
    picture = draw_skyline(overlay_depth(base, ranges, scale, opacity), ranges)
    return with_legend(picture, range_legend(picture.shape[1], scale, sky=False))


def map_picture(traced: RangeImage, dem: Dem, counts: UInt32Array, title: str, frame: SiteFrame) -> RgbImage:
    """Return the shaded relief with the cells that the photo sees, its camera and its field of view. `counts`: pixels
    per cell, of the DEM's shape. `frame`: of the DEM."""
    horizontal = traced.horizontal()
    known = horizontal[np.isfinite(horizontal)]
    reach = float(known.max()) if known.size else 20 * dem.geometry.resolution
    x, y, _ = (float(v) for v in traced.pose.position)
    camera = MapCamera("camera", traced.camera, (x, y), traced.pose.angles_deg[0], reach)
    about = f"{title}; {percent((counts > 0).mean())} of the DEM; {frame.crs}"
    bounds = interesting_bounds(counts > 0, dem.geometry, [camera.position], dem.geometry)
    canvas = FuelCanvas(dem.geometry, dem, [camera], bounds, (frame.x_origin, frame.y_origin), 1200, about)
    return canvas.classes(np.where(counts > 0, np.uint8(0), np.uint8(UNLABELLED)), _SEEN)


def shaded_view(traced: RangeImage, dem: Dem) -> RgbImage:
    """Return the traced terrain (H, W, 3) as a camera would see it, grey under the relief's lights and a plain sky."""
    known = np.isfinite(traced.range)
    some = known[::2, ::2]  # every second pixel shows no less, for a quarter of the time
    light = np.full(some.shape, 0.7)
    light[some] = np.nan_to_num(brightness_at(dem, *traced.points()[::2, ::2, :2][some].T), nan=0.7)
    grey = np.clip(35 + 250 * light, 0, 255).astype(np.uint8)
    grey = np.asarray(cv2.resize(grey, known.shape[::-1], interpolation=cv2.INTER_LINEAR), np.uint8)
    fade = np.linspace(0, 1, len(known))[:, None, None]
    sky = ((1 - fade) * np.array(_SKY_TOP) + fade * np.array(_SKY_HORIZON)).astype(np.uint8)
    picture = np.repeat(sky, known.shape[1], axis=1)
    picture[np.isnan(traced.range)] = UNKNOWN_COLOR
    return where_known(known, cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), picture)


def draw_skyline(picture: RgbImage, ranges: Float32Array) -> RgbImage:
    """Return `picture` with a line, two pixels thick at 1080p, where known terrain meets the sky."""
    edge = np.isposinf(ranges[:-1]) & np.isfinite(ranges[1:])
    drawn = picture.copy()
    for shift in range(max(1, round(picture.shape[0] / 540))):
        drawn[: edge.shape[0] - shift][edge[shift:]] = _SKYLINE
    return drawn


def _resized(photo: RgbImage, width: int, height: int) -> RgbImage:
    return np.asarray(cv2.resize(photo, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


BANDS = (
    "cameras that see the cell",
    "best footprint of a pixel, longer side, m",
    "height above ground that becomes visible, m",
)


_COVERED = ((140, 146, 158), (255, 236, 170), (253, 180, 80), (226, 96, 50), (130, 25, 75))
_COUNTS = Palette(("not seen", "seen by 1 camera", "by 2 cameras", "by 3 cameras", "by 4 or more"), _COVERED)


def write_coverage(path: Path | str, coverage: "Coverage", frame: SiteFrame) -> None:
    """Write the three bands of BANDS as float32 in the frame's CRS, NaN where there is no value."""
    import rasterio

    count = np.where(coverage.count < 0, np.nan, coverage.count).astype(np.float32)
    geometry = coverage.geometry.translated(frame.x_origin, frame.y_origin, crs=frame.crs)
    write_geotiff(path, np.stack([count, coverage.footprint, coverage.height]), geometry, nodata=float("nan"))
    with rasterio.open(path, "r+") as sink:
        sink.descriptions = BANDS


def coverage_picture(
    coverage: "Coverage", dem: Dem, views: "Sequence[PosedCamera]", title: str, frame: SiteFrame
) -> RgbImage:
    """Return the number of cameras that see each cell over shaded relief, (H, W, 3). `dem`: in its frame."""
    classes = np.clip(coverage.count, 0, len(_COUNTS.names) - 1).astype(np.uint8)
    classes[coverage.count < 0] = UNLABELLED
    g = coverage.geometry
    reach = 0.08 * max(g.x_max - g.x_min, g.y_max - g.y_min)
    offset = (frame.x_origin, frame.y_origin)
    canvas = FuelCanvas(g, dem, [map_camera(view, reach) for view in views], g.bounds, offset, 1200, f"{frame.crs}")
    picture = canvas.classes(classes, _COUNTS)
    return panel([(title, picture)], 1, picture.shape[1])


def map_camera(view: "PosedCamera", reach: float = 3000.0) -> MapCamera:
    """Return a camera with its name, position and field of view, `reach` metres long, for a map."""
    x, y, _ = (float(value) for value in view.pose.position)
    return MapCamera(view.name, view.camera, (x, y), view.pose.angles_deg[0], reach)


def site_picture(
    dem: Dem,
    cameras: Sequence[MapCamera],
    seen: "tuple[Coverage, Coverage] | None",
    prior: "FuelPrior | None",
    offset: tuple[float, float],
    heading: str,
) -> RgbImage:
    """Draw the views of cameras over relief and beside it the prior fuel map, if there is one, (H, W, 3). `dem`,
    `seen`, `prior.geometry`: in the map frame. `seen`: what the views show at any distance, and near enough to vote; a
    camera that turns has several views; None: no view is known. `offset`: of the map frame in its CRS."""
    corners = dem.geometry.bounds
    bounds = padded(np.array([corners[:2], corners[2:], *(camera.position for camera in cameras)]), 0.02)
    reach = 0.14 * (bounds[2] - bounds[0])
    drawn = [replace(camera, reach=reach) for camera in cameras]
    classes, g = np.full((1, 1), UNLABELLED, np.uint8), GridGeometry(bounds[0], bounds[3], 1.0, 1, 1)
    if seen is not None:
        whole, near = seen
        g = whole.geometry
        votes = np.where(near.count > 0, np.clip(near.count, 1, 3) + 1, (whole.count > 0).astype(np.int64))
        classes = np.where(whole.count < 0, UNLABELLED, votes).astype(np.uint8)
    known = None if prior is None else prior.codes != NODATA
    canvas = FuelCanvas(g, dem, drawn, bounds, offset, 900)
    maps = [("Ground that the cameras see" if cameras else "Terrain", canvas.classes(classes, _VIEWS))]
    if prior is not None and known is not None:
        canvas = FuelCanvas(prior.geometry, dem, drawn, bounds, offset, 900)
        maps.append(("Prior fuel map", canvas.codes(prior.codes, None if known.all() else known)))
        if not known.all():
            heading += " Outlined: the area of the prior map."
    return panel(maps, columns=2, width=maps[0][1].shape[1], heading=heading)


_VIEWS = Palette(("not seen", "seen, too far to vote", "votes: 1 view", "2 views", "3 views or more"), _COVERED)
