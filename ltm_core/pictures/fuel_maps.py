"""Draw the fuel map over relief: life forms, fuel models, certainty, changes and coverage by cameras.

The project's own scales are parts of viridis and cividis, which read the same to colour-blind eyes. Fuel models have
LANDFIRE's colours, which do not: their names are written on the map."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ImageError, RasterError
from ltm_core.base.number_text import counted, number
from ltm_core.base.types import BoolArray, Int16Array, RgbImage, UInt8Array
from ltm_core.fuel.class_map import CoverageMap
from ltm_core.fuel.codes import code_colors, code_names, fuel_models
from ltm_core.fuel.decision import FuelLayers, changed_cells
from ltm_core.fuel.life_form import NODATA, LifeForm
from ltm_core.geometry.camera import strips
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.legend import UNLABELLED, ClassPalette, Palette, Text, color_map, label_legend, text_width
from ltm_core.pictures.maps import (
    MapCamera,
    cells_under,
    draw_outline,
    finished,
    furnished,
    interesting_bounds,
    relief,
    view_of,
)
from ltm_core.pictures.photo_overlays import label_colors, panel, with_axes
from ltm_core.raster.dem import Dem

_UNKNOWN: Final = (235, 235, 232)
_OPACITY: Final = 0.82
_NAME_SIZE: Final = 11  # height in pixels of fuel models' names on a map
_NAMES: Final = 8  # maximum number of names of one fuel model on a map
_SURE, _NO_MORE = 0.25, 0.85  # entropies at which a life form's colour is full and palest


@dataclass(frozen=True)
class Scale(Palette):
    """Ranges of a quantity, each with a name and a colour: class k is of values from bounds[k - 1] to bounds[k]."""

    bounds: tuple[float, ...]

    @classmethod
    def of(cls, names: Sequence[str], bounds: Sequence[float], colormap: int, upwards: bool = True) -> "Scale":
        """Return the colours evenly from a colour map of OpenCV's, dark to bright or the other way."""
        colors = color_map(colormap)[np.linspace(12, 250, len(names)).astype(int)].tolist()
        return cls(tuple(names), tuple(map(tuple, colors if upwards else colors[::-1])), tuple(bounds))

    def classes(self, values: NDArray[Any], known: BoolArray) -> UInt8Array:
        """Return (H, W) classes, UNLABELLED where not known."""
        return np.where(known, np.digitize(np.nan_to_num(values), self.bounds), UNLABELLED).astype(np.uint8)


DOUBT: Final = Scale.of(
    ("below 0.1: certain", "0.1 to 0.2", "0.2 to 0.35", "0.35 to 0.5", "0.5 to 0.7", "0.7 and more"),
    (0.1, 0.2, 0.35, 0.5, 0.7),
    cv2.COLORMAP_CIVIDIS,
)
"""Share of the maximum entropy of a cell's life forms: 0 certain, 1 unknown."""
_SEEN = ("1", "2 to 3", "4 to 7", "8 to 15", "16 to 63", "64 and more")
FRAMES: Final = Scale.of(_SEEN, (2, 4, 8, 16, 64), cv2.COLORMAP_VIRIDIS)
CAMERAS: Final = Scale.of(("1 camera", "2", "3", "4 to 7", "8 and more"), (2, 3, 4, 8), cv2.COLORMAP_VIRIDIS)
FOOTPRINT: Final = Scale.of(
    ("below 2 m", "2 to 5 m", "5 to 10 m", "10 to 20 m", "20 to 30 m", "30 m and more"),
    (2, 5, 10, 20, 30),
    cv2.COLORMAP_VIRIDIS,
    upwards=False,
)


