"""Draw the fuel map over relief: life forms, fuel models, certainty, changes and coverage by cameras.

The project's own scales are parts of viridis and cividis, which read the same to colour-blind eyes; fuel models have
LANDFIRE's colours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Int16Array, RgbImage, UInt8Array
from ltm_core.fuel.class_map import CoverageMap
from ltm_core.fuel.codes import FuelSystem, code_colors, code_names, fuel_models
from ltm_core.fuel.decision import FuelLayers, changed_cells
from ltm_core.fuel.life_form import LifeForm
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.legend import (
    INK,
    PAPER,
    UNLABELLED,
    Anchor,
    ClassPalette,
    Palette,
    draw_texts,
    label_legend,
    with_legend,
)
from ltm_core.pictures.maps import draw_north, draw_outline, interesting_bounds, relief, scale_bar, view_of
from ltm_core.pictures.photo_overlays import label_colors
from ltm_core.pictures.sheets import panel, with_axes
from ltm_core.raster.dem import Dem

_UNKNOWN: Final = (235, 235, 232)
_OPACITY: Final = 0.82
_SURE: Final = 0.25
_NO_MORE: Final = 0.85
"""Entropies at which a life form's colour is full and palest."""


@dataclass(frozen=True)
class Scale(Palette):
    """Ranges of a quantity, each with a name and a colour: class k is of values from bounds[k - 1] to bounds[k]."""

    bounds: tuple[float, ...]

    @classmethod
    def of(cls, names: Sequence[str], bounds: Sequence[float], colormap: int, upwards: bool = True) -> Scale:
        """Return the colours evenly from a colour map of OpenCV's, dark to bright or the other way."""
        ramp = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[None], colormap)[0, :, ::-1]
        places = np.linspace(12, 250, len(names)).astype(int)
        chosen = ramp[places if upwards else places[::-1]]
        return cls(tuple(names), tuple((int(r), int(g), int(b)) for r, g, b in chosen), tuple(bounds))

    def classes(self, values: NDArray[Any], known: BoolArray) -> UInt8Array:
        """Return (H, W) classes, UNLABELLED where not known."""
        index = np.digitize(np.nan_to_num(values), self.bounds)
        return np.where(known, index, UNLABELLED).astype(np.uint8)


DOUBT: Final = Scale.of(
    ("below 0.1: sure", "0.1 to 0.2", "0.2 to 0.3", "0.3 to 0.4", "0.4 to 0.5", "0.5 to 0.7", "0.7 and more"),
    (0.1, 0.2, 0.3, 0.4, 0.5, 0.7),
    cv2.COLORMAP_CIVIDIS,
)
"""Share of the maximum entropy of a cell's life forms: 0 certain, 1 unknown."""
FRAMES: Final = Scale.of(
    ("1", "2 to 3", "4 to 7", "8 to 15", "16 to 63", "64 and more"), (2, 4, 8, 16, 64), cv2.COLORMAP_VIRIDIS
)
CAMERAS: Final = Scale.of(("1 camera", "2", "3", "4 to 7", "8 and more"), (2, 3, 4, 8), cv2.COLORMAP_VIRIDIS)
FOOTPRINT: Final = Scale.of(
    ("below 2 m", "2 to 5 m", "5 to 10 m", "10 to 20 m", "20 to 30 m", "30 m and more"),
    (2, 5, 10, 20, 30),
    cv2.COLORMAP_VIRIDIS,
    upwards=False,
)


@dataclass(frozen=True)
class CameraMark:
    """Position of a camera in the frame of the map, metres."""

    name: str
    x: float
    y: float


