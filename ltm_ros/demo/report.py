"""Write the report of the demo: images, tables of errors against truth, and conditions."""

import math
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.number_text import counted, moment_of_stamp, percent
from ltm_core.base.types import Int64Array, RgbImage
from ltm_core.pictures import RangeScale, fit, range_legend, to_jpeg
from ltm_core.pictures.legend import ClassPalette
from ltm_core.scoring.fuel import FuelScore
from ltm_core.scoring.labels import DepthScore, SegmentationScore
from ltm_core.site.site import Site
from ltm_msgs_py.pose import msg_to_pose
from ltm_ros.demo.score import SHARED, RunScore
from ltm_ros.pages import inlined, render_page, shown
from ltm_ros.recordings.frame_stream import FrameStream
from ltm_ros.recordings.recorded_run import Recorded
from ltm_ros.runtime.health import NodeRow
from ltm_ros.runtime.topics import POSE

MAX_WIDTH = 1700
"""Maximum width of embedded images in pixels."""


@dataclass(frozen=True, eq=False)
class CameraPictures:
    """One frame of one camera, drawn: photo, depth, labels, (H, W, 3) each."""

    camera: str
    photo: RgbImage
    depth: RgbImage
    labels: RgbImage
    caption: str = ""


@dataclass(frozen=True)
class Table:
    """A table in a section of its own, such as control points; numbers are aligned to the right."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    note: str = ""


@dataclass(frozen=True, eq=False)
class Sheet:
    """An image under a heading of its own."""

    title: str
    picture: RgbImage
    caption: str


@dataclass(frozen=True, eq=False)
class ReportData:
    """Contents of the report; sections without data are omitted.

    `conditions`: of the run, as (name, value). `facts`: place and time of the recording. `label_set`, `scale`: for
    legends. `recording`: the .rrd file's name. `files`: (name, description)."""

    title: str
    summary: str
    conditions: Sequence[tuple[str, str]]
    nodes: Sequence[NodeRow]
    cameras: Sequence[CameraPictures] = ()
    fuel_map: RgbImage | None = None
    sheets: Sequence[Sheet] = ()
    depth: DepthScore | None = None
    labels: SegmentationScore | None = None
    fuel: FuelScore | None = None
    label_set: ClassPalette | None = None
    scale: RangeScale | None = None
    tables: Sequence[Table] = ()
    recording: str | None = None
    files: Sequence[tuple[str, str]] = field(default_factory=tuple)
    facts: str = ""


