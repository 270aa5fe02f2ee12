"""Shaded relief and height tints of elevation rasters."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import Float32Array, Float64Array, RgbImage
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem

# Lights from four sides, north-west strongest: ridges of every direction keep a lit and a dark side.
_LIGHTS = ((315.0, 0.5), (270.0, 0.2), (360.0, 0.2), (225.0, 0.1))
_ALTITUDE = math.radians(45.0)
_TINTS = np.array(
    [[122, 150, 112], [168, 182, 128], [214, 204, 152], [196, 166, 124], [168, 138, 116], [238, 236, 234]], np.float32
)
_NODATA = (214, 216, 220)
_SHADE = 0.75  # strength of the shade over the height tints, 0 to 1


def coarser(dem: Dem, factor: int, view: GridGeometry | None = None) -> Dem:
    """Return the means of the heights over blocks of `factor` x `factor` cells; NaN if one of them is unknown. `view`:
    only of the blocks under this raster, with two more at each side, and at least two."""
    g = dem.geometry
    rows, cols = (0, g.height // factor), (0, g.width // factor)
    if view is not None:
        top, left = (float(v) / factor for v in g.to_grid(view.x_min, view.y_max))
        bottom, right = (float(v) / factor for v in g.to_grid(view.bounds[2], view.bounds[1]))
        rows, cols = _within(top, bottom, rows[1]), _within(left, right, cols[1])
    size = cols[1] - cols[0], rows[1] - rows[0]
    corner = g.window(rows[0] * factor, cols[0] * factor, size[1] * factor, size[0] * factor)
    heights = dem.elevation[rows[0] * factor : rows[1] * factor, cols[0] * factor : cols[1] * factor]
    if factor > 1:
        heights = np.asarray(cv2.resize(heights, size, interpolation=cv2.INTER_AREA), np.float32)
    return Dem(heights, GridGeometry(corner.x_min, corner.y_max, g.resolution * factor, *size, crs=g.crs))


def _within(first: float, last: float, most: int) -> tuple[int, int]:
    start = min(max(0, math.floor(first) - 2), most - 2)
    return start, max(min(most, math.ceil(last) + 3), start + 2)


def hillshade(dem: Dem) -> Float32Array:
    """Return the brightness (H, W) of a white matte surface lit from four sides (Horn 1981); NaN beside unknowns."""
    z = np.pad(dem.elevation, 1, mode="edge")
    rows = z[:-2] + 2 * z[1:-1] + z[2:]  # weighted over three rows
    cols = z[:, :-2] + 2 * z[:, 1:-1] + z[:, 2:]
    span = np.float32(8 * dem.geometry.resolution)
    shade = _brightness((rows[:, 2:] - rows[:, :-2]) / span, (cols[:-2] - cols[2:]) / span)
    # The differences leave the middle cell out, so a lone missing height would get a shade.
    return np.where(np.isfinite(dem.elevation), shade, np.float32(np.nan)).astype(np.float32)


def brightness_at(dem: Dem, x: NDArray[np.floating], y: NDArray[np.floating]) -> Float64Array:
    """Return the shade at map points (N,) by their slopes over two cells; NaN without heights."""
    r = dem.geometry.resolution
    east = (dem.elevation_at(x + r, y) - dem.elevation_at(x - r, y)) / (2 * r)
    north = (dem.elevation_at(x, y + r) - dem.elevation_at(x, y - r)) / (2 * r)
    return np.asarray(_brightness(east, north), np.float64)


def _brightness(east: NDArray[np.floating], north: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the brightness of surfaces that rise by `east` and `north` a metre."""
    light, norm = np.zeros_like(east), np.sqrt(1 + east * east + north * north)
    for azimuth_deg, weight in _LIGHTS:
        x, y = (math.cos(_ALTITUDE) * f(math.radians(azimuth_deg)) for f in (math.sin, math.cos))
        light += weight * np.clip((math.sin(_ALTITUDE) - east * x - north * y) / norm, 0, 1)
    return light


def terrain_colors(dem: Dem) -> RgbImage:
    """Return the height tints under shaded relief, (H, W, 3), from the 1st to the 99th percentile of the heights."""
    known = np.isfinite(dem.elevation)
    low, high = np.percentile(dem.elevation[known], [1, 99]).tolist() if known.any() else (0.0, 1.0)
    place = np.clip((np.where(known, dem.elevation, low) - low) / max(high - low, 1e-3), 0, 1) * (len(_TINTS) - 1)
    tints = np.stack([np.interp(place, np.arange(len(_TINTS)), _TINTS[:, c]) for c in range(3)], axis=-1)
    tints[~known] = _NODATA
    light = 1.0 + _SHADE * (np.nan_to_num(hillshade(dem), nan=0.75) / 0.75 - 1.0)
    return np.asarray(np.clip(tints * light[..., None], 0, 255).round(), np.uint8)
