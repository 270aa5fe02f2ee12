"""Draw what every map has: shaded relief, cameras, outlines, scale bar and north arrow."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.types import BoolArray, Float64Array, IndexArray, Int32Array, RgbImage
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.legend import (
    INK,
    PAPER,
    Text,
    apart,
    draw_texts,
    metres,
    one_two_five,
    text_width,
    with_legend,
)
from ltm_core.pictures.relief import coarser, hillshade
from ltm_core.raster.dem import Dem

_CHANGED = (230, 0, 140)
SHIFT = 4  # OpenCV draws at 1/16 pixel


@dataclass(frozen=True)
class MapCamera:
    """A camera on a map: its position in the map frame, and its field of view as a sector (metres, degrees). `camera`:
    None marks a position without a sector."""

    name: str
    camera: Camera | None
    position: tuple[float, float]
    azimuth_deg: float = 0.0
    reach: float = 3000.0

    def sector(self, steps: int = 24) -> Float64Array:
        """Return the outline (N, 2) of the sector in map coordinates, from the camera round and back."""
        if self.camera is None:
            return np.array([self.position], np.float64)
        half = self.camera.hfov_deg / 2
        angles = np.deg2rad(np.linspace(self.azimuth_deg - half, self.azimuth_deg + half, steps))
        arc = np.column_stack([np.sin(angles), np.cos(angles)]) * self.reach
        return np.asarray(np.vstack([[0.0, 0.0], arc, [0.0, 0.0]]) + np.asarray(self.position), np.float64)


def draw_outline(picture: RgbImage, mask: BoolArray, cell: float) -> None:
    """Draw the inner edge of the marked pixels in pink, with a white line outside; `cell`: pixels of a grid cell."""
    line = max(1, round(cell / 3.5))
    # Beyond its border a picture neither adds nor takes away.
    sides = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    around = (cv2.dilate(mask.astype(np.uint8), sides) > 0) & ~mask
    edge = mask & (cv2.erode(mask.astype(np.uint8), sides, iterations=line) == 0)
    picture[around] = (255, 255, 255)
    picture[edge] = _CHANGED


def finished(picture: RgbImage, view: GridGeometry, *legends: RgbImage, note: str = "") -> RgbImage:
    """Return a map, which may have axes, over its scale bar, a note beside that, and its legends."""
    strips = []
    for strip in (scale_bar(view, note), *legends):
        paper = np.full((strip.shape[0], picture.shape[1], 3), PAPER, np.uint8)
        paper[:, picture.shape[1] - strip.shape[1] :] = strip
        strips.append(paper)
    return with_legend(picture, *strips)


def scale_bar(view: GridGeometry, note: str = "") -> RgbImage:
    """Return a strip (h, view.width, 3) with a bar of a round length in four parts and a note on the right."""
    size, target = _text_size(view), view.width * view.resolution / 4
    length = max(n for n in one_two_five(target / 10, target) if n <= target)
    strip = np.full((round(size * 2.9), view.width, 3), PAPER, np.uint8)
    top, bottom = round(size * 0.7), round(size * 1.15)
    edges = [size + round(length * part / 4 / view.resolution) for part in range(5)]
    for part in range(4):
        cv2.rectangle(strip, (edges[part], top), (edges[part + 1], bottom), INK, -1 if part % 2 == 0 else 1)
    texts: list[Text] = [("0", edges[0], bottom + size * 0.4, "mt"), (note, view.width - size * 0.5, size, "rm")]
    named = (2, 4) if edges[2] - edges[0] > text_width(metres(length), size) + size else (4,)
    texts += [(metres(length * part / 4), edges[part], bottom + size * 0.4, "mt") for part in named]
    return draw_texts(strip, texts, size, INK)


def relief(dem: Dem, view: GridGeometry) -> RgbImage:
    """Light grey relief at the view's pixel centres, bilinear; paper where there is no terrain."""
    g = dem.geometry
    part = coarser(dem, max(1, min(int(view.resolution / g.resolution), min(g.height, g.width) // 2)), view)
    _, cols = part.geometry.to_grid(view.to_map(0, np.arange(view.width))[0], 0.0)
    rows, _ = part.geometry.to_grid(0.0, view.to_map(np.arange(view.height), 0)[1])
    u, v = (np.ascontiguousarray(np.broadcast_to(at, view.shape), np.float32) for at in (cols, rows[:, None]))
    outside = (float("nan"),) * 4
    shade = cv2.remap(hillshade(part), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)
    grey = np.clip(40 + 225 * np.nan_to_num(shade, nan=0.0), 0, 255)
    grey = np.where(np.isfinite(shade), grey, PAPER[0])
    return np.repeat(grey.round().astype(np.uint8)[..., None], 3, axis=-1)


def cells_under(geometry: GridGeometry, view: GridGeometry) -> tuple[IndexArray, IndexArray, BoolArray]:
    """Return row and column (h, w) of the nearest cell to each of a view's pixels, and whether that is under it."""
    x, y = view.to_map(0, np.arange(view.width))[0], view.to_map(np.arange(view.height), 0)[1]
    row, col = geometry.cell_of(x[None, :], y[:, None])
    inside = np.asarray(geometry.contains(row, col), np.bool_)
    return np.clip(row, 0, geometry.height - 1), np.clip(col, 0, geometry.width - 1), inside


def view_of(bounds: tuple[float, float, float, float], width: int) -> GridGeometry:
    x_min, y_min, x_max, y_max = bounds
    if not (x_max > x_min and y_max > y_min):
        raise RasterError(f"a map needs bounds with x_min < x_max and y_min < y_max, got {bounds}")
    resolution = (x_max - x_min) / width
    return GridGeometry(x_min, y_max, resolution, width, max(1, round((y_max - y_min) / resolution)))


def interesting_bounds(
    mask: BoolArray, geometry: GridGeometry, points: Iterable[Sequence[float]], terrain: GridGeometry
) -> tuple[float, float, float, float]:
    """Return the bounds of marked cells and points (x, y) with a margin, 5:8 or thicker, inside the terrain."""
    places = [tuple(point) for point in points]
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows):
        places += zip(*(v.tolist() for v in geometry.to_map(rows[[0, -1]], cols[[0, -1]])), strict=True)
    if not places:
        return terrain.bounds
    around = padded(np.array(places), 0.04, 20 * geometry.resolution, (0.9, 0.5))
    left, bottom = np.maximum(around[:2], terrain.bounds[:2]).tolist()
    right, top = np.minimum(around[2:], terrain.bounds[2:]).tolist()
    return (left, bottom, right, top) if right > left and top > bottom else terrain.bounds


def padded(
    points: Float64Array, share: float, least: float = 0.0, thinnest: tuple[float, float] = (0.0, 0.0)
) -> tuple[float, float, float, float]:
    """Return the bounds of points (N, 2) with a margin of `share` of their extent, `least` wide and high or more, and
    their width and height `thinnest` of the other or more."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre, half = (low + high) / 2, np.maximum((high - low) / 2 * (1 + 2 * share), least / 2)
    half = np.maximum(half, half[::-1] * thinnest)
    x_min, y_min, x_max, y_max = np.concatenate([centre - half, centre + half]).tolist()
    return x_min, y_min, x_max, y_max


def furnished(
    picture: RgbImage, view: GridGeometry, cameras: Sequence[MapCamera], names: Sequence[Text] = ()
) -> RgbImage:
    """Return the cameras, their names and others, and the north arrow drawn on a map; no name covers another."""
    picture = picture.copy()
    size = _text_size(view)
    shown = [camera for camera in cameras if _draw_camera(picture, view, camera, size)]
    labels = apart([_label(view, camera, size) for camera in shown], size, view.height)
    north = draw_north(picture, size, labels)
    small = draw_texts(picture, list(names), max(11, round(size * 0.75)), INK, halo=PAPER)
    return draw_texts(small, [*labels, north], size, INK, halo=PAPER)


def _text_size(view: GridGeometry) -> int:
    return max(13, round(view.width / 58))


def view_pixels(view: GridGeometry, points: Float64Array) -> Int32Array:
    """Return points (N, 2) of the map as pixels for OpenCV with SHIFT."""
    row, col = view.to_grid(points[:, 0], points[:, 1])
    # Far outside, coordinates would overflow OpenCV's fixed point.
    limit = 50.0 * max(view.shape)
    return np.asarray(np.clip(np.column_stack([col, row]), -limit, limit) * 2**SHIFT, np.int32)


def _draw_camera(picture: RgbImage, view: GridGeometry, camera: MapCamera, size: int) -> bool:
    """Draw a camera; return whether its position or its sector is on the map."""
    white = (255, 255, 255)
    for color, line in ((white, 3), (INK, 1)) if camera.camera is not None else ():
        cv2.polylines(picture, [view_pixels(view, camera.sector())], True, color, line, cv2.LINE_AA, SHIFT)
    row, col = view.to_grid(*camera.position)
    centre = round(float(col)), round(float(row))
    inside = 0 <= centre[0] < view.width and 0 <= centre[1] < view.height
    for color, radius in ((white, 0.42), (INK, 0.3)) if inside else ():
        cv2.circle(picture, centre, round(size * radius), color, -1, cv2.LINE_AA)
    return inside or camera.camera is not None


def _label(view: GridGeometry, camera: MapCamera, size: int) -> Text:
    """Return a camera's name beside it, or behind it where its own sector does not cover it."""
    row, col = (float(v) for v in view.to_grid(*camera.position))
    if camera.camera is None:
        right = col < 0.75 * view.width
        return camera.name, col + (0.7 if right else -0.7) * size, row, "lm" if right else "rm"
    back, half = math.radians(camera.azimuth_deg + 180), text_width(camera.name, size) / 2
    x, y = col + math.sin(back) * (size * 1.2 + half), row - math.cos(back) * size * 1.2
    x = min(max(x, half + size * 0.5), view.width - half - size * 0.5)
    return camera.name, x, min(max(y, size), view.height - size), "mm"


def draw_north(picture: RgbImage, size: int, texts: Sequence[Text] = ()) -> Text:
    """Draw the north arrow in the upper right corner, or in the lower one if a text is in its way; return its N."""
    x, y = picture.shape[1] - 2 * size, size
    if any(place[1] + text_width(place[0], size) > x - size and place[2] < 5 * size for place in texts):
        y = picture.shape[0] - 5 * size
    half, height = round(size * 0.7), round(size * 2.2)
    tip, notch, base = (x, y), (x, y + round(height * 0.72)), [(x + side * half, y + height) for side in (-1, 1)]
    whole = np.array([tip, base[0], notch, base[1]], np.int32)
    cv2.polylines(picture, [whole], True, PAPER, 5, cv2.LINE_AA)
    for corner, color in zip(base, (INK, PAPER), strict=True):
        cv2.fillPoly(picture, [np.array([tip, corner, notch], np.int32)], color, cv2.LINE_AA)
    cv2.polylines(picture, [whole], True, INK, 1, cv2.LINE_AA)
    return "N", x, y + height + size * 0.2, "mt"
