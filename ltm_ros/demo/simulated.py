"""Run `make demo`: replay the recording of two simulated towers live and compare it with its truth."""

import time
from collections.abc import Callable
from pathlib import Path

from ltm_core.base.errors import RecordingError
from ltm_core.base.resources import config_path
from ltm_core.fuel.class_map import CoverageMap, read_fuel_map
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.pictures import to_png
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, open_stored_map
from ltm_core.site.networks import with_live_record
from ltm_core.site.site_io import load_site
from ltm_core.visibility.viewshed import PosedCamera
from ltm_core.vision.labels import LabelSet
from ltm_ros.demo.outcome import camera_pictures, fuel_sheets, headings, map_picture, range_scale, write_pictures
from ltm_ros.demo.report import ReportData, conditions, depth_table, fuel_maps_table, recording_facts, write_report
from ltm_ros.demo.score import RunScore, score_run
from ltm_ros.fuel_map.export import write_landscapes
from ltm_ros.recordings.recorded_run import FUEL_TRUTH, Recorded, recorded_frames, recorded_votes
from ltm_ros.recordings.replay.run import ReplayOptions, run_live
from ltm_ros.runtime.health import NodeRow, node_rows


def run_demo(
    bags: Path, out: Path, domain_id: int | None, progress: Callable[[int, int], None], console: Callable[[str], None]
) -> tuple[list[NodeRow], RunScore]:
    """Replay `bags`/demo (site.yaml, recording/, fuel_truth.tif) live into `out`, which must be empty or new.

    Leaves maps, landscapes, state/, recording/, demo.rrd, report.html and pictures/ there; returns nodes and scores.
    Raises LtmError."""
    demo = bags / "demo"
    site_path = demo / "site.yaml"
    site = load_site(site_path)
    labels = LabelSet.load(config_path(site.labels))
    state = out / "state"
    state.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    options = ReplayOptions(
        export=out / "fuel_map.tif", record=out / "recording", state=state, rrd=out / "demo.rrd", domain_id=domain_id
    )
    summaries = run_live(demo / "recording", site_path, options, progress, console)
    seconds = time.monotonic() - started
    if not (out / "fuel_map.tif").is_file():
        raise RecordingError(f"the fuel_map node wrote no {out / 'fuel_map.tif'}; its messages are above")

    dem = site.open_dem()
    site = with_live_record(site, state)
    evidence = site_evidence_map(site, site.fuel_geometry(dem), labels)
    before = evidence.layers()
    with open_stored_map(state / STORE_FILE, site, evidence):
        write_landscapes(evidence, site, out, state)
    recorded = Recorded(out / "recording", site_path, site, demo, demo / FUEL_TRUTH)
    score = score_run(recorded)
    nodes = node_rows(summaries)
    classes, geometry = read_fuel_map(out / "fuel_map.tif")
    shown = headings(recorded_frames(out / "recording", site))
    after = evidence.layers()
    views = [PosedCamera(frame.camera_name, frame.camera, frame.pose) for frame in shown]
    fuel_map = map_picture(classes, geometry, site, dem, views, life_form_labels(labels), after.changed)
    scale = range_scale(shown)
    outlined = "Fuel map from all cameras. Outlined: changed cells."
    write_pictures(out / "pictures", shown, fuel_map, labels, scale, outlined)
    coverage = CoverageMap(evidence.geometry, recorded_votes(recorded, evidence.geometry, labels))
    sheets = fuel_sheets(site, dem, before, after, coverage, shown, life_form_labels(labels))
    for name, sheet in sheets.items():
        (out / "pictures" / f"{name}.png").write_bytes(to_png(sheet.picture))
    depth = {row.source: row.scores[-1] for row in score.depth if row.against == "visible surface"}
    data = ReportData(
        title="LTM demonstration",
        summary=(
            "Two simulated fire-watch towers, replayed through the live ROS 2 graph. Depth is traced to an "
            "outdated DEM, fused with a network's depth, and compared with the visible surface (including "
            "vegetation). Labels come from the default network. The fuel map combines the evidence of all frames "
            "and cameras."
        ),
        facts=recording_facts(site, recorded),
        conditions=conditions(site, seconds, score.frames),
        nodes=nodes,
        cameras=camera_pictures(shown, labels, scale),
        fuel_map=fuel_map,
        sheets=list(sheets.values()),
        depth=depth.get("fused", depth.get("traced")),
        labels=score.labels,
        fuel=score.fuel,
        label_set=labels,
        scale=scale,
        recording="demo.rrd",
        tables=[table for table in (depth_table(score), fuel_maps_table(score)) if table is not None],
        files=(
            ("fuel_map.tif", "class indices per 30 m cell, 255 not seen"),
            ("recording/", "inputs and results as a rosbag2 bag (MCAP)"),
            ("landscape.lcp, .prj", "the same for FARSITE and FlamMap, with Scott and Burgan fuel models"),
            ("landscape.tif", "the same as a GeoTIFF of eight bands, for FlamMap 6.2 and IFTDSS"),
            ("state/", "the fuel map's store: evidence, counted frames, history"),
            ("demo.rrd", "the run in Rerun"),
            ("pictures/", "the images of this page"),
            ("log/", "each node's output"),
        ),
    )
    write_report(out / "report.html", data)
    return nodes, score
