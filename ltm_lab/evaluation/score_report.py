"""Writes the report of `ltm-lab eval --report`: the paper's figures with a bag's own data, as PNG files and HTML."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ltm_core.base.errors import LtmError, MessageError
from ltm_core.base.resources import config_path
from ltm_core.base.types import RgbImage, UInt8Array
from ltm_core.fuel.cell_counts import UNSEEN
from ltm_core.fuel.fuel_map_io import read_fuel_map
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures import MapCamera, fit, to_jpeg, to_png
from ltm_core.pictures.fuel_maps import CameraMark, change_sheet, coverage_sheet
from ltm_core.raster.dem import Dem
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation import score_figures as draw
from ltm_lab.evaluation.depth.depth_maps_io import DepthMapFolder
from ltm_lab.evaluation.page import render_page
from ltm_lab.evaluation.run_report import Table
from ltm_lab.evaluation.run_score import BagScore
from ltm_lab.evaluation.score_tables import shown, tables
from ltm_ros.fuel_map.pictures import canvas_of, seen_window
from ltm_ros.fuel_map.source import FuelSource
from ltm_ros.recordings.recorded_run import Recorded, last_fuel_map

WIDEST = 1800
"""Pixels of a picture in the page; the PNG beside it has them all."""


@dataclass(frozen=True, eq=False)
class Figure:
    """One figure of the page; `file`: the PNG's name."""

    section: str
    file: str
    picture: RgbImage
    caption: str


@dataclass(frozen=True)
class ReportInputs:
    """What the report draws from besides the bag: an earlier run, real photos, depth maps of others."""

    before: Recorded | None = None
    photos: Path | None = None
    folders: Sequence[DepthMapFolder] = ()


def write_eval_report(
    out: Path,
    recorded: Recorded,
    score: BagScore,
    inputs: ReportInputs,
    progress: Callable[[str], None] = lambda what: None,
) -> Path:
    """Draw every figure that the bag has data for into `out`, and `report.html`; its path. Raises LtmError."""
    out.mkdir(parents=True, exist_ok=True)
    figures, lacking = figures_of(recorded, inputs, progress)
    for figure in figures:
        (out / figure.file).write_bytes(to_png(figure.picture))
    page = out / "report.html"
    page.write_text(_render(recorded, score, figures, [*score.lacking, *lacking]), encoding="utf-8")
    return page


def figures_of(
    recorded: Recorded, inputs: ReportInputs, progress: Callable[[str], None] = lambda what: None
) -> tuple[list[Figure], list[str]]:
    """The figures in the order of the page, and what is lacking for others."""
    site = recorded.site
    labels = LabelSet.load(config_path(site.labels))
    dem = site.open_dem()
    grid = site.fuel_geometry(dem)
    progress("reading frames")
    seen = draw.views(recorded.stream(), site, inputs.folders)
    pins, cameras = draw.pins(seen), draw.map_cameras(seen)
    figures: list[Figure] = []
    lacking: list[str] = []

    progress("terrain")
    extent = f"{dem.geometry.width} x {dem.geometry.height} heights, one each {dem.geometry.resolution:g} m"
    figures += [
        Figure("Terrain", "dem_2d.png", draw.terrain_2d(dem, cameras), f"The elevation raster: {extent}."),
        Figure("Terrain", "dem_3d.png", draw.terrain_3d(dem, pins), "The same raster as terrain, heights 1.5 times."),
    ]

    progress("segmentation")
    photos = draw.real_photos(inputs.photos, 2) if inputs.photos is not None else []
    segmenter = Segmenter.open(site.model) if photos else None
    if not photos:
        lacking.append("figure of real pictures: name a folder of photos with --photos")
    labelled = [view for view in seen if view.labels is not None]
    if labelled or photos:
        pair = _one_a_camera(labelled)
        figures.append(
            Figure(
                "Segmentation",
                "segmentation.png",
                draw.segmentation_pairs(pair, photos, segmenter, labels),
                "Vegetation of real and simulated pictures as the same network labels it.",
            )
        )
        against = draw.truth_and_labels(pair, labels)
        if against is not None:
            figures.append(
                Figure(
                    "Segmentation",
                    "segmentation_truth.png",
                    against,
                    "Simulated pictures with their true classes and the network's labels.",
                )
            )

    progress("depth")
    for number, view in enumerate(view for view in seen if view.depths):
        figures.append(
            Figure(
                "Depth",
                f"depth_{number + 1}_{view.camera_name}.png",
                draw.depth_panels(view),
                f"{view.name}: true depth, each source of depth in the same colours, and its error.",
            )
        )

    progress("fuel maps")
    figures += _fuel_figures(recorded, inputs, labels, grid, seen, lacking)
    return figures, lacking


