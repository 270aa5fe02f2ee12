"""Make the pictures of a demonstration run."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ltm_core import pictures
from ltm_core.base.number_text import counted
from ltm_core.base.types import BoolArray, RgbImage, UInt8Array
from ltm_core.fuel.class_map import CoverageMap
from ltm_core.fuel.codes import FuelSystem
from ltm_core.fuel.decision import FuelLayers
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.fuel_maps import FuelCanvas, change_sheet, coverage_sheet, fuel_sheet
from ltm_core.pictures.legend import UNLABELLED
from ltm_core.pictures.maps import interesting_bounds
from ltm_core.pictures.trace import map_camera
from ltm_core.pipeline.site_fuel import provenance_of
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.labels import LabelSet
from ltm_ros.demo.report import CameraPictures, Sheet
from ltm_ros.fuel_map.layers import canvas_of, seen_window
from ltm_ros.recordings.recorded_run import RecordedFrame

HEADING_STEP_DEG = 20.0
"""Degrees by which viewing directions must differ for a further frame of a camera to be shown."""


def headings(frames: Iterable[RecordedFrame]) -> list[RecordedFrame]:
    """Return the first frame of each viewing direction of each camera, because a patrol repeats its views."""
    shown: list[RecordedFrame] = []
    for frame in frames:
        others = [other.pose.angles_deg[0] for other in shown if other.camera_name == frame.camera_name]
        apart = [abs((frame.pose.angles_deg[0] - other + 180) % 360 - 180) for other in others]
        if min(apart, default=360.0) >= HEADING_STEP_DEG:
            shown.append(frame)
    return shown


def range_scale(frames: Sequence[RecordedFrame]) -> pictures.RangeScale:
    """Return one colour scale for all frames of a run, fitted to their ranges."""
    return pictures.RangeScale.of(np.concatenate([frame.depth[::8, ::8].ravel() for frame in frames]))


def camera_pictures(
    frames: Sequence[RecordedFrame], labels: LabelSet, scale: pictures.RangeScale
) -> list[CameraPictures]:
    """Return photo, depth and labels of each frame, for the report, which has the legends once."""
    drawn = []
    for frame in frames:
        depth = pictures.overlay_depth(frame.photo, frame.depth, scale)
        labelled = pictures.overlay_labels(frame.photo, frame.labels, labels)
        caption = "azimuth {:.0f}°, pitch {:.1f}°".format(*frame.pose.angles_deg[:2])
        drawn.append(CameraPictures(frame.camera_name, frame.photo, depth, labelled, caption))
    return drawn


def map_picture(
    classes: UInt8Array,
    geometry: GridGeometry,
    site: Site,
    dem: Dem,
    views: Sequence[PosedCamera],
    labels: LabelSet,
    changed: BoolArray | None = None,
) -> RgbImage:
    """Draw the known part of the fuel map over relief, with the cameras' sectors, and changed cells outlined."""
    cameras: list[pictures.MapCamera] = []
    for view in views:
        repeated = any(camera.name == view.name for camera in cameras)
        cameras.append(replace(map_camera(view), name="" if repeated else view.name))
    grid = site.in_map(geometry)
    bounds = interesting_bounds(classes != UNLABELLED, grid, [c.position for c in cameras], dem.geometry)
    ground = Dem(dem.elevation, dem.geometry)
    return FuelCanvas(grid, ground, cameras, bounds, site.origin, 1200, site.crs).classes(classes, labels, changed)


