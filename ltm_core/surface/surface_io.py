"""Confirm cells of a surface map on whose change independent views agree, and write its layers."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import Float32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.disk_io import written_whole
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.confirmed_surface import ConfirmedSurface
from ltm_core.surface.surface_map import SurfaceMap


def confirmed_surface(surface: SurfaceMap) -> tuple[ConfirmedSurface, int]:
    """Return the changed cells, and the number of cells that independent views have judged. Where something was
    removed, the visible surface is the nearer of what is left of it and bare earth."""
    geometry = surface.reference.geometry
    found: list[tuple[NDArray[Any], ...]] = []
    seen = 0
    top, left, height, width = surface.seen_window() or (0, 0, 0, 0)
    for row in range(top, top + height, _STRIP):
        layers = surface.layers((row, left, min(_STRIP, top + height - row), width))
        seen += int(layers.judged.sum())
        changed = (layers.change > 0) & np.isfinite(layers.height)
        rows, cols = np.nonzero(changed)
        kind, now, bare = layers.change[changed], layers.height[changed], layers.bare[changed]
        ground = np.where(kind == ChangeKind.LOWERED, now, np.float32(np.nan))
        gone = (kind == ChangeKind.REMOVED) & (now - bare < (layers.reference[changed] - bare) / 2)
        visible = np.where(kind == ChangeKind.LOWERED, now, np.where(gone, bare, np.fmax(now, bare)))
        found.append((rows + row, cols + left, visible, ground))
    if not found:
        nothing = np.empty(0, np.float32)
        return ConfirmedSurface(geometry, np.empty(0, np.int32), np.empty(0, np.int32), nothing, nothing), 0
    rows, cols, visible, ground = (np.concatenate(parts) for parts in zip(*found, strict=True))
    cells = rows.astype(np.int32), cols.astype(np.int32)
    return ConfirmedSurface(geometry, *cells, visible.astype(np.float32), ground.astype(np.float32)), seen


_STRIP = 256
"""Number of rows processed at a time; the layers of a whole site may exceed the memory."""


CHANGE_COLORS = {
    ChangeKind.NONE: (236, 236, 232),
    ChangeKind.REMOVED: (190, 50, 35),
    ChangeKind.GROWN: (120, 205, 120),
    ChangeKind.LOWERED: (90, 50, 160),
}

Exported = Literal["surface", "change"]
BANDS: dict[Exported, dict[str, str]] = {
    "surface": {"height": "m", "sigma": "m"},
    "change": {"shift": "m", "sigma": "m", "kind": "1", "since": "days since 1970-01-01 UTC"},
}
"""Name and unit of the bands of `write_export`."""


def write_export(path: Path | str, surface: SurfaceMap, what: Exported, geometry: GridGeometry) -> None:
    """Write a surface map as one GeoTIFF of float32 bands with NaN as nodata; `geometry`: its grid, in a named CRS.

    `surface`: *height*, the reference moved where change was accepted, known wherever the terrain is; *sigma*, of what
    cameras measured of it, NaN where none has looked. `change`: *shift* in height that independent views agree on, 0
    where they see none and NaN where they have not looked; *sigma*; *kind*, the ChangeKind of the tag kinds; *since*
    when. Tags: as_of (newest frame, ISO 8601), kinds, cameras, heights. The file appears whole or not at all.

    Raises ConfigError where it cannot be written."""
    import rasterio
    from rasterio.windows import Window

    path, bands = Path(path), BANDS[what]
    as_of = datetime.fromtimestamp(surface.newest_ns // 1_000_000_000, UTC)
    height, width = geometry.shape
    profile = {"driver": "GTiff", "width": width, "height": height, "count": len(bands), "dtype": "float32"}
    profile |= {"crs": geometry.crs, "transform": geometry.transform(), "nodata": float("nan"), "bigtiff": "if_safer"}
    profile |= {"tiled": True, "blockxsize": 256, "blockysize": 256, "compress": "deflate", "predictor": 3}
    with written_whole(path) as partial, rasterio.open(partial, "w", **profile) as sink:
        for row in range(0, height, _STRIP):
            rows = min(_STRIP, height - row)
            for number, values in enumerate(_bands(surface, what, (row, 0, rows, width)), start=1):
                sink.write(values, number, window=Window(0, row, width, rows))
        for number, (name, unit) in enumerate(bands.items(), start=1):
            sink.set_band_description(number, name)
            sink.set_band_unit(number, unit)
        sink.update_tags(
            as_of=as_of.isoformat() if surface.newest_ns else "no frame yet",
            kinds=json.dumps({kind.name.lower(): int(kind) for kind in ChangeKind}),
            cameras=json.dumps(surface.cameras),
            heights="metres in the vertical datum of the DEM",
        )


def _bands(surface: SurfaceMap, what: Exported, window: tuple[int, int, int, int]) -> list[Float32Array]:
    layers = surface.layers(window)
    if what == "surface":
        return [layers.height, layers.sigma]
    known, changed, since = layers.judged, layers.change > 0, layers.since / np.float32(86_400)
    pairs = (known, layers.shift), (known, layers.sigma), (known, layers.change), (changed, since)
    return [np.where(where, values, np.float32(np.nan)).astype(np.float32) for where, values in pairs]