def _fuel_figures(
    recorded: Recorded,
    inputs: ReportInputs,
    labels: LabelSet,
    grid: GridGeometry,
    seen: Sequence[draw.ScoredView],
    lacking: list[str],
) -> list[Figure]:
    site, dem = recorded.site, recorded.site.open_dem()
    cameras = draw.map_cameras(seen)
    figures: list[Figure] = []
    try:
        now = draw.camera_maps(recorded, grid, labels)
        earlier = {} if inputs.before is None else draw.camera_maps(inputs.before, grid, labels)
    except MessageError as error:
        lacking.append(f"figure of fuel maps: {error}; recorded by another version, so replay it again")
        return figures
    if not now:
        lacking.append("figure of fuel maps: the bag has no fuel/votes")
        return figures
    rows = []
    if inputs.before is not None:
        rows.append(("before", earlier))
        rows += _truth_rows(inputs.before, "truth before", list(now), grid)
    else:
        lacking.append("fuel maps before the change: name the earlier run with --before")
    rows.append(("after" if inputs.before is not None else "as mapped", now))
    rows += _truth_rows(recorded, "truth after" if inputs.before is not None else "truth", list(now), grid)
    side = min(draw.MAP_SIDE, *(high - low for low, high in _extents(dem.geometry)))
    figures.append(
        Figure(
            "Fuel maps",
            "fuel_maps.png",
            draw.fuel_maps(rows, now, grid, dem, cameras, labels),
            f"Fuel maps over {side:,.0f} x {side:,.0f} m of two cameras, each from its own votes, and the "
            "truth of all cells.",
        )
    )
    try:
        classes, geometry, _ = last_fuel_map(recorded.bag, site)
    except LtmError:
        lacking.append("fuel map of all cameras in 3D: the bag has no fuel_map")
        return figures
    figures.append(
        Figure(
            "Fuel maps",
            "fuel_3d.png",
            draw.fuel_3d(dem, classes, site.in_map(geometry), labels, draw.pins(seen)),
            "The fuel map of all cameras on the terrain.",
        )
    )
    return [*figures, *_change_figures(recorded, inputs, dem, cameras)]


def _change_figures(recorded: Recorded, inputs: ReportInputs, dem: Dem, cameras: Sequence[MapCamera]) -> list[Figure]:
    """What has changed in the map, since the earlier run or from the prior on, and what each camera saw of it."""
    places = [CameraMark(camera.name, *camera.position) for camera in cameras if camera.name]
    figures: list[Figure] = []
    with FuelSource.open(recorded.bag, recorded.site) as now:
        grid, before, name = recorded.site.in_map(now.geometry), now.empty, "the prior map"
        if inputs.before is not None:
            with FuelSource.open(inputs.before.bag, inputs.before.site) as earlier:
                before, name = earlier.layers, "the earlier run"
        coverage = now.coverage()
        assert coverage is not None, "the bag has votes"  # nosec B101 # tells the type checker what holds
        window = seen_window(grid, coverage.count() > 0, places)
        canvas = canvas_of(recorded.site, dem, grid, places, window)
        palette = life_form_labels(now.labels)
        if (before.code >= 0).any():
            names = (name, "after this run")
            sheet = change_sheet(canvas, before, now.layers, palette, names)
            figures.append(
                Figure(
                    "Fuel maps", "fuel_change.png", sheet, f"The fuel map against {name}; outlined: what has changed."
                )
            )
    told = "In how many frames each camera saw a cell, and how much ground lay under one of its pixels at best."
    figures.append(Figure("Fuel maps", "fuel_coverage.png", coverage_sheet(canvas, coverage), told))
    return figures


def _truth_rows(
    recorded: Recorded, name: str, cameras: Sequence[str], grid: GridGeometry
) -> list[tuple[str, dict[str, UInt8Array]]]:
    """The true classes of all cells, for each camera; none where no truth lies beside the bag."""
    file = recorded.life_forms
    if file is None:
        return []
    classes, geometry = read_fuel_map(file)
    here = recorded.site.in_map(geometry)
    rows, cols = np.indices(grid.shape)
    row, col = here.cell_of(*grid.to_map(rows, cols))
    inside = here.contains(row, col)
    truth = np.full(grid.shape, UNSEEN, np.uint8)
    truth[inside] = classes[row[inside], col[inside]]
    return [(name, dict.fromkeys(cameras, truth))]


def _extents(geometry: GridGeometry) -> list[tuple[float, float]]:
    x_min, y_min, x_max, y_max = geometry.bounds
    return [(x_min, x_max), (y_min, y_max)]


def _one_a_camera(seen: Sequence[draw.ScoredView], most: int = 2) -> list[draw.ScoredView]:
    """The first view of each camera."""
    return list({view.camera_name: view for view in reversed(seen)}.values())[::-1][:most]


def _render(recorded: Recorded, score: BagScore, figures: Sequence[Figure], lacking: Sequence[str]) -> str:
    sections: dict[str, list[Figure]] = {}
    for figure in figures:
        sections.setdefault(figure.section, []).append(figure)
    parts: list[Table] = [table for table in tables(score) if table.title != "lacking"]
    return render_page(
        "score_report.html",
        {"picture": _picture, "shown": shown},
        title=f"Evaluation of {recorded.site.name}",
        bag=str(recorded.bag),
        score=score,
        tables=parts,
        sections=sections,
        lacking=lacking,
        model=recorded.site.model,
    )


def _picture(picture: RgbImage) -> str:
    fitted = fit(picture, WIDEST) if picture.shape[1] > WIDEST else picture
    return "data:image/jpeg;base64," + base64.b64encode(to_jpeg(fitted, 90)).decode("ascii")
