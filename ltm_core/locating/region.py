"""Regions marked in photos, and the settings of locating."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import RegionError
from ltm_core.base.types import BoolArray, Float64Array
from ltm_core.geometry.camera import Camera

MOST_VERTICES = 1_000  # maximum number of vertices of a polygon; outlines of detectors have tens
_COLUMNS = 17  # number of places at which a lower edge is sampled
_OVERLAP = 0.6  # sigma of a sampled place, share of the spacing; the sum is then flat within a few percent
_FOOT = 0.15  # share of a leaning plume's height over which the probability of its base falls by a factor e


@dataclass(frozen=True, eq=False)
class ImageMark:
    """Where an object may meet the ground. `pixels`: (K, 2) u, v; `sigmas`: theirs. `weights`: (K,) sums to 1."""

    pixels: Float64Array
    weights: Float64Array
    sigmas: Float64Array


def marked_pixel(camera: Camera, pixel: ArrayLike, sigma: float, mask: BoolArray | None = None) -> ImageMark:
    """Return the mark of one place (u, v). Raises RegionError if it is outside the image or masked."""
    place = np.asarray(pixel, np.float64)
    if place.shape != (2,) or not np.isfinite(place).all():
        raise RegionError(f"a pixel is two finite numbers u, v, got {place.tolist()}")
    u, v = place
    if not (-0.5 <= u <= camera.width - 0.5 and -0.5 <= v <= camera.height - 0.5):
        raise RegionError(f"pixel ({u:g}, {v:g}) is outside the image of {camera.width} x {camera.height}")
    if _masked(camera, place[None], mask)[0]:
        raise RegionError(f"pixel ({u:g}, {v:g}) is masked and cannot be located")
    return ImageMark(place[None], np.ones(1), np.full((1, 2), sigma))


def marked_box(
    camera: Camera, box: ArrayLike, sigma: float, share: float, smoke: bool, mask: BoolArray | None = None
) -> ImageMark:
    """Return the mark of a box (u_min, v_min, u_max, v_max), as `marked_polygon`."""
    corners = np.asarray(box, np.float64)
    if corners.shape != (4,) or not np.isfinite(corners).all():
        raise RegionError(f"a box is four finite numbers u_min, v_min, u_max, v_max, got {corners.tolist()}")
    u0, v0, u1, v1 = corners
    if u1 < u0 or v1 < v0:
        raise RegionError(f"a box has u_min < u_max and v_min < v_max, got u {u0:g} to {u1:g}, v {v0:g} to {v1:g}")
    outline = np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])
    return marked_polygon(camera, outline, sigma, share, smoke, mask)


def marked_polygon(
    camera: Camera, outline: ArrayLike, sigma: float, share: float, smoke: bool, mask: BoolArray | None = None
) -> ImageMark:
    """Return the mark of the lower edge of a polygon (N, 2) of u, v, sampled evenly along u.

    `sigma`: of a place, pixels, or `share` of the region's height if more. `smoke`: the lowest part is the foot, higher
    parts lean over; else every place of the edge may be it. `mask`: (H, W), True is left out. Raises RegionError: not a
    polygon, outside the image, its lower edge cut off by the border, all masked."""
    points = np.asarray(outline, np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not 1 <= len(points) <= MOST_VERTICES:
        raise RegionError(f"a region has 1 to {MOST_VERTICES} points u, v, got an array of {points.shape}")
    if not np.isfinite(points).all():
        raise RegionError("a region's points must be finite pixels")
    if len(points) == 1:
        return marked_pixel(camera, points[0], sigma, mask)
    (u_low, v_low), (u_high, v_high) = points.min(axis=0), points.max(axis=0)
    if u_high < -0.5 or v_high < -0.5 or u_low > camera.width - 0.5 or v_low > camera.height - 0.5:
        spans = f"u {u_low:g} to {u_high:g}, v {v_low:g} to {v_high:g}"
        raise RegionError(f"the region, {spans}, is outside the image of {camera.width} x {camera.height}")
    if v_high >= camera.height - 1:
        raise RegionError(
            f"the region touches the image's lower edge (row {v_high:g} of {camera.height}), so its base may be "
            "out of view; turn the camera down, or mark the base as a pixel"
        )
    left, right = max(u_low, 0.0), min(u_high, camera.width - 1.0)
    columns = np.linspace(left, right, _COLUMNS) if right - left > sigma else np.array([(left + right) / 2])
    pixels = np.column_stack([columns, _lower_edge(points, columns)])
    pixels = pixels[pixels[:, 1] >= -0.5]  # not where there is no edge either
    pixels = pixels[~_masked(camera, pixels, mask)]
    if not len(pixels):
        raise RegionError("the region's lower edge is masked or above the image; nothing can be located")
    height, edge = float(v_high - v_low), pixels[:, 1]
    weights = np.exp((edge - edge.max()) / max(_FOOT * height, sigma)) if smoke else np.ones(len(pixels))
    own = max(sigma, _OVERLAP * (right - left) / max(1, _COLUMNS - 1)), max(sigma, share * height)
    return ImageMark(pixels, weights / weights.sum(), np.tile(own, (len(pixels), 1)))


def _lower_edge(points: Float64Array, columns: Float64Array) -> Float64Array:
    """Return the greatest v of the outline over each u, NaN where it has none."""
    ends = np.roll(points, -1, axis=0)
    u0, v0, u1, v1 = (a[:, None] for a in (points[:, 0], points[:, 1], ends[:, 0], ends[:, 1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(u1 == u0, 0.0, (columns[None] - u0) / (u1 - u0))
    crossed = (columns[None] >= np.minimum(u0, u1)) & (columns[None] <= np.maximum(u0, u1))
    upright = (u0 == u1) & crossed
    v = np.where(upright, np.maximum(v0, v1), v0 + along * (v1 - v0))
    lowest = np.max(np.where(crossed, v, -np.inf), axis=0)
    return np.asarray(np.where(np.isfinite(lowest), lowest, np.nan), np.float64)


def _masked(camera: Camera, pixels: Float64Array, mask: BoolArray | None) -> BoolArray:
    if mask is None:
        return np.zeros(len(pixels), np.bool_)
    if mask.shape != (camera.height, camera.width):
        raise RegionError(f"a mask of shape {mask.shape} does not fit an image of {camera.height} x {camera.width}")
    col = np.clip(np.rint(pixels[:, 0]), 0, camera.width - 1).astype(np.int64)
    row = np.clip(np.rint(pixels[:, 1]), 0, camera.height - 1).astype(np.int64)
    return np.asarray(mask[row, col], np.bool_)
