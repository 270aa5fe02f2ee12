"""A small site for the Rerun view, and a reader of what a recording holds."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.vision.labels import LabelSet

LABELS = LabelSet.load()
STAMP = 1_700_000_000_123_456_789


def hills(rows: int = 70, cols: int = 110, resolution: float = 30.0) -> Dem:
    geometry = GridGeometry(-1500.0, 1200.0, resolution, cols, rows)
    x, y = geometry.to_map(*np.mgrid[:rows, :cols])
    return Dem((400 + 90 * np.sin(x / 310) + 70 * np.cos(y / 230) + 0.05 * x).astype(np.float32), geometry)


def site(**cameras: dict[str, Any]) -> Site:
    return Site(
        name="ridge", crs="EPSG:32611", origin=(386_000.0, 3_796_000.0), dem={"path": "dem.tif"}, cameras=cameras
    )


def chunks(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Rows of every entity of a recording: component -> value."""
    from rerun.chunk import RrdReader

    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        columns = [
            column.cast("int64") if str(column.type).startswith("timestamp") else column for column in batch.columns
        ]
        for values in zip(*(column.to_pylist() for column in columns), strict=True):
            rows[str(chunk.entity_path)].append(dict(zip(batch.schema.names, values, strict=True)))
    return rows
