"""Writes a surface map as GeoTIFF files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ltm_core.errors import ConfigError
from ltm_core.grid import GridGeometry
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.terrain.change import ChangeKind
from ltm_core.terrain.layers import SurfaceLayers

UNSEEN = 255
"""In the raster of changes: cells that independent views have not seen."""
CHANGE_COLORS = {
    ChangeKind.NONE: (236, 236, 232),
    ChangeKind.REMOVED: (200, 60, 40),
    ChangeKind.GROWN: (40, 140, 70),
    ChangeKind.LOWERED: (120, 70, 170),
}


def write_surface(
    folder: Path | str, layers: SurfaceLayers, geometry: GridGeometry, newest_ns: int, cameras: Sequence[str]
) -> list[Path]:
    """Write `terrain_height.tif`, `_sigma`, `_change`, `_age` (hours from the last look to `newest_ns`) and `_since`
    (s, with a second band: the mask of the cameras that agreed, bit i for the i-th of the tag `cameras`).

    `geometry`: of the layers, in a named CRS. Each file appears whole or not at all. Raises ConfigError where the
    folder is missing or cannot be written.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ConfigError(f"{folder}: the folder does not exist; make it first")
    seen = layers.last_seen > 0
    age = np.where(seen, (newest_ns // 1_000_000_000 - layers.last_seen.astype(np.int64)) / 3600, np.nan)
    change = np.where(layers.observed | (layers.change > 0), layers.change, np.uint8(UNSEEN)).astype(np.uint8)
    kinds = json.dumps({kind.name.lower(): int(kind) for kind in ChangeKind})
    named = {"cameras": json.dumps(list(cameras))}
    files = []
    for name, array, nodata, tags in (
        ("height", layers.height, float("nan"), None),
        ("sigma", layers.sigma, float("nan"), None),
        ("change", change, UNSEEN, {"kinds": kinds}),
        ("age", age.astype(np.float32), float("nan"), None),
        ("since", np.stack([layers.since, layers.by]), 0, named),
    ):
        path = folder / f"terrain_{name}.tif"
        partial = path.with_name(f".{path.name}.partial")
        colors = {int(k): v for k, v in CHANGE_COLORS.items()} if name == "change" else None
        try:
            write_geotiff(partial, array, geometry, nodata=nodata, colormap=colors, tags=tags)
            partial.replace(path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise ConfigError(f"{path}: cannot be written ({error})") from error
        files.append(path)
    return files