class FuelCanvas:
    """Draws layers of one fuel grid over the relief of one part of the terrain. Palettes are of life forms
    (`life_form_labels`).

    `geometry`: the fuel grid; `dem` in the same frame. `places`: the cameras. `bounds`: (x_min, y_min, x_max, y_max) of
    the part; default: the whole grid. `offset`: added to coordinates on the axes. `width`: pixels of a map without its
    axes.
    """

    def __init__(
        self,
        geometry: GridGeometry,
        dem: Dem,
        places: Sequence[CameraMark] = (),
        bounds: tuple[float, float, float, float] | None = None,
        offset: tuple[float, float] = (0.0, 0.0),
        width: int = 760,
    ) -> None:
        if bounds is None:
            bounds = interesting_bounds(np.ones(geometry.shape, np.bool_), geometry, (), dem.geometry)
        self.view = view_of(bounds, width)
        self._places, self._offset, self._cell = places, offset, geometry.resolution
        self._shape = geometry.shape
        self._relief = relief(dem, self.view)
        x, y = (self.view.to_map(0, np.arange(self.view.width))[0], self.view.to_map(np.arange(self.view.height), 0)[1])
        row, col = geometry.cell_of(x[None, :], y[:, None])
        self._inside = np.asarray(geometry.contains(row, col))
        self._row, self._col = np.clip(row, 0, geometry.height - 1), np.clip(col, 0, geometry.width - 1)

    def map(self, colors: RgbImage, known: BoolArray, outlined: BoolArray | None = None) -> RgbImage:
        """Return the colours (H, W, 3) of the known cells over relief, others bare; with outlines, cameras, north and
        axes."""
        shown = self._inside & known[self._row, self._col]
        tinted = np.clip(colors[self._row, self._col] * (0.4 + 0.62 * self._relief[..., :1] / 255.0), 0, 255)
        mixed = (self._relief * (1 - _OPACITY) + tinted * _OPACITY).round().astype(np.uint8)
        picture = np.where(shown[..., None], mixed, self._relief)
        if outlined is not None:
            draw_outline(picture, self._inside & outlined[self._row, self._col], self._cell / self.view.resolution)
        return with_axes(self._furnished(picture), self.view, self._offset)

    def classes(self, classes: UInt8Array, palette: ClassPalette, outlined: BoolArray | None = None) -> RgbImage:
        """Return a map of classes (H, W), UNLABELLED none, over its scale bar and the names of the classes that
        occur."""
        picture = self.map(label_colors(classes, palette), classes != UNLABELLED, outlined)
        return self.finished(picture, label_legend(picture.shape[1], palette, np.unique(classes).tolist()))

    def scaled(self, values: NDArray[Any], known: BoolArray, scale: Scale) -> RgbImage:
        """Return a map of values (H, W) where they are known, with the whole scale."""
        picture = self.map(label_colors(scale.classes(values, known), scale), known)
        return self.finished(picture, label_legend(picture.shape[1], scale))

    def codes(self, codes: Int16Array, outlined: BoolArray | None = None) -> RgbImage:
        """Return a map of fuel models (H, W)."""
        picture = self.map(code_colors(codes), codes >= 0, outlined)
        named = code_names(codes)
        legend = Palette(tuple(name for name, _ in named), tuple(color for _, color in named))
        return self.finished(picture, label_legend(picture.shape[1], legend))

    def life_forms(self, layers: FuelLayers, palette: ClassPalette) -> RgbImage:
        """Return a map of life forms, paler where they are less sure, changed cells outlined."""
        colors = faded(layers, palette)
        picture = self.map(colors, layers.life_form != UNLABELLED, layers.changed)
        return self.finished(picture, label_legend(picture.shape[1], palette, np.unique(layers.life_form).tolist()))

    @cached_property
    def tallest(self) -> int:
        """Return the pixels that no finished map exceeds in height: one with the name of every fuel model."""
        every = np.array(sorted(fuel_models().codes(FuelSystem.FBFM40)), np.int16)
        return len(self.codes(np.resize(every, self._shape)))

    def finished(self, picture: RgbImage, legend: RgbImage) -> RgbImage:
        """Return a map with its scale bar and legend under it."""
        bar = scale_bar(self.view)
        margin = picture.shape[1] - bar.shape[1]
        moved = np.full((bar.shape[0], picture.shape[1], 3), PAPER, np.uint8)
        moved[:, margin:] = bar
        return with_legend(picture, moved, legend)

    def _furnished(self, picture: RgbImage) -> RgbImage:
        size = max(12, round(self.view.width / 55))
        texts: list[tuple[str, float, float, Anchor]] = []
        for place in self._places:
            row, col = (float(v) for v in self.view.to_grid(place.x, place.y))
            if not (0 <= row < self.view.height and 0 <= col < self.view.width):
                continue
            centre = round(col), round(row)
            cv2.circle(picture, centre, round(size * 0.42), (255, 255, 255), -1, cv2.LINE_AA)
            cv2.circle(picture, centre, round(size * 0.28), INK, -1, cv2.LINE_AA)
            right = col < 0.75 * self.view.width
            texts.append((place.name, col + (0.7 if right else -0.7) * size, row, "lm" if right else "rm"))
        texts.append(draw_north(picture, size, texts))
        return draw_texts(picture, texts, size, INK, halo=PAPER)


def faded(layers: FuelLayers, palette: ClassPalette) -> RgbImage:
    """Return (H, W, 3) colours of the life forms, fading to paper with the doubt about them, where that is known."""
    colors = label_colors(layers.life_form, palette, _UNKNOWN).astype(np.float64)
    doubt = np.where(layers.life_form == LifeForm.BURNED, 0.0, np.nan_to_num(layers.entropy))
    sure = np.clip((_NO_MORE - doubt) / (_NO_MORE - _SURE), 0, 1)[..., None]
    return np.asarray(np.array(_UNKNOWN) + (0.3 + 0.7 * sure) * (colors - np.array(_UNKNOWN)), np.uint8)


def overlay_picture(layers: FuelLayers, heights: NDArray[np.floating], cell: float, palette: ClassPalette) -> RgbImage:
    """Return (n H, n W, 3): the map alone, for laying over others: life forms over relief from `heights` (H, W) of its
    cells, changed cells outlined."""
    return bare_map(faded(layers, palette), np.ones(heights.shape, np.bool_), heights, cell, layers.changed)