class FuelCanvas:
    """Draws layers of one fuel grid over the relief of one part of the terrain. Palettes are of life forms
    (`life_form_labels`).

    `geometry`: the fuel grid; `dem` in the same frame. `bounds`: (x_min, y_min, x_max, y_max) of the part; default: the
    whole grid. `offset`: added to coordinates on the axes. `width`: pixels of a map without its axes. `about`: a note
    beside the scale bar. Raises RasterError for rasters in different CRSs."""

    def __init__(
        self,
        geometry: GridGeometry,
        dem: Dem,
        cameras: Sequence[MapCamera] = (),
        bounds: tuple[float, float, float, float] | None = None,
        offset: tuple[float, float] = (0.0, 0.0),
        width: int = 760,
        about: str = "",
    ) -> None:
        known = {g.crs for g in (geometry, dem.geometry) if g.crs is not None}
        if len(known) > 1:
            raise RasterError(f"a map needs its rasters in one CRS, got {' and '.join(sorted(known))}")
        if bounds is None:
            bounds = interesting_bounds(np.ones(geometry.shape, np.bool_), geometry, (), dem.geometry)
        self.view = view_of(bounds, width)
        self._cameras, self._offset, self._about, self._cell = cameras, offset, about, geometry.resolution
        self._shape = geometry.shape
        self._relief = relief(dem, self.view)
        self._row, self._col, self._inside = cells_under(geometry, self.view)

    def map(
        self, colors: RgbImage, known: BoolArray, outlined: BoolArray | None = None, names: Sequence[Text] = ()
    ) -> RgbImage:
        """Return the colours (H, W, 3) of the known cells over relief, with all that a map has. Raises RasterError."""
        if known.shape != self._shape:
            raise RasterError(f"cells of shape {known.shape} do not fit a raster of {self._shape}")
        picture = np.empty_like(self._relief)
        for rows in strips(len(picture)):
            relief, cells = self._relief[rows], (self._row[rows], self._col)
            # Shade the colours too, or steep ground loses its shape under them.
            tinted = np.clip(colors[cells] * (0.4 + 0.62 * relief[..., :1] / 255.0), 0, 255)
            mixed = (relief * (1 - _OPACITY) + tinted * _OPACITY).round().astype(np.uint8)
            picture[rows] = np.where((self._inside[rows] & known[cells])[..., None], mixed, relief)
        if outlined is not None:
            draw_outline(picture, self._inside & outlined[self._row, self._col], self._cell / self.view.resolution)
        return self._framed(picture, names)

    def classes(self, classes: UInt8Array, palette: ClassPalette, outlined: BoolArray | None = None) -> RgbImage:
        """Return a map of classes (H, W), UNLABELLED none, over its scale bar and the names of the classes in it."""
        picture = self.map(label_colors(classes, palette), classes != UNLABELLED, outlined)
        return self.finished(picture, palette, self._within(classes).tolist())

    def scaled(self, values: NDArray[Any], known: BoolArray, scale: Scale) -> RgbImage:
        """Return a map of values (H, W) where they are known, with the part of the scale that they span."""
        classes = scale.classes(values, known)
        found = self._within(classes)
        found = found[found != UNLABELLED]
        span = range(found[0], found[-1] + 1) if len(found) else None
        return self.finished(self.map(label_colors(classes, scale), known), scale, span)

    def codes(self, codes: Int16Array, outlined: BoolArray | None = None) -> RgbImage:
        """Return a map of fuel models (H, W), with their names on the areas that have room for them."""
        shown = np.where(self._inside, codes[self._row, self._col], NODATA)
        picture = self.map(code_colors(codes), codes >= 0, outlined, self._names(shown))
        named = code_names(shown)
        return self.finished(picture, Palette(tuple(name for name, _ in named), tuple(color for _, color in named)))

    def life_forms(self, layers: FuelLayers, palette: ClassPalette) -> RgbImage:
        """Return a map of life forms, paler where they are less sure, changed cells outlined."""
        picture = self.map(faded(layers, palette), layers.life_form != UNLABELLED, layers.changed)
        return self.finished(picture, palette, self._within(layers.life_form).tolist())

    def finished(self, picture: RgbImage, palette: ClassPalette, ids: Iterable[int] | None = None) -> RgbImage:
        """Return a map with its scale bar and the names of the classes `ids` (default: all) under it."""
        return finished(picture, self.view, label_legend(picture.shape[1], palette, ids), note=self._about)

    def _within(self, classes: UInt8Array) -> UInt8Array:
        """Return the classes (N,) in the shown part, UNLABELLED too."""
        return np.unique(np.where(self._inside, classes[self._row, self._col], UNLABELLED).astype(np.uint8))

    def _names(self, codes: Int16Array) -> list[Text]:
        """Return the names of the largest areas of each code (h, w) in the view that have room for one."""
        names: list[Text] = []
        for code in np.unique(codes[codes >= 0]).tolist():
            name, mask = fuel_models().name(code), (codes == code).astype(np.uint8)
            room = np.ones((_NAME_SIZE + 4, text_width(name, _NAME_SIZE) + 2), np.uint8)
            free = cv2.erode(mask, room, borderType=cv2.BORDER_CONSTANT, borderValue=0)
            depth = cv2.distanceTransform(mask, cv2.DIST_L2, 3) * free
            _, areas, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
            largest = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA])[:_NAMES]
            for area in largest.tolist():
                left, top, width, height = stats[area, :4].tolist()
                part = np.s_[top : top + height, left : left + width]
                inside = np.where(areas[part] == area, depth[part], 0)
                row, col = np.unravel_index(int(inside.argmax()), inside.shape)
                if inside[row, col] > 0:
                    names.append((name, float(left + col), float(top + row), "mm"))
        return names

    def _framed(self, picture: RgbImage, names: Sequence[Text]) -> RgbImage:
        return with_axes(furnished(picture, self.view, self._cameras, names), self.view, self._offset)


