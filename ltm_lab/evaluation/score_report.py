"""Write the report of `ltm-lab eval BAG --report`: scores, and pictures of labels, depth and fuel beside truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.base.resources import config_path
from ltm_core.base.types import Float32Array, RgbImage, UInt8Array
from ltm_core.fuel.class_map import UNSEEN, read_fuel_map
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pictures import (
    label_colors,
    label_legend,
    panel,
    to_png,
    with_legend,
)
from ltm_core.scoring.fuel import on_grid
from ltm_core.scoring.labels import at_pixels_of
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.pictures.depth_sheet import depth_sheet
from ltm_lab.evaluation.run_score import BagScore
from ltm_lab.evaluation.score_tables import tables
from ltm_ros.demo.outcome import map_picture
from ltm_ros.demo.report import ReportData, Sheet, write_report
from ltm_ros.demo.score import DEPTH_SOURCES
from ltm_ros.recordings.frame_stream import FrameStream, StreamedFrame
from ltm_ros.recordings.recorded_run import Recorded, image_shape, last_fuel_map

HEADING_STEP_DEG = 20.0
"""Views of a camera are drawn if their azimuths differ by at least this angle."""
MOST_VIEWS = 2
"""Views that are drawn of each camera."""
_WIDTH = 860
"""Pixels of one picture of a sheet."""


@dataclass(frozen=True, eq=False)
class ScoredView:
    """One frame with its truth. `depths`: metres at the truth's pixels by source, or at their own without truth."""

    camera_name: str
    camera: Camera
    pose: Pose
    photo: RgbImage
    labels: UInt8Array | None
    truth_depth: Float32Array | None
    truth_labels: UInt8Array | None
    depths: dict[str, Float32Array]

    @property
    def name(self) -> str:
        return f"{self.camera_name}, {self.pose.angles_deg[0]:.0f}°"


def write_eval_report(out: Path, recorded: Recorded, score: BagScore) -> Path:
    """Write `report.html` and its pictures as PNG files into `out`; return the page's path. Raises LtmError."""
    sheets = sheets_of(recorded)
    out.mkdir(parents=True, exist_ok=True)
    for name, sheet in sheets.items():
        (out / f"{name}.png").write_bytes(to_png(sheet.picture))
    return write_report(
        out / "report.html",
        ReportData(
            title=f"Evaluation of {recorded.site.name}",
            summary=f"{score.frames} frames with truth: depth, labels and fuel cells of the run against their truth.",
            conditions=[("bag", str(recorded.bag)), ("network", recorded.site.model)],
            nodes=(),
            sheets=list(sheets.values()),
            labels=score.labels,
            fuel=score.fuel,
            label_set=LabelSet.load(config_path(recorded.site.labels)),
            tables=[table for table in tables(score) if table.title != "confusion"],
            files=[(f"{name}.png", sheet.caption) for name, sheet in sheets.items()],
        ),
    )


def sheets_of(recorded: Recorded) -> dict[str, Sheet]:
    """Draw every sheet that the bag has data for, by file name."""
    labels = LabelSet.load(config_path(recorded.site.labels))
    seen = views(recorded)
    sheets = {}
    if (labelled := label_sheet(seen, labels)) is not None:
        sheets["labels"] = Sheet("Labels", labelled, "Photos with their true classes and the network's labels.")
    for number, view in enumerate(view for view in seen if view.depths):
        picture = depth_sheet(view.name, view.photo, view.depths, view.truth_depth)
        sheets[f"depth_{number + 1}_{view.camera_name}"] = Sheet(
            f"Depth of {view.name}", picture, "True depth, each source of depth, and its error."
        )
    if (maps := fuel_sheet(recorded, seen)) is not None:
        sheets["fuel_maps"] = Sheet("Fuel maps", maps, "Fuel map of all cameras, and the true life forms.")
    return sheets


def views(recorded: Recorded) -> list[ScoredView]:
    """Return the first frames of each camera that differ in azimuth, in the site's order of cameras."""
    found: list[ScoredView] = []
    headings: dict[str, list[float]] = {}
    for frame in FrameStream(recorded.bag, recorded.site).frames(["camera", "pose", "photo"]):
        seen = headings.setdefault(frame.camera_name, [])
        azimuth = frame.take("pose").angles_deg[0]
        apart = [abs((azimuth - a + 180) % 360 - 180) >= HEADING_STEP_DEG for a in seen]
        if len(seen) < MOST_VIEWS and all(apart):
            seen.append(azimuth)
            found.append(_view(frame, recorded))
    order = list(recorded.site.cameras)
    return sorted(found, key=lambda view: order.index(view.camera_name))


def _view(frame: StreamedFrame, recorded: Recorded) -> ScoredView:
    truth, image = frame.take("truth_depth"), image_shape(frame, recorded.site)
    depths = {name: frame.take(name) for name in DEPTH_SOURCES if name in frame}
    return ScoredView(
        frame.camera_name,
        frame.take("camera"),
        frame.take("pose"),
        frame.take("photo"),
        frame.take("labels"),
        truth,
        frame.take("truth_labels"),
        {n: depth if truth is None else at_pixels_of(depth, image, truth.shape) for n, depth in depths.items()},
    )


def label_sheet(seen: Sequence[ScoredView], labels: LabelSet) -> RgbImage | None:
    """Draw photo, true classes and labels of the first view of each camera; None without truth."""
    cells: list[tuple[str, RgbImage]] = []
    shown: set[int] = set()
    for view in {view.camera_name: view for view in reversed(seen)}.values():
        if view.labels is None or view.truth_labels is None:
            continue
        cells.append((view.name, view.photo))
        for name, ids in (("true classes", view.truth_labels), ("labels of the network", view.labels)):
            shown.update(np.unique(ids[ids != UNSEEN]).tolist())
            cells.append((name, label_colors(ids, labels)))
    if not cells:
        return None
    sheet = panel(cells, columns=3, width=_WIDTH)
    return with_legend(sheet, label_legend(sheet.shape[1], labels, shown))


def fuel_sheet(recorded: Recorded, seen: Sequence[ScoredView]) -> RgbImage | None:
    """Draw the last fuel map of the bag beside the true life forms, if known; None without a map."""
    try:
        classes, geometry, labels = last_fuel_map(recorded.bag, recorded.site)
    except LtmError:
        return None
    maps = [("fuel map", classes)]
    if recorded.life_forms is not None:
        maps.append(("truth", on_grid(*read_fuel_map(recorded.life_forms), geometry)))
    dem, palette = recorded.site.open_dem(), life_form_labels(labels)
    cameras = [PosedCamera(view.camera_name, view.camera, view.pose) for view in seen]
    cells = [(name, map_picture(ids, geometry, recorded.site, dem, cameras, palette)) for name, ids in maps]
    return panel(cells, columns=len(cells), width=_WIDTH)