def bare_map(
    colors: RgbImage, shown: BoolArray, heights: NDArray[np.floating], cell: float, outlined: BoolArray
) -> RgbImage:
    """Return (n H, n W, 3): colours (H, W, 3) where they are `shown` over relief from heights (H, W), with outlines
    alone."""
    from scipy import ndimage  # here, for the live pictures do without it, and it takes a fifth of a second to load

    finer = 4
    known = np.isfinite(heights)
    near = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = heights[tuple(near)] if known.any() else np.zeros(heights.shape)
    grid = GridGeometry(0.0, 0.0, cell, heights.shape[1], heights.shape[0])
    canvas = _Bare(grid, Dem(filled.astype(np.float32), grid), (), grid.bounds, width=finer * grid.width)
    return canvas.map(colors, shown, outlined)


class _Bare(FuelCanvas):
    """Without cameras, north and axes."""

    def map(self, colors: RgbImage, known: BoolArray, outlined: BoolArray | None = None) -> RgbImage:
        whole = super().map(colors, known, outlined)
        return whole[: self.view.height, whole.shape[1] - self.view.width :]

    def _furnished(self, picture: RgbImage) -> RgbImage:
        return picture


def fuel_sheet(canvas: FuelCanvas, layers: FuelLayers, palette: ClassPalette) -> RgbImage:
    """Return the life forms and fuel models, and how sure and how widely seen they are, with their legends; of a map of
    which the last two are not known, as of an earlier date, the first two alone."""
    known, seen = np.isfinite(layers.p_max) & np.isfinite(layers.entropy), layers.seen_by > 0
    maps = {
        "Life form. Paler: less certain. Outlined: changed cells.": canvas.life_forms(layers, palette),
        "Surface fuel model. Outlined: changed cells.": canvas.codes(layers.code, layers.changed),
    }
    if known.any() or seen.any():
        maps |= {
            "Uncertainty of the life form: entropy, 0 certain to 1 unknown": canvas.scaled(
                layers.entropy, known, DOUBT
            ),
            "Number of cameras that see a cell": canvas.scaled(layers.seen_by, seen, CAMERAS),
        }
    return _sheet(maps)


def change_sheet(
    canvas: FuelCanvas, before: FuelLayers, after: FuelLayers, palette: ClassPalette, names: tuple[str, str]
) -> RgbImage:
    """Return the life forms and fuel models at two dates, changed cells outlined; `names`: of the dates. A code may
    stand for several life forms: that of an unchanged cell is the one last seen, in both."""
    changed = changed_cells(before.code, after.code)
    then, now = names
    told = f"{int(changed.sum()):,} changed cells"
    stayed = (before.code == after.code) & (before.life_form != UNLABELLED)
    forms = np.where(stayed, after.life_form, before.life_form)
    return _sheet(
        {
            f"life form, {then}": canvas.classes(forms, palette, changed),
            f"life form, {now}; outlined: {told}": canvas.classes(after.life_form, palette, changed),
            f"fuel model, {then}": canvas.codes(before.code, changed),
            f"fuel model, {now}": canvas.codes(after.code, changed),
        }
    )


def coverage_sheet(canvas: FuelCanvas, coverage: CoverageMap) -> RgbImage:
    """Draw, for each camera, how many frames saw each cell, and the smallest ground footprint of a pixel. Raises
    ImageError if no camera has seen anything."""
    maps = {}
    for name, seen in sorted(coverage.cameras.items()):
        maps[f"{name}: number of frames that saw a cell, {_area(seen.frames > 0, coverage)}"] = canvas.scaled(
            seen.frames, seen.frames > 0, FRAMES
        )
        known = np.isfinite(seen.footprint)
        maps[f"{name}: smallest ground footprint of a pixel"] = canvas.scaled(seen.footprint, known, FOOTPRINT)
    return _sheet(maps)


def seen_sheet(canvas: FuelCanvas, by_camera: Mapping[str, BoolArray]) -> RgbImage:
    """Draw, for each camera, the cells (H, W) that it has seen, and how many cameras have seen each. Raises ImageError
    without cameras."""
    maps = {
        f"seen by {name}: {int(cells.sum()):,} cells": canvas.scaled(cells.astype(np.uint8), cells, _SEEN)
        for name, cells in sorted(by_camera.items())
    }
    if len(maps) > 1:
        count = np.sum(list(by_camera.values()), axis=0)
        maps["Number of cameras that see a cell"] = canvas.scaled(count, count > 0, CAMERAS)
    return _sheet(maps)


_SEEN = Scale(("seen",), (CAMERAS.colors[1],), ())


def _area(cells: BoolArray, coverage: CoverageMap) -> str:
    return f"{cells.sum() * coverage.geometry.resolution**2 / 1e6:.2f} sq km"


def _sheet(maps: Mapping[str, RgbImage]) -> RgbImage:
    if not maps:
        raise ImageError("no camera has seen a cell of the fuel map, so there is no coverage to draw")
    return panel(list(maps.items()), columns=2, width=next(iter(maps.values())).shape[1])
