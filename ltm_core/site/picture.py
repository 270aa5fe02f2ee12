"""Draw a site: the terrain that its cameras see, and the prior fuel map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ltm_core.base.types import BoolArray, Int16Array, RgbImage, UInt8Array
from ltm_core.fuel.class_map import code_colors, code_names
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.legend import PAPER, UNLABELLED, label_legend, with_legend
from ltm_core.pictures.maps import (
    MapCamera,
    draw_outline,
    furnished,
    labelled_shade,
    nearest,
    scale_bar,
    view_of,
)
from ltm_core.pictures.sheets import panel, with_axes
from ltm_core.raster.dem import Dem

_WIDTH = 900
"""Width of the map in pixels."""
_REACH = 0.14
"""Length of a camera's sector on the map, as a share of the map's width."""


@dataclass(frozen=True)
class _Palette:
    names: tuple[str, ...]
    colors: tuple[tuple[int, int, int], ...]


_SEEN: Final = _Palette(
    ("seen in no view", "in one", "in two", "in three or more"),
    ((140, 146, 158), (253, 190, 92), (236, 112, 58), (158, 38, 84)),
)


def site_picture(
    dem: Dem,
    cameras: Sequence[MapCamera],
    seen_by: Int16Array | None,
    seen_geometry: GridGeometry | None,
    prior: FuelPrior | None,
    offset: tuple[float, float],
    titles: tuple[str, str],
) -> RgbImage:
    """Draw the cameras' views over relief and beside it the prior fuel map, if there is one, (H, W, 3).

    `dem`, `seen_geometry`, `prior.geometry`: in the map frame. `seen_by`: (h, w) number of views that show a cell, -1
    where the ground is not known, a camera that turns having several; None: no view is known. `offset`: of the map
    frame in its CRS, for the axes. `titles`: of the two maps.
    """
    bounds = _bounds(dem.geometry, cameras)
    view = view_of(bounds, _WIDTH)
    drawn = [MapCamera(c.name, c.camera, c.position, c.azimuth_deg, _REACH * (bounds[2] - bounds[0])) for c in cameras]
    maps = [(titles[0], _coverage(dem, view, drawn, seen_by, seen_geometry, prior, offset))]
    if prior is not None:
        maps.append((titles[1], _prior(dem, view, drawn, prior, offset)))
    return panel(maps, columns=2, width=maps[0][1].shape[1])


def _bounds(geometry: GridGeometry, cameras: Sequence[MapCamera]) -> tuple[float, float, float, float]:
    """Of the DEM, and of cameras beside it."""
    x, y = [c.position[0] for c in cameras], [c.position[1] for c in cameras]
    x_min, x_max = min([geometry.x_min, *x]), max([geometry.x_max, *x])
    y_min, y_max = min([geometry.y_min, *y]), max([geometry.y_max, *y])
    margin = 0.02 * max(x_max - x_min, y_max - y_min)
    return x_min - margin, y_min - margin, x_max + margin, y_max + margin


def _coverage(
    dem: Dem,
    view: GridGeometry,
    cameras: Sequence[MapCamera],
    seen_by: Int16Array | None,
    geometry: GridGeometry | None,
    prior: FuelPrior | None,
    offset: tuple[float, float],
) -> RgbImage:
    if seen_by is None or geometry is None:
        classes, geometry = np.full((1, 1), UNLABELLED, np.uint8), GridGeometry(0.0, 0.0, 1.0, 1, 1)
    else:
        classes = np.where(seen_by < 0, UNLABELLED, np.clip(seen_by, 0, len(_SEEN.names) - 1)).astype(np.uint8)
    picture = labelled_shade(classes, geometry, _SEEN, dem, view, opacity=0.6)
    if prior is not None:
        _outline(picture, prior, view)
    return _finished(picture, view, cameras, offset, label_legend(_WIDTH, _SEEN, _found(classes)))


def _prior(
    dem: Dem, view: GridGeometry, cameras: Sequence[MapCamera], prior: FuelPrior, offset: tuple[float, float]
) -> RgbImage:
    named = code_names(prior.codes)
    palette = _Palette(tuple(name for name, _ in named), tuple(color for _, color in named))
    found = {tuple(color): k for k, color in enumerate(palette.colors)}
    classes = np.full(prior.codes.shape, UNLABELLED, np.uint8)
    for code in np.unique(prior.codes[prior.codes != NODATA]):
        color = tuple(int(v) for v in code_colors(np.array([code], np.int16))[0])
        classes[prior.codes == code] = found[color]
    picture = labelled_shade(classes, prior.geometry, palette, dem, view)
    _outline(picture, prior, view)
    return _finished(picture, view, cameras, offset, label_legend(_WIDTH, palette, _found(classes)))


def _found(classes: UInt8Array) -> list[int]:
    return [int(label) for label in np.unique(classes[classes != UNLABELLED])]


def _outline(picture: RgbImage, prior: FuelPrior, view: GridGeometry) -> None:
    """Return the edge of the ground that the prior knows, where it does not know all of it."""
    known: BoolArray = prior.codes != NODATA
    if not known.all():
        draw_outline(picture, nearest(known.astype(np.uint8), prior.geometry, view, 0) > 0, 8.0)


def _finished(
    picture: RgbImage,
    view: GridGeometry,
    cameras: Sequence[MapCamera],
    offset: tuple[float, float],
    legend: RgbImage,
) -> RgbImage:
    framed = with_axes(furnished(picture, view, cameras, None), view, offset)
    strips = []
    for strip in (scale_bar(view), legend):
        moved = np.full((strip.shape[0], framed.shape[1], 3), PAPER, np.uint8)
        moved[:, framed.shape[1] - strip.shape[1] :] = strip
        strips.append(moved)
    return with_legend(framed, *strips)
