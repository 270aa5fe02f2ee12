"""`make demo`: the recording of two simulated towers through the live graph, scored against its truth."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ltm_core.errors import RecordingError
from ltm_core.fuel.fuel_map_io import read_fuel_map
from ltm_core.metrics.fuel import FuelScore, score_fuel
from ltm_core.resources import config_path
from ltm_core.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_ros.cli.summary import node_rows
from ltm_ros.demo.outcome import camera_pictures, conditions, headings, map_picture, range_scale, write_pictures
from ltm_ros.replay.run import ReplayOptions, run_live
from ltm_ros.report import NodeRow, ReportData, write_report
from ltm_ros.run_score import RunScore, recorded_frames, score_run


@dataclass(frozen=True, eq=False)
class DemoResult:
    """`frames`: of the recording."""

    frames: int
    nodes: list[NodeRow]
    score: RunScore
    fuel: FuelScore
    seconds: float


def run_demo(
    demo: Path,
    out: Path,
    domain_id: int | None,
    progress: Callable[[int, int], None],
    console: Callable[[str], None],
) -> DemoResult:
    """Replay the demo folder (site.yaml, recording/, fuel_truth.tif) live into `out`, which must be empty or new.

    Leaves fuel_map.tif, recording/, demo.rrd, report.html and pictures/ there. Raises LtmError.
    """
    site_path = demo / "site.yaml"
    site = load_site(site_path)
    labels = LabelSet.load(config_path(site.labels))
    out.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    options = ReplayOptions(
        export=out / "fuel_map.tif", record=out / "recording", rrd=out / "demo.rrd", domain_id=domain_id
    )
    summaries = run_live(demo / "recording", site_path, options, progress, console, out / "log")
    seconds = time.monotonic() - started
    if not (out / "fuel_map.tif").is_file():
        raise RecordingError(f"the fuel_map node wrote no {out / 'fuel_map.tif'}; see {out / 'log'}")

    score = score_run(out / "recording", site, len(labels))
    classes, geometry = read_fuel_map(out / "fuel_map.tif")
    truth, truth_geometry = read_fuel_map(demo / "fuel_truth.tif")
    fuel = score_fuel(classes, geometry, truth, truth_geometry, len(labels))
    nodes = node_rows(summaries)

    shown = headings(recorded_frames(out / "recording", site))
    dem = site.open_dem()
    fuel_map = map_picture(classes, geometry, site, dem, shown, labels)
    scale = range_scale(shown)
    write_pictures(out / "pictures", shown, fuel_map, labels, scale)
    data = ReportData(
        title="LTM demonstration",
        summary=(
            "Two simulated fire-watch towers, replayed through the live ROS 2 graph. Depth is traced to an outdated "
            "DEM and scored against the visible surface, vegetation included; labels come from the default network; "
            "the fuel map is the majority vote of all frames and cameras."
        ),
        conditions=conditions(site, seconds, score.frames),
        nodes=nodes,
        cameras=camera_pictures(shown, labels, scale),
        fuel_map=fuel_map,
        depth=score.surface,
        labels=score.labels,
        fuel=fuel,
        label_set=labels,
        scale=scale,
        recording="demo.rrd",
        files=(
            ("fuel_map.tif", "class indices per 30 m cell, 255 unseen"),
            ("recording/", "inputs and results as a rosbag2 bag (MCAP)"),
            ("demo.rrd", "the run in Rerun"),
            ("pictures/", "the pictures of this page"),
            ("log/", "each node's output"),
        ),
    )
    write_report(out / "report.html", data)
    return DemoResult(score.frames, nodes, score, fuel, seconds)
