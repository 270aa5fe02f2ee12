"""Write the report of an accuracy assessment: one printable HTML page without other files."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from ltm_core.base.number_text import moment_of_stamp
from ltm_core.base.resources import config_path
from ltm_core.base.types import BoolArray, Float64Array, RgbImage
from ltm_core.fuel.class_map import UNSEEN
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.pictures import fit, to_jpeg, to_png
from ltm_core.pictures.legend import Palette
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.disk_io import written_whole
from ltm_core.storage.image_io import decode_rgb
from ltm_core.vision.labels import LabelSet
from ltm_ros.assessment.cell_photos import CellPhoto, PhotoIndex
from ltm_ros.assessment.figures import Figures
from ltm_ros.assessment.plan import NAMES, MapPlan
from ltm_ros.fuel_map.layers import canvas_of, places_of, seen_window
from ltm_ros.fuel_map.source import ACCURACY_FILE
from ltm_ros.pages import inlined, render_page

_VERDICTS: Final = Palette(("map right", "map wrong"), ((0, 114, 178), (213, 94, 0)))
_SHOWN_ERRORS: Final = 10
_RANGES: Final = (500.0, 1000.0, 2000.0, 4000.0, np.inf)
_INCIDENCES: Final = (75.0, 80.0, 85.0, np.inf)
_CROP: Final = 360
"""Width and height in pixels of a photo's part around a cell, at least."""


def write_report(out: Path, plan: MapPlan, figures: Figures, recordings: Sequence[Path]) -> dict[str, Any]:
    """Write the page; return figures that need photos: accuracy by range, incidence and camera. Raises LtmError."""
    site = load_site(Path(plan.shown.site))
    index = PhotoIndex(site, recordings) if recordings else None
    seen = [index.best(cell, plan.shown.cell_m) for cell in figures.cells] if index else None
    tables = [] if seen is None else _tables(figures, seen)
    page = render_page(
        "assessment.html",
        {
            "picture": lambda picture: inlined(to_jpeg(picture, 85), "jpeg"),
            "drawing": lambda picture: inlined(to_png(picture), "png"),
            "interval": interval,
        },
        title=f"Accuracy of the fuel map of {site.name}",
        plan=plan,
        figures=figures,
        names=[NAMES[k] for k in figures.classes],
        hectares=sum(s.cells for s in plan.strata) * plan.shown.cell_m**2 / 1e4,
        maps=_maps(plan, figures, site),
        tables=tables,
        wrong=[] if seen is None else _wrong(figures, seen),
        errors=int((~figures.right).sum()),
    )
    with written_whole(out) as partial:
        partial.write_text(page, encoding="utf-8")
    return {"by": {title: [{"of": n, "cells": k, "right": asdict(s)} for n, k, s in rows] for title, rows in tables}}


def interval(estimate: Any, scale: float = 100, digits: int = 1) -> str:
    """Return the 95 % interval of an estimate as text, in percent by default; "≈": approximate."""
    if estimate.cells == 0:
        return ""
    mark = "≈\u00a0" if estimate.approximate else ""
    return f"{mark}{scale * estimate.low:,.{digits}f} to {scale * estimate.high:,.{digits}f}"


def keep_accuracy(plan: MapPlan, figures: Figures) -> None:
    """Write the overall accuracy beside the assessed map's store, so that exports carry it."""
    store = Path(plan.about["map"]["path"])
    if store.suffix == ".ltm" and store.is_file():
        with written_whole(store.parent / ACCURACY_FILE) as partial:
            partial.write_text(json.dumps({"accuracy": figures.line(plan)}) + "\n", encoding="utf-8")


