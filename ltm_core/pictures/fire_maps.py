"""Draw fires over relief: arrival time, flame length, and their change by an update of the map."""

import math
from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray, RgbImage
from ltm_core.fire.effect import FireEffect, FireScenario
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.life_form import NODATA
from ltm_core.pictures.fuel_maps import FuelCanvas, Scale, bare_map, sheet
from ltm_core.pictures.legend import INK, PAPER, Text, draw_texts, label_legend
from ltm_core.pictures.maps import MapCamera, interesting_bounds
from ltm_core.pictures.photo_overlays import label_colors
from ltm_core.raster.dem import Dem

FLAME: Final = Scale(
    ("below 1.2 m: hand tools", "1.2 to 2.4 m: engines", "2.4 to 3.4 m: hard to control", "3.4 m and more"),
    ((255, 232, 150), (250, 160, 60), (214, 47, 39), (92, 0, 22)),
    (1.2, 2.4, 3.4),
)  # fmt: skip
"""Limits of 4, 8 and 11 feet: the hauling chart (Rothermel 1983; NWCG). Longer flames are redder and darker."""
_SOON: Final = 5 / 60  # hours within which two arrivals count as equal; the model's steps are minutes
_DIVERGING: Final = (
    *((122, 4, 3), (214, 84, 50), (244, 165, 120), (226, 216, 176), (146, 197, 222), (50, 120, 190), (20, 40, 110)),
)
DIFFERENCE: Final = Scale(
    (
        "burns only with the updated map", "earlier by 1 h and more", "earlier by 5 min to 1 h", "the same to 5 min",
        "later by 5 min to 1 h", "later by 1 h and more", "burns only with the previous map",
    ),
    _DIVERGING,
    (0.5, 1.5, 2.5, 3.5, 4.5, 5.5),
)  # fmt: skip
FLAME_DIFFERENCE: Final = Scale(
    (
        "shorter by 2.4 m and more", "shorter by 1.2 to 2.4 m", "shorter by 0.3 to 1.2 m", "the same to 0.3 m",
        "longer by 0.3 to 1.2 m", "longer by 1.2 to 2.4 m", "longer by 2.4 m and more",
    ),
    _DIVERGING[::-1],
    (-2.4, -1.2, -0.3, 0.3, 1.2, 2.4),
)  # fmt: skip


def arrival_scale(hours: float) -> Scale:
    """Return eight spans of time from ignition to the end, in whole or half hours where that fits."""
    edges = np.round(np.linspace(0, hours, 9)[1:-1], 2)
    names = [f"{a:g} to {b:g} h" for a, b in zip([0, *edges], [*edges, hours], strict=True)]
    return Scale.of(names, edges.tolist(), cv2.COLORMAP_INFERNO, upwards=False)


def difference_classes(effect: FireEffect) -> tuple[NDArray[np.floating], BoolArray]:
    """Return (H, W) values on the scale DIFFERENCE, and where there are any. Where one fire alone comes, and only as
    time runs out, the other may come a moment after: that is called the same."""
    a, b = effect.before.burned, effect.after.burned
    was, now = (np.where(run.burned, run.arrival, effect.hours) for run in (effect.before, effect.after))
    later = now - was
    same = np.abs(later) <= _SOON
    value = np.select([same, ~a & b, a & ~b, later <= -1, later < 0, later < 1], [3, 0, 6, 1, 2, 4], default=5)
    return value.astype(float), a | b


def terrain_of(landscape: Landscape) -> Dem:
    """Return the elevations of a landscape as a DEM, unknown ones NaN."""
    band = landscape.band("elevation")
    return Dem(np.where(band == NODATA, np.nan, band).astype(np.float32), landscape.geometry)


def fire_sheet(effect: FireEffect, landscape: Landscape, scenario: FireScenario, heading: str = "") -> RgbImage:
    """Return the arrival and flame length before and after, and their differences, each with the ignition and an arrow
    in the wind's direction; cells whose fuel or canopy has changed are outlined."""
    canvas = _FireCanvas(effect, landscape, scenario)
    arrival = arrival_scale(effect.hours)
    values, known = difference_classes(effect)
    was, now = effect.before, effect.after
    flames_were, flames_are = (run.burned & (run.flame > 0) for run in (was, now))
    changed = effect.flame_difference(), flames_were & flames_are
    updated = "Fire arrival time with the updated map. Outlined: cells whose fuel or canopy changed."
    maps = {
        "Fire arrival time with the previous map": canvas.drawn(was.arrival, was.burned, arrival),
        updated: canvas.drawn(now.arrival, now.burned, arrival),
        "Flame length with the previous map": canvas.drawn(was.flame, flames_were, FLAME),
        "Flame length with the updated map": canvas.drawn(now.flame, flames_are, FLAME),
        "Change of the arrival time by the update": canvas.drawn(values, known, DIFFERENCE),
        "Change of the flame length, where both burn": canvas.drawn(*changed, FLAME_DIFFERENCE),
    }
    return sheet(maps, heading)


def arrival_overlay(effect: FireEffect, landscape: Landscape) -> tuple[RgbImage, RgbImage]:
    """Return the arrival with the updated map, (n H, n W, 3), as an overlay, and its legend."""
    arrival = arrival_scale(effect.hours)
    colors = label_colors(arrival.classes(effect.after.arrival, effect.after.burned), arrival)
    heights = terrain_of(landscape).elevation
    picture = bare_map(colors, effect.after.burned, heights, landscape.geometry.resolution, effect.changed)
    return picture, label_legend(520, arrival)


class _FireCanvas(FuelCanvas):
    """Draws the wind under the north arrow."""

    def __init__(self, effect: FireEffect, landscape: Landscape, scenario: FireScenario) -> None:
        g, self._wind = landscape.geometry, scenario.wind
        self._changed = effect.changed if effect.changed.mean() < 0.5 else None
        x, y = (float(v) for v in g.to_map(scenario.row, scenario.col))
        bounds = interesting_bounds(effect.before.burned | effect.after.burned, g, (), g)
        super().__init__(g, terrain_of(landscape), [MapCamera("ignition", None, (x, y))], bounds, about=g.crs or "")

    def drawn(self, values: NDArray[np.floating], known: BoolArray, scale: Scale) -> RgbImage:
        """Return a map of the known values, changed cells outlined, with its scale."""
        return self.finished(self.map(label_colors(scale.classes(values, known), scale), known, self._changed), scale)

    def _framed(self, picture: RgbImage, names: Sequence[Text]) -> RgbImage:
        reach, towards = 0.035 * self.view.width, math.radians(self._wind.direction + 180)
        x, y = self.view.width - 2.5 * reach, 5.5 * reach
        step = reach * math.sin(towards), -reach * math.cos(towards)
        ends = [(round(x + sign * step[0]), round(y + sign * step[1])) for sign in (-1, 1)]
        for color, width in ((PAPER, 6), (INK, 3)):
            cv2.arrowedLine(picture, ends[0], ends[1], color, width, cv2.LINE_AA, tipLength=0.35)
        label: Text = (f"wind {self._wind.speed:g} m/s", x, y + 1.3 * reach, "mt")
        return super()._framed(draw_texts(picture, [label], 14, INK, PAPER), names)
