"""Scores the surface changes that a recorded run found against the true surfaces of the dates."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float32Array, take
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_lab.evaluation.metrics.change import ChangeScore, score_change
from ltm_lab.evaluation.metrics.heights import SurfaceScore, cell_means, score_surface
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.grid import UNKNOWN, msg_to_classes
from ltm_msgs_py.pointcloud import msg_to_columns
from ltm_ros.runtime.topics import TERRAIN_CHANGE, TERRAIN_INFO, TERRAIN_UPDATE, site_topic


@dataclass(frozen=True)
class TerrainScore:
    """`change`: cells that independent views looked at; truly changed where the true surface moved by `threshold`
    metres or more since the earlier date (None: there is none). `updated`, `reference`: heights of the changed cells as
    updated, and as they stood in the reference, against the true surface."""

    cells: int
    threshold: float
    change: ChangeScore | None
    updated: SurfaceScore
    reference: SurfaceScore


def score_terrain(bag: Path, site: Site, surface: Path, earlier: Path | None) -> TerrainScore:
    """`surface`, `earlier`: the true surface at the bag's date and at the one before.

    Raises RecordingError where the bag has no terrain topics, RasterError on truth that cannot be read."""
    reader = BagReader(bag)
    grid = _last(reader, site_topic(site.name, TERRAIN_CHANGE))
    if grid is None:
        raise RecordingError(f"the bag has no {TERRAIN_CHANGE.name}")
    kinds, geometry = msg_to_classes(grid)
    threshold = _threshold(_last(reader, site_topic(site.name, TERRAIN_INFO)))
    heights, shifts = _updates(reader, site_topic(site.name, TERRAIN_UPDATE), geometry)
    truth = _truth(surface, site, geometry)
    observed = (kinds != UNKNOWN) & np.isfinite(truth)
    found = (kinds > 0) & (kinds != UNKNOWN)
    change = None
    if earlier is not None and np.isfinite(threshold):
        moved = truth - _truth(earlier, site, geometry)
        change = score_change(found, np.abs(moved) >= threshold, observed & np.isfinite(moved))
    return TerrainScore(
        int(observed.sum()),
        threshold,
        change,
        score_surface(heights, truth, found),
        score_surface(heights - shifts, truth, found),
    )


def _threshold(info: Any) -> float:
    """Metres from which a shift counts as change; NaN where the bag does not say."""
    try:
        return float(json.loads(info.data)["threshold"])
    except (AttributeError, ValueError, KeyError, TypeError):
        return float("nan")


def _last(reader: BagReader, topic: str) -> Any:
    last = None
    for message in reader.messages([topic]):
        last = message
    return None if last is None else reader.decode(last)


def _updates(reader: BagReader, topic: str, geometry: GridGeometry) -> tuple[Float32Array, Float32Array]:
    """The newest height and shift of each cell of the grid, (H, W); NaN where none was sent."""
    heights, shifts = (np.full(geometry.shape, np.nan, np.float32) for _ in range(2))
    for message in reader.messages([topic]):
        columns = msg_to_columns(reader.decode(message))
        x, y, z, shift = (take(columns, name, np.float32, topic) for name in ("x", "y", "z", "shift"))
        row, col = geometry.cell_of(x, y)
        inside = geometry.contains(row, col)
        heights[row[inside], col[inside]] = z[inside]
        shifts[row[inside], col[inside]] = shift[inside]
    return heights, shifts


def _truth(path: Path, site: Site, geometry: GridGeometry) -> Float32Array:
    dem = Dem.open(path).in_frame(site.frame)
    return cell_means(dem.elevation, dem.geometry, geometry)