def write_report(path: Path, data: ReportData) -> Path:
    """Write the report as one HTML file, its folder too if need be, and return its path."""
    classes = [] if data.label_set is None else list(zip(data.label_set.names, data.label_set.colors, strict=True))
    names = [str(name) for name, _ in classes]
    page = render_page(
        "run_report.html",
        {"picture": _picture},
        data=data,
        classes=[(str(name), tuple(map(int, color))) for name, color in classes],
        range_legend=range_legend(900, data.scale),
        tiles=_tiles(data),
        fuel=_confusion(data.fuel.confusion, names) if data.fuel is not None else None,
        labels=_confusion(data.labels.confusion, names) if data.labels is not None else None,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8")
    return path


def _tiles(data: ReportData) -> list[tuple[str, str, str]]:
    """Return the main figures: (name, value, remark)."""
    dropped = sum(node.dropped for node in data.nodes)
    lost = "nothing lost" if dropped == 0 else "see the table"
    tiles = [("Messages dropped", shown(dropped), lost)] if data.nodes else []
    latencies = [node for node in data.nodes if math.isfinite(node.latency_p95_ms)]
    if latencies:
        slowest = max(latencies, key=lambda node: node.latency_p95_ms)
        remark = f"slowest node: {'/'.join(slowest.node.split('/')[-2:])}; without its first frames"
        tiles.append(("Latency of 95 % of frames", f"{shown(slowest.latency_p95_ms / 1000, 1)} s", remark))
    if data.depth is not None and data.depth.pixels:
        tiles.append(("Depth error", f"{shown(data.depth.median)} m", f"median of {shown(data.depth.pixels)} pixels"))
    if data.labels is not None and data.labels.pixels:
        tiles.append(("Correct labels", percent(data.labels.accuracy), f"mean IoU {percent(data.labels.mean_iou)}"))
    if (fuel := data.fuel) is not None:
        share = fuel.right / fuel.seen if fuel.seen else math.nan
        tiles.append(("Correct fuel cells", percent(share), f"{shown(fuel.right)} of {shown(fuel.seen)} seen"))
    return tiles


def _confusion(counts: Int64Array, names: Sequence[str]) -> dict[str, Any]:
    """Return the confusion of the occurring classes, as rows of (count, share of its row, is correct)."""
    classes, predicted = counts.shape
    heads = [*names, *map(str, range(len(names), classes))][:classes] + ["unlabelled"] * (predicted - classes)
    true = [i for i in range(classes) if counts[i].sum() or counts[:, i].sum()]
    columns = [*true, *[i for i in range(classes, predicted) if counts[:, i].sum()]]
    rows = []
    for i in true:
        shares = counts[i] / max(int(counts[i].sum()), 1)
        cells = [(int(counts[i, j]), shares[j], i == j) for j in columns]
        rows.append((heads[i], cells, shares[i] if counts[i].any() else math.nan))
    return {"heads": [heads[i] for i in columns], "rows": rows}


def _picture(picture: RgbImage) -> str:
    fitted = fit(picture, MAX_WIDTH) if picture.shape[1] > MAX_WIDTH else picture
    return inlined(to_jpeg(fitted, 88), "jpeg")


_AGAINST = {"visible surface": "surface", "bare ground": "ground", SHARED: "shared"}


def bin_name(score: DepthScore) -> str:
    """Return the range of a depth score: `100-300 m`."""
    if score.near == 0 and math.isinf(score.far):
        return "all"
    return f"> {score.near:,.0f} m" if math.isinf(score.far) else f"{score.near:,.0f}-{score.far:,.0f} m"


def score_rows(scored: RunScore) -> list[tuple[str, str]]:
    """Return the main scores in words: (name, value)."""
    rows = [
        (f"{row.source} depth, {bin_name(score)}, median error", f"{score.median:.2f} m")
        for row in scored.depth
        for score in row.scores
        if row.against == "visible surface" and score.pixels
    ]
    if scored.labels is not None:
        rows.append(("correct labels", f"{100 * scored.labels.accuracy:.1f} %"))
    if (fuel := scored.fuel) is not None:
        rows.append(("fuel cells seen", f"{fuel.seen} of {fuel.cells}"))
        for name, one in (("", fuel), (", majority vote", scored.fuel_vote), (", prior alone", scored.fuel_prior)):
            if one is not None:
                share = 100 * one.right / max(1, one.seen)
                rows.append((f"correct fuel cells{name}", f"{one.right} ({share:.1f} %)"))
    if (changes := scored.fuel_changes) is not None:
        parts = {"changed, detected": changes.found, "unchanged, changed by the map": changes.false_flips}
        for name, part in parts.items():
            rows.append((f"fuel cells {name}", f"{part.count} of {part.of} ({100 * part.value:.1f} %)"))
    return rows


def depth_table(score: RunScore) -> Table | None:
    """Return errors by source and range; None without depth."""
    rows = [
        (
            f"{row.source}, {_AGAINST[row.against]}" if one is row.scores[0] else "",
            *(bin_name(one), one.pixels, one.rmse, one.mae, one.median, one.bias),
        )
        for row in score.depth
        for one in row.scores
    ]
    if not rows:
        return None
    covered = ", ".join(
        f"{row.source} {percent(row.coverage)}" for row in score.depth if row.against == "visible surface"
    )
    note = (
        "Metres along the optical axis, by true depth, against the visible surface (vegetation included) and bare "
        f"ground. Truth pixels of finite depth that got a depth: {covered}."
    )
    if any(row.against == SHARED for row in score.depth):
        note += " Shared: against the surface, on pixels where every source has a depth, to compare the sources."
    if any(row.source == "network" for row in score.depth):
        note += " Network: its own depth, scaled by the terrain; published where the fit was sound."
    columns = ("source, against", "true depth", "pixels", "RMSE, m", "mean, m", "median, m", "bias, m")
    return Table("Depth errors by source", columns, rows, note)


def fuel_maps_table(score: RunScore) -> Table | None:
    """Return the map beside the prior and the majority vote, on the same cells; None with one map."""
    maps = (("evidence over the prior", score.fuel), ("majority vote", score.fuel_vote), ("prior", score.fuel_prior))
    rows = [(name, one.seen, one.right, percent(one.right / max(1, one.seen))) for name, one in maps if one is not None]
    if len(rows) < 2:
        return None
    note = "Cells with votes from recorded frames; estimated life form against the true one."
    if (changes := score.fuel_changes) is not None:
        found, false = changes.found, changes.false_flips
        note += (
            f" Of {found.of:,} cells whose true life form is not the prior's, the map detected {found.count:,}; of "
            f"{false.of:,} others it changed {false.count:,}."
        )
    return Table("Fuel maps", ("map", "cells seen", "right", "share"), rows, note)


def recording_facts(site: Site, recorded: Recorded) -> str:
    """Return the place of a site and the time of its recorded frames in words."""
    stream = FrameStream(recorded.bag, site, {"pose": ((POSE, lambda message: msg_to_pose(message, "map")),)})
    stamps, poses = zip(*((frame.stamp_ns, frame.take("pose")) for frame in stream.frames()), strict=True)
    x, y = np.mean([pose.position[:2] for pose in poses], axis=0)
    lon, lat = (float(value) for value in site.frame.to_lonlat(x, y))
    first, last = (f"{moment_of_stamp(edge(stamps)):%Y-%m-%d %H:%M:%S}" for edge in (min, max))
    place = f"Site {site.name} in {site.crs}, near {lon:.3f}, {lat:.3f} (longitude, latitude)"
    return f"{place}. Frames of {first} to {last} UTC."


LAYOUTS = {"node": "one process per node", "site": "one process for the nodes of all cameras"}


def conditions(site: Site, seconds: float, frames: int) -> list[tuple[str, str]]:
    """Return the conditions of the run, for the report."""
    return [
        ("site", f"{site.name}: {counted(len(site.cameras), 'camera')}, {site.crs}"),
        ("frames", str(frames)),
        ("network", site.model),
        ("graph", f"{LAYOUTS[site.processes]}, Fast DDS over shared memory"),
        ("wall time", f"{seconds:.0f} s, including the start of the graph"),
        ("machine", f"{len(os.sched_getaffinity(0))} cores, {platform.machine()}, Python {platform.python_version()}"),
    ]
