"""Run `ltm-lab eval photo`: a real photo with surveyed control points through the live graph.

For each control point, it measures the distance between the surveyed point and the point that the graph traced for its
pixel."""

import csv
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.resources import config_path
from ltm_core.fuel.class_map import read_fuel_map
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.tracing import TerrainTracer
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.labels import LabelSet
from ltm_ros.demo.outcome import camera_pictures, map_picture, range_scale, write_pictures
from ltm_ros.demo.report import ReportData, Table, conditions, write_report
from ltm_ros.recordings.importing.build import import_photos
from ltm_ros.recordings.recorded_run import RecordedFrame, recorded_frames
from ltm_ros.recordings.replay.run import ReplayOptions, run_live
from ltm_ros.runtime.health import NodeRow, node_rows

PHOTO = "IMG_8902.jpg"
CONTROL_POINTS = "gcp8902.csv"
OCCLUDED_BEYOND = 5.0
"""Metres by which the terrain on the line of sight may miss a surveyed point before it counts as hidden by the DEM."""


@dataclass(frozen=True)
class ControlPoint:
    """A surveyed point: its pixel (counted from 0), and the metres between survey and traced point; NaN: not traced.
    `hidden`: the DEM has no surface at the point as seen from the camera."""

    name: str
    u: float
    v: float
    surveyed: tuple[float, float, float]
    distance: float
    range: float
    hidden: bool


def run_real_demo(
    site_path: Path,
    poses: Path,
    out: Path,
    domain_id: int | None,
    progress: Callable[[int, int], None],
    console: Callable[[str], None],
) -> tuple[list[ControlPoint], list[NodeRow]]:
    """Import the photo, replay it live into `out` (empty or new), and measure. Raises LtmError, for example if the data
    is absent."""
    site = load_site(site_path)
    folder = site.dem.path.parent
    if not (folder / PHOTO).is_file():
        raise RecordingError(f"{folder / PHOTO}: the real photo is missing; it is not part of the repository")
    labels = LabelSet.load(config_path(site.labels))
    out.mkdir(parents=True, exist_ok=True)
    import_photos([folder / PHOTO], out / "imported", poses, site)
    started = time.monotonic()
    options = ReplayOptions(
        export=out / "fuel_map.tif", record=out / "recording", rrd=out / "demo.rrd", domain_id=domain_id
    )
    summaries = run_live(out / "imported", site_path, options, progress, console)
    seconds = time.monotonic() - started
    frames = list(recorded_frames(out / "recording", site))
    if not frames:
        raise RecordingError(f"the graph published no depth and labels for {PHOTO}; its messages are above")
    dem = site.open_dem()
    points = control_points(folder / CONTROL_POINTS, frames[0], dem, site)
    nodes = node_rows(summaries)

    classes, geometry = read_fuel_map(out / "fuel_map.tif")
    views = [PosedCamera(frame.camera_name, frame.camera, frame.pose) for frame in frames]
    fuel_map = map_picture(classes, geometry, site, dem, views, life_form_labels(labels))
    scale = range_scale(frames)
    write_pictures(out / "pictures", frames, fuel_map, labels, scale)
    write_report(
        out / "report.html",
        ReportData(
            title="LTM on a real photo",
            summary=(
                "A time-lapse photo of the glacier Engabreen through the live graph. The table compares each surveyed "
                "control point with the point that was traced for its pixel."
            ),
            conditions=conditions(site, seconds, len(frames)),
            nodes=nodes,
            cameras=camera_pictures(frames, labels, scale),
            fuel_map=fuel_map,
            label_set=labels,
            scale=scale,
            recording="demo.rrd",
            tables=(_table(points),),
        ),
    )
    return points, nodes


def control_points(path: Path, frame: RecordedFrame, dem: Dem, site: Site) -> list[ControlPoint]:
    """Compare each control point of the file with the point traced for its pixel. The file counts pixels from 1."""
    traced = RangeImage.from_depth(frame.depth, frame.camera, frame.pose, site.bend).points()
    tracer = TerrainTracer(dem, site.curvature, site.refraction, site.possible_ground)
    x0, y0 = site.origin
    found = []
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            u, v = float(row["u"]) - 1, float(row["v"]) - 1
            x, y, z = float(row["x_e"]), float(row["y_n"]), float(row["z"])
            surveyed = np.array([x - x0, y - y0, z])
            sight = surveyed - frame.pose.position
            length = float(np.linalg.norm(sight))
            hit = float(tracer.trace_rays(frame.pose.position, sight[None])[0])
            distance = float(np.linalg.norm(traced[round(v), round(u)] - surveyed))
            hidden = not abs(hit - length) <= OCCLUDED_BEYOND
            found.append(ControlPoint(row["id"], u, v, (x, y, z), distance, length, hidden))
    return found


def medians(points: list[ControlPoint]) -> tuple[float, float]:
    """Return the median distance in metres over all points, and over those that the DEM does not hide."""
    everything = [p.distance for p in points]
    clear = [p.distance for p in points if not p.hidden]
    return float(np.median(everything)), float(np.median(clear)) if clear else float("nan")


def _table(points: list[ControlPoint]) -> Table:
    rows = [
        (p.name, round(p.u, 1), round(p.v, 1), round(p.range), round(p.distance, 2), "yes" if p.hidden else "")
        for p in points
    ]
    over_all, over_clear = medians(points)
    note = (
        f"Median distance {over_all:.2f} m over all {len(points)} points, {over_clear:.2f} m over points that the "
        f"DEM does not hide. Hidden: on the line of sight, the DEM's surface is more than {OCCLUDED_BEYOND:g} m "
        "from the surveyed point."
    )
    return Table("Control points", ("point", "u, px", "v, px", "range, m", "distance, m", "hidden"), rows, note)