def faded(layers: FuelLayers, palette: ClassPalette) -> RgbImage:
    """Return (H, W, 3) colours of the life forms, fading to paper with the doubt about them, where that is known."""
    colors = label_colors(layers.life_form, palette, _UNKNOWN).astype(np.float64)
    doubt = np.where(layers.life_form == LifeForm.BURNED, 0.0, np.nan_to_num(layers.entropy))
    sure = np.clip((_NO_MORE - doubt) / (_NO_MORE - _SURE), 0, 1)[..., None]
    return np.asarray(np.array(_UNKNOWN) + (0.3 + 0.7 * sure) * (colors - np.array(_UNKNOWN)), np.uint8)


def overlay_picture(layers: FuelLayers, heights: NDArray[np.floating], cell: float, palette: ClassPalette) -> RgbImage:
    """Return (n H, n W, 3): the map alone, for laying over others: life forms over relief, changes outlined."""
    return bare_map(faded(layers, palette), np.ones(heights.shape, np.bool_), heights, cell, layers.changed)


def bare_map(
    colors: RgbImage, shown: BoolArray, heights: NDArray[np.floating], cell: float, outlined: BoolArray
) -> RgbImage:
    """Return (n H, n W, 3): colours (H, W, 3) where they are `shown` over relief from heights (H, W)."""
    from scipy import ndimage  # here, for the live pictures do without it, and it takes a fifth of a second to load

    finer = 4
    known = np.isfinite(heights)
    near = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = heights[tuple(near)] if known.any() else np.zeros(heights.shape)
    grid = GridGeometry(0.0, 0.0, cell, heights.shape[1], heights.shape[0])
    canvas = _Bare(grid, Dem(filled.astype(np.float32), grid), (), grid.bounds, width=finer * grid.width)
    return canvas.map(colors, shown, outlined)


class _Bare(FuelCanvas):
    """Without names, cameras, north and axes."""

    def _framed(self, picture: RgbImage, names: Sequence[Text]) -> RgbImage:
        return picture


def fuel_sheet(canvas: FuelCanvas, layers: FuelLayers, palette: ClassPalette, heading: str = "") -> RgbImage:
    """Return the life forms and fuel models, and how sure and how widely seen they are, with their legends; of a map of
    which the last two are not known, as of an earlier date, the first two alone."""
    known, seen = np.isfinite(layers.p_max) & np.isfinite(layers.entropy), layers.seen_by > 0
    paler = " Paler: less certain." if known.any() else ""
    maps = {
        f"Life form.{paler} Outlined: changed cells.": canvas.life_forms(layers, palette),
        "Surface fuel model. Outlined: changed cells.": canvas.codes(layers.code, layers.changed),
    }
    if known.any() or seen.any():
        doubt = canvas.scaled(layers.entropy, known, DOUBT)
        maps["Uncertainty of the life form: entropy, 0 certain to 1 unknown"] = doubt
        maps["Number of cameras that see a cell"] = canvas.scaled(layers.seen_by, seen, CAMERAS)
    return sheet(maps, heading)


def change_sheet(
    canvas: FuelCanvas,
    before: FuelLayers,
    after: FuelLayers,
    palette: ClassPalette,
    names: tuple[str, str],
    heading: str = "",
) -> RgbImage:
    """Return the life forms and fuel models at two dates, changed cells outlined; `names`: of the dates. A code may
    stand for several life forms: that of an unchanged cell is the one last seen, in both."""
    changed = changed_cells(before.code, after.code)
    then, now = names
    stayed = (before.code == after.code) & (before.life_form != UNLABELLED)
    forms = np.where(stayed, after.life_form, before.life_form)
    outlined = f"Outlined: {counted(int(changed.sum()), 'changed cell')}."
    maps = {
        f"Life form: {then}": canvas.classes(forms, palette, changed),
        f"Life form: {now}. {outlined}": canvas.classes(after.life_form, palette, changed),
        f"Fuel model: {then}": canvas.codes(before.code, changed),
        f"Fuel model: {now}": canvas.codes(after.code, changed),
    }
    return sheet(maps, heading)


def coverage_sheet(canvas: FuelCanvas, coverage: CoverageMap, heading: str = "") -> RgbImage:
    """Draw, for each camera, how many frames saw each cell, and the smallest footprint. Raises ImageError."""
    if not coverage.cameras:
        raise ImageError("no camera has seen a cell of the fuel map, so there is no coverage to draw")
    maps = {}
    for name, seen in sorted(coverage.cameras.items()):
        hectares = (seen.frames > 0).sum() * coverage.geometry.resolution**2 / 1e4
        title = f"{name}: number of frames that saw a cell, {number(hectares)} ha in all"
        maps[title] = canvas.scaled(seen.frames, seen.frames > 0, FRAMES)
        known = np.isfinite(seen.footprint)
        maps[f"{name}: smallest ground footprint of a pixel"] = canvas.scaled(seen.footprint, known, FOOTPRINT)
    return sheet(maps, heading)


def sheet(maps: Mapping[str, RgbImage], heading: str) -> RgbImage:
    """Return titled maps of one width in two columns under a heading."""
    return panel(list(maps.items()), columns=2, width=next(iter(maps.values())).shape[1], heading=heading)