def _maps(plan: MapPlan, figures: Figures, site: Site) -> list[tuple[str, RgbImage]]:
    """Return the prior map, the updated map and the sampled cells, drawn over relief."""
    dem, grid, map_ = site.open_dem(), site.in_map(plan.grid), plan.map
    places = places_of(site, dem)
    canvas = canvas_of(site, dem, grid, places, seen_window(grid, map_.observed, places))
    palette = life_form_labels(LabelSet.load(config_path(site.labels)))
    verdicts = np.full(grid.shape, UNSEEN, np.uint8)
    for cell, verdict in zip(figures.cells, ~figures.right, strict=True):
        near = np.s_[max(cell.row - 1, 0) : cell.row + 2, max(cell.column - 1, 0) : cell.column + 2]
        verdicts[near] = np.where(verdicts[near] == 1, 1, int(verdict))  # an error stays visible among others
    shown, before = (np.where(map_.observed, one, UNSEEN).astype(np.uint8) for one in (map_.life_form, map_.prior_form))
    return [
        ("Prior map", canvas.classes(before, palette)),
        ("Updated map. Outlined: changed cells", canvas.classes(shown, palette, map_.changed & map_.observed)),
        ("Sampled cells, drawn larger than they are", canvas.classes(verdicts, _VERDICTS)),
    ]


def _cropped(photo: CellPhoto) -> RgbImage:
    """Return the part of a photo around its cell, with the cell's outline."""
    low, high = photo.outline.min(axis=0), photo.outline.max(axis=0)
    side = int(max(_CROP, 1.6 * (high - low).max()))
    picture = np.ascontiguousarray(decode_rgb(photo.jpeg))
    for color, width in (((255, 255, 255), 3), ((213, 40, 130), 1)):
        cv2.polylines(picture, [np.round(photo.outline).astype(np.int32)], True, color, width, cv2.LINE_AA)
    size = np.array([photo.camera.width, photo.camera.height])
    left, top = np.clip(((low + high) / 2 - side / 2).astype(int), 0, np.maximum(size - side, 0)).tolist()
    return fit(picture[top : top + side, left : left + side], _CROP)


def _wrong(figures: Figures, seen: Sequence[Sequence[CellPhoto]]) -> list[dict[str, Any]]:
    """Return the first errors in the order of the sample, which is random, with parts of their photos."""
    found = []
    for index in np.flatnonzero(~figures.right)[:_SHOWN_ERRORS].tolist():
        photos = [
            (f"{p.camera_name}, {moment_of_stamp(p.stamp_ns):%Y-%m-%d %H:%M}, {p.range_m:,.0f} m", _cropped(p))
            for p in seen[index]
        ]
        names = {"mapped": NAMES[figures.mapped[index]], "reference": NAMES[figures.reference[index]]}
        found.append({**vars(figures.cells[index]), "photos": photos, **names})
    return found


Row = tuple[str, int, Any]


def _tables(figures: Figures, seen: Sequence[Sequence[CellPhoto]]) -> list[tuple[str, list[Row]]]:
    """Return accuracies by range, incidence and camera of each cell's best photo, and of cells without a photo."""

    def best(value: Callable[[CellPhoto], float]) -> Float64Array:
        return np.array([min((value(p) for p in photos), default=np.nan) for photos in seen])

    def row(name: str, inside: BoolArray) -> Row:
        return name, int(inside.sum()), figures.sample.ratio(figures.right, inside, "whole")

    def bins(values: Float64Array, edges: Sequence[float], unit: str) -> list[Row]:
        rows, low = [], 0.0
        for high in edges:
            name = f"above {low:,.0f} {unit}" if np.isinf(high) else f"{low:,.0f} to {high:,.0f} {unit}"
            rows.append(row(name, (values >= low) & (values < high)))
            low = high
        return [*rows, row("no photo", np.isnan(values))]

    cameras = sorted({photo.camera_name for photos in seen for photo in photos})
    by_camera = [
        row(name, np.array([any(p.camera_name == name for p in photos) for photos in seen])) for name in cameras
    ]
    every = [
        ("range of the nearest photo", bins(best(lambda p: p.range_m), _RANGES, "m")),
        ("incidence angle", bins(best(lambda p: p.incidence_deg), _INCIDENCES, "degrees")),
        ("camera", by_camera),
    ]
    return [(title, [one for one in rows if one[1]]) for title, rows in every]
