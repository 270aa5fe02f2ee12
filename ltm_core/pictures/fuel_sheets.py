"""Sheets of several fuel maps: classes with their certainty, changes between dates, and coverage by camera."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ltm_core.errors import ImageError
from ltm_core.fuel.coverage import CoverageMap
from ltm_core.fuel.decision import FuelLayers
from ltm_core.pictures.class_palette import ClassPalette
from ltm_core.pictures.fuel_maps import CAMERAS, DOUBT, FOOTPRINT, FRAMES, FuelCanvas, Scale
from ltm_core.pictures.panel import panel
from ltm_core.types import BoolArray, RgbImage


def fuel_sheet(canvas: FuelCanvas, layers: FuelLayers, palette: ClassPalette) -> RgbImage:
    """Life forms and fuel models, and how sure and how widely seen they are, with their legends; of a map of which the
    last two are not known, as of an earlier date, the first two alone."""
    known, seen = np.isfinite(layers.p_max) & np.isfinite(layers.entropy), layers.seen_by > 0
    maps = {
        "life form; paler: less sure; outlined: no longer the prior map's": canvas.life_forms(layers, palette),
        "surface fuel model; outlined: no longer the prior map's": canvas.codes(layers.code, layers.changed),
    }
    if known.any() or seen.any():
        maps |= {
            "doubt about the life form: entropy, 0 certain to 1 nothing known": canvas.scaled(
                layers.entropy, known, DOUBT
            ),
            "cameras that see a cell": canvas.scaled(layers.seen_by, seen, CAMERAS),
        }
    return _sheet(maps)


def change_sheet(
    canvas: FuelCanvas, before: FuelLayers, after: FuelLayers, palette: ClassPalette, names: tuple[str, str]
) -> RgbImage:
    """Life forms and fuel models at two dates, cells whose code differs outlined; `names`: of the dates."""
    changed = before.code != after.code
    then, now = names
    told = f"{int(changed.sum()):,} cells have changed"
    return _sheet(
        {
            f"life form, {then}": canvas.classes(before.life_form, palette, changed),
            f"life form, {now}; outlined: {told}": canvas.classes(after.life_form, palette, changed),
            f"fuel model, {then}": canvas.codes(before.code, changed),
            f"fuel model, {now}": canvas.codes(after.code, changed),
        }
    )


def coverage_sheet(canvas: FuelCanvas, coverage: CoverageMap) -> RgbImage:
    """For each camera, how many frames saw each cell, and how much ground a pixel covered at best.

    Raises ImageError where no camera has seen anything.
    """
    maps = {}
    for name, seen in sorted(coverage.cameras.items()):
        maps[f"{name}: frames that saw a cell, {_area(seen.frames > 0, coverage)}"] = canvas.scaled(
            seen.frames, seen.frames > 0, FRAMES
        )
        known = np.isfinite(seen.footprint)
        maps[f"{name}: ground under a pixel, at best"] = canvas.scaled(seen.footprint, known, FOOTPRINT)
    return _sheet(maps)


def seen_sheet(canvas: FuelCanvas, by_camera: Mapping[str, BoolArray]) -> RgbImage:
    """For each camera, the cells (H, W) that it has seen, and how many cameras have seen each.

    Raises ImageError where there is no camera.
    """
    maps = {
        f"seen by {name}: {int(cells.sum()):,} cells": canvas.scaled(cells.astype(np.uint8), cells, _SEEN)
        for name, cells in sorted(by_camera.items())
    }
    if len(maps) > 1:
        count = np.sum(list(by_camera.values()), axis=0)
        maps["cameras that see a cell"] = canvas.scaled(count, count > 0, CAMERAS)
    return _sheet(maps)


_SEEN = Scale(("seen",), (CAMERAS.colors[1],), ())


def _area(cells: BoolArray, coverage: CoverageMap) -> str:
    return f"{cells.sum() * coverage.geometry.resolution**2 / 1e6:.2f} sq km"


def _sheet(maps: Mapping[str, RgbImage]) -> RgbImage:
    if not maps:
        raise ImageError("no camera has seen any cell of the fuel map: there is no coverage to draw")
    return panel(list(maps.items()), columns=2, width=next(iter(maps.values())).shape[1])
