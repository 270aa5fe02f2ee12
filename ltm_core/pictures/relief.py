"""Shaded relief and height tints of elevation rasters."""

from __future__ import annotations

import numpy as np

from ltm_core.dem import Dem
from ltm_core.types import Float32Array, RgbImage

# Lights from four sides, north-west strongest: ridges of every direction keep a lit and a dark side.
_LIGHTS = ((315.0, 0.5), (270.0, 0.2), (360.0, 0.2), (225.0, 0.1))
_TINTS = np.array(
    [[122, 150, 112], [168, 182, 128], [214, 204, 152], [196, 166, 124], [168, 138, 116], [238, 236, 234]], np.float32
)
_NODATA = (214, 216, 220)


def hillshade(dem: Dem, altitude_deg: float = 45.0, exaggeration: float = 1.0) -> Float32Array:
    """Brightness (H, W) float32 in [0, 1] of a white matte surface lit from four sides; NaN where there is no height.

    Slopes by Horn's 3 x 3 differences (Horn 1981), the border row and column by the same with repeated edges.
    """
    east, north = _slopes(dem.elevation, dem.geometry.resolution / exaggeration)
    altitude = np.deg2rad(altitude_deg)
    norm = np.sqrt(1.0 + east * east + north * north)
    # Horn's differences leave the middle cell out, so a lone missing height would get a shade.
    shade = np.where(np.isfinite(dem.elevation), np.float32(0), np.float32(np.nan))
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


def hypsometric(elevation: Float32Array, low: float | None = None, high: float | None = None) -> RgbImage:
    """Height tints (H, W, 3), green lowland to white summits, between the 1st and 99th percentile unless given."""
    known = np.isfinite(elevation)
    if low is None or high is None:
        bottom, top = np.percentile(elevation[known], [1, 99]) if known.any() else (0.0, 1.0)
        low, high = (bottom if low is None else low), (top if high is None else high)
    place = np.clip((np.where(known, elevation, low) - low) / max(high - low, 1e-3), 0, 1) * (len(_TINTS) - 1)
    stops = np.arange(len(_TINTS))
    tints = np.stack([np.interp(place, stops, _TINTS[:, c]) for c in range(3)], axis=-1)
    tints[~known] = _NODATA
    return np.asarray(tints.round(), np.uint8)


def terrain_colors(dem: Dem, strength: float = 0.75) -> RgbImage:
    """Height tints under shaded relief, (H, W, 3); `strength` 0 leaves the shade away, 1 applies it fully."""
    shade = hillshade(dem)
    light = 1.0 + strength * (np.nan_to_num(shade, nan=0.75) / 0.75 - 1.0)
    return np.asarray(np.clip(hypsometric(dem.elevation) * light[..., None], 0, 255).round(), np.uint8)
