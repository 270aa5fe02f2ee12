"""Shaded relief and height tints of elevation rasters."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import Float32Array, Float64Array, RgbImage
from ltm_core.raster.dem import Dem

Window = tuple[int, int, int, int]
"""Part of a raster: row, column, height and width."""

# Lights from four sides, north-west strongest: ridges of every direction keep a lit and a dark side.
_LIGHTS = ((315.0, 0.5), (270.0, 0.2), (360.0, 0.2), (225.0, 0.1))
_ALTITUDE_DEG = 45.0
_TINTS = np.array(
    [[122, 150, 112], [168, 182, 128], [214, 204, 152], [196, 166, 124], [168, 138, 116], [238, 236, 234]], np.float32
)
_NODATA = (214, 216, 220)
_SHADE = 0.75
"""Strength of the shade over the height tints, 0 to 1."""
_GREY = 0.7
"""Brightness of cells without height."""
_STRIP_CELLS = 1 << 20
_SPAN_CELLS = 1 << 22


def hillshade(dem: Dem, factor: int = 1, window: Window | None = None) -> Float32Array:
    """Return the brightness (h, w) float32 in [0, 1] of a white matte surface lit from four sides, by Horn's 3 x 3
    differences (1981); NaN without height. `factor`, `window`: as of `drawn`; default: the whole DEM."""
    return drawn(dem, _shade, factor, window)


def drawn(
    dem: Dem, draw: Callable[[Float32Array, float], Float32Array], factor: int = 1, window: Window | None = None
) -> Float32Array:
    """Return what `draw` makes of the heights, as means over `factor` x `factor` cells, strip after strip to save
    memory.

    `draw`: takes heights (h, w) and their resolution, gives (h, w) or (h, w, 3) float32, and may use a cell's
    neighbours. `window`: (row, col, height, width) of the part, multiples of `factor`; default: all whole blocks."""
    rows, cols = dem.elevation.shape
    top, left, height, width = window or (0, 0, rows // factor * factor, cols // factor * factor)
    before, after = min(left, 1), min(cols - left - width, 1)
    at_once = max(factor, _STRIP_CELLS // max(width, 1) // factor * factor)
    strips = []
    for start in range(top, top + height, at_once):
        stop = min(start + at_once, top + height)
        above, below = min(start, 1), min(rows - stop, 1)
        part = dem.elevation[start - above : stop + below, left - before : left + width + after]
        made = draw(part, dem.geometry.resolution)[above : above + stop - start, before : before + width]
        if factor > 1:
            size = width // factor, (stop - start) // factor
            made = cv2.resize(np.ascontiguousarray(made), size, interpolation=cv2.INTER_AREA)
        strips.append(np.asarray(made, np.float32))
    return np.concatenate(strips)


def brightness_at(dem: Dem, x: NDArray[np.floating], y: NDArray[np.floating]) -> Float64Array:
    """Return the hillshade at map points (N,), bilinear; NaN outside the DEM, a middling grey where there is no
    height."""
    row, _ = dem.geometry.to_grid(x, y)
    rows, cols = dem.elevation.shape
    at_once = max(2, _STRIP_CELLS // cols)
    light = np.full(len(row), np.nan)
    first = np.clip(np.floor(row), 0, rows - 2)
    for start in range(0, rows - 1, at_once):
        stop = min(start + at_once, rows - 1)
        here = np.flatnonzero((first >= start) & (first < stop))
        if not len(here):
            continue
        above, below = min(start, 1), min(rows - stop - 1, 1)
        part = dem.elevation[start - above : stop + 1 + below]
        shade = _shade(part, dem.geometry.resolution)[above : above + stop + 1 - start]
        strip = Dem(np.nan_to_num(shade, nan=_GREY), dem.geometry.window(start, 0, stop + 1 - start, cols))
        light[here] = strip.elevation_at(x[here], y[here])
    return light


def _shade(elevation: Float32Array, resolution: float) -> Float32Array:
    east, north = _slopes(elevation, resolution)
    altitude = np.deg2rad(_ALTITUDE_DEG)
    norm = np.sqrt(1.0 + east * east + north * north)
    # Horn's differences leave the middle cell out, so a lone missing height would get a shade.
    shade = np.where(np.isfinite(elevation), np.float32(0), np.float32(np.nan))
    for azimuth_deg, weight in _LIGHTS:
        azimuth = np.deg2rad(azimuth_deg)
        light = np.cos(altitude) * np.array([np.sin(azimuth), np.cos(azimuth)])
        facing = (np.sin(altitude) - east * light[0] - north * light[1]) / norm
        shade += np.float32(weight) * np.clip(facing, 0.0, 1.0)
    return np.asarray(shade, np.float32)


def _slopes(elevation: Float32Array, resolution: float) -> tuple[Float32Array, Float32Array]:
    """Rise per metre to the east and to the north, (H, W) each; NaN next to missing heights."""
    z = np.pad(np.asarray(elevation, np.float32), 1, mode="edge")
    rows = z[:-2] + 2 * z[1:-1] + z[2:]  # weighted over three rows
    cols = z[:, :-2] + 2 * z[:, 1:-1] + z[:, 2:]
    east = (rows[:, 2:] - rows[:, :-2]) / np.float32(8 * resolution)
    north = (cols[:-2] - cols[2:]) / np.float32(8 * resolution)
    return np.asarray(east, np.float32), np.asarray(north, np.float32)


def height_span(elevation: Float32Array) -> tuple[float, float]:
    """Return the 1st and 99th percentile of the known heights, of a large raster those of evenly taken ones; 0 to 1
    where none is known."""
    step = max(1, math.isqrt(elevation.size // _SPAN_CELLS))
    taken = elevation[::step, ::step]
    known = taken[np.isfinite(taken)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, [1, 99])
    return float(low), float(high)


def terrain_colors(dem: Dem, factor: int = 1, window: Window | None = None) -> RgbImage:
    """Return the height tints under shaded relief, (h, w, 3); `factor`, `window`: as
    of `drawn`; default: the whole DEM."""
    low, high = height_span(dem.elevation)

    def draw(elevation: Float32Array, resolution: float) -> Float32Array:
        light = 1.0 + _SHADE * (np.nan_to_num(_shade(elevation, resolution), nan=0.75) / 0.75 - 1.0)
        tints = _tints(elevation, low, high).round()
        return np.asarray(np.clip(tints * light[..., None], 0, 255), np.float32)

    return np.asarray(drawn(dem, draw, factor, window).round(), np.uint8)


def _tints(elevation: Float32Array, low: float, high: float) -> Float64Array:
    known = np.isfinite(elevation)
    place = np.clip((np.where(known, elevation, low) - low) / max(high - low, 1e-3), 0, 1) * (len(_TINTS) - 1)
    stops = np.arange(len(_TINTS))
    tints = np.stack([np.interp(place, stops, _TINTS[:, c]) for c in range(3)], axis=-1)
    tints[~known] = _NODATA
    return tints