def fuel_sheets(
    site: Site,
    dem: Dem,
    before: FuelLayers,
    after: FuelLayers,
    coverage: CoverageMap,
    frames: Sequence[RecordedFrame],
    palette: LabelSet,
) -> dict[str, Sheet]:
    """Draw images of the fuel map, its confidence, its changes and its coverage, by file name."""
    spots = {
        f.camera_name: pictures.MapCamera(f.camera_name, None, (float(f.pose.position[0]), float(f.pose.position[1])))
        for f in frames
    }
    places, seen = list(spots.values()), coverage.count() > 0
    heading = provenance_of(site, after, FuelSystem.FBFM40).heading(site.crs)
    whole = canvas_of(site, dem, coverage.geometry, places)
    part = canvas_of(site, dem, coverage.geometry, places, seen_window(coverage.geometry, seen, places))
    changed = int((before.code != after.code).sum())
    return {
        "fuel_layers": Sheet(
            "Confidence of the map",
            fuel_sheet(whole, after, palette, heading),
            "Life forms and fuel models of all cells, remaining uncertainty, and number of cameras that see each cell.",
        ),
        "fuel_change": Sheet(
            "Before and after",
            change_sheet(part, before, after, palette, ("prior map", "with evidence from cameras"), heading),
            f"Fuel map at the start and at the end of the run: {counted(changed, 'changed cell')}.",
        ),
        "fuel_coverage": Sheet(
            "Coverage",
            coverage_sheet(part, coverage, heading),
            "Number of frames in which each camera saw a cell, and the smallest ground footprint of one pixel.",
        ),
    }


def write_pictures(
    folder: Path,
    frames: Sequence[RecordedFrame],
    fuel_map: RgbImage,
    labels: LabelSet,
    scale: pictures.RangeScale,
    title: str = "fuel map from all cameras",
) -> None:
    """Write PNG files: an overview of the frame with the largest span of depths, the map, and each frame's images."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "fuel_map.png").write_bytes(pictures.to_png(fuel_map))
    deepest = max(frames, key=_depth_span)
    for frame in frames:
        sheet = [("Photo", frame.photo)]
        for name, metres in (("Depth traced to the terrain", frame.depth), ("Fused depth", frame.fused)):
            if metres is not None:
                depth = pictures.overlay_depth(frame.photo, metres, scale)
                sheet.append((name, _over(depth, pictures.range_legend(800, scale, sky=False))))
        named = pictures.label_legend(800, labels, np.unique(frame.labels).tolist())
        sheet.append(("Labels", _over(pictures.overlay_labels(frame.photo, frame.labels, labels), named)))
        drawn = pictures.panel(sheet, columns=2 if len(sheet) == 4 else 3, width=800)
        (folder / f"{frame.camera_name}_{frame.pose.angles_deg[0]:03.0f}.png").write_bytes(pictures.to_png(drawn))
        if frame is deepest:
            (folder / "overview.png").write_bytes(pictures.to_png(_overview(sheet, fuel_map, title)))


def _over(picture: RgbImage, legend: RgbImage) -> RgbImage:
    return pictures.with_legend(pictures.fit(picture, legend.shape[1]), legend)


def _depth_span(frame: RecordedFrame) -> float:
    """Return how many octaves the middle 90 % of the depths span."""
    known = frame.depth[np.isfinite(frame.depth)]
    low, high = np.percentile(known, (5, 95)) if known.size else (1.0, 1.0)
    return float(np.log2(high / low))


def _overview(sheet: Sequence[tuple[str, RgbImage]], fuel_map: RgbImage, title: str) -> RgbImage:
    """Return the images of a frame in a column, beside the map at the same height."""
    width = 640
    left = pictures.panel(sheet, columns=1, width=width)
    titled = pictures.panel([(title, fuel_map)], columns=1, width=width)
    margin = titled.shape[0] - round(fuel_map.shape[0] * width / fuel_map.shape[1])
    fitting = round((left.shape[0] - margin) * fuel_map.shape[1] / fuel_map.shape[0])
    right = pictures.panel([(title, fuel_map)], columns=1, width=fitting)
    height = max(left.shape[0], right.shape[0])
    sides = [np.pad(side, ((0, height - side.shape[0]), (0, 0), (0, 0)), mode="edge") for side in (left, right)]
    return np.hstack(sides)
