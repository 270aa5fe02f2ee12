"""Compute the layers of a surface map and write them as GeoTIFF."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import BoolArray, Float32Array, UInt8Array, UInt32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.surface.cell_update import Rules
from ltm_core.surface.change import ChangeKind, Window, estimate_variance, mosaic
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.surface.tile_pool import TilePool

_FIELDS = (
    "dz", "looks", "weight", "relative_variance", "pose_variance", "first", "last", "cameras", "frames", "label",
    "base", "kind", "shift", "since", "by",
)  # fmt: skip
_NO_LABEL = 255
_NOT_LOOKED = 255


@dataclass(frozen=True, eq=False)
class SurfaceLayers:
    """Rasters (H, W) of a window of the grid, in the map frame.

    `bare`, `reference`: metres, as they were given. `height`: the updated surface: the reference (with the canopy that
    the first views found, where no surface raster was given), moved where change was accepted. `estimate`: what the
    cameras measured, NaN where independent views have not agreed. `sigma`: of that estimate, NaN where nobody has
    looked. `change`: ChangeKind. `observed`: seen by independent views. `frames`: how many saw the cell. `cameras`:
    how many. `last_seen`: s, 0 never. `since`: s, when an accepted change had been seen, else 0. `by`: the mask of the
    cameras that agreed on it. `label`: class last seen, 255 none.
    """

    geometry: GridGeometry
    bare: Float32Array
    reference: Float32Array
    height: Float32Array
    estimate: Float32Array
    sigma: Float32Array
    change: UInt8Array
    observed: BoolArray
    frames: NDArray[np.uint16]
    cameras: UInt8Array
    last_seen: UInt32Array
    since: UInt32Array
    by: UInt32Array
    label: UInt8Array

    @property
    def told(self) -> UInt8Array:
        """(H, W) ChangeKind as others are told of it: 255 where independent views have not looked."""
        known = self.observed | (self.change > 0)
        return np.where(known, self.change, np.uint8(_NOT_LOOKED)).astype(np.uint8)


def layers_of(pool: TilePool, reference: Reference, window: Window | None, rules: Rules) -> SurfaceLayers:
    """Of a window (row, col, height, width); None: the whole grid."""
    height, width = reference.geometry.shape
    window = window or (0, 0, height, width)
    shape = window[2:]
    parts = mosaic(pool.peek, window, _FIELDS)
    part = slice(window[0], window[0] + shape[0]), slice(window[1], window[1] + shape[1])
    bare, surface = reference.bare[part], reference.surface[part]
    if not parts:
        unknown = np.full(shape, np.nan, np.float32)
        seconds = np.zeros(shape, np.uint32)
        return SurfaceLayers(
            reference.geometry.window(*window), bare, surface, surface.copy(), unknown, unknown.copy(),
            np.zeros(shape, np.uint8), np.zeros(shape, np.bool_), np.zeros(shape, np.uint16), np.zeros(shape, np.uint8),
            seconds, seconds.copy(), seconds.copy(), np.full(shape, _NO_LABEL, np.uint8),
        )  # fmt: skip
    variance, _, sure = estimate_variance(parts, rules)
    base = np.nan_to_num(parts["base"])
    seen = parts["looks"] > 0
    return SurfaceLayers(
        reference.geometry.window(*window),
        bare,
        surface,
        (surface + base + parts["shift"]).astype(np.float32),
        np.where(sure, surface + parts["dz"], np.float32(np.nan)).astype(np.float32),
        np.where(seen, np.sqrt(variance), np.float32(np.nan)).astype(np.float32),
        parts["kind"],
        sure,
        parts["frames"],
        _bit_counts(parts["cameras"]),
        parts["last"],
        parts["since"],
        parts["by"],
        np.where(parts["frames"] > 0, parts["label"], np.uint8(_NO_LABEL)).astype(np.uint8),
    )


def _bit_counts(masks: UInt32Array) -> UInt8Array:
    bits = np.unpackbits(np.ascontiguousarray(masks).view(np.uint8).reshape(*masks.shape, 4), axis=-1)
    return np.asarray(bits.sum(axis=-1), np.uint8)


UNSEEN = 255
"""In the raster of changes: cells that independent views have not seen."""
CHANGE_COLORS = {
    ChangeKind.NONE: (236, 236, 232),
    ChangeKind.REMOVED: (200, 60, 40),
    ChangeKind.GROWN: (40, 140, 70),
    ChangeKind.LOWERED: (120, 70, 170),
}

Exported = Literal["surface", "change"]
BANDS: dict[Exported, dict[str, str]] = {
    "surface": {"height": "m", "sigma": "m"},
    "change": {"shift": "m", "sigma": "m", "kind": "1", "since": "days since 1970-01-01 UTC"},
}
"""Name and unit of the bands of `write_export`."""
_STRIP = 256
"""Rows that are written at a time: the layers of a whole site may be larger than memory."""


def write_export(path: Path | str, surface: SurfaceMap, what: Exported, geometry: GridGeometry) -> None:
    """Write a surface map as one GeoTIFF of float32 bands with NaN as nodata; `geometry`: its grid, in a named CRS.

    `surface`: *height*, the reference moved where change was accepted, known wherever the terrain is; *sigma*, of what
    cameras measured of it, NaN where none has looked. `change`: *shift* in height that independent views agree on, 0
    where they see none and NaN where they have not looked; *sigma*; *kind*, the ChangeKind of the tag kinds; *since*
    when. Tags: as_of (newest frame, ISO 8601), kinds, cameras, heights. The file appears whole or not at all.

    Raises ConfigError where it cannot be written.
    """
    import rasterio
    from rasterio.errors import RasterioIOError
    from rasterio.windows import Window

    path, bands = Path(path), BANDS[what]
    partial = path.with_name(f".{path.name}.partial")
    height, width = geometry.shape
    profile = {"driver": "GTiff", "width": width, "height": height, "count": len(bands), "dtype": "float32"}
    profile |= {"crs": geometry.crs, "transform": geometry.transform(), "nodata": float("nan"), "bigtiff": "if_safer"}
    profile |= {"tiled": True, "blockxsize": 256, "blockysize": 256, "compress": "deflate", "predictor": 3}
    try:
        with rasterio.open(partial, "w", **profile) as sink:
            for row in range(0, height, _STRIP):
                rows = min(_STRIP, height - row)
                for number, values in enumerate(_bands(surface, what, (row, 0, rows, width)), start=1):
                    sink.write(values, number, window=Window(0, row, width, rows))
            for number, (name, unit) in enumerate(bands.items(), start=1):
                sink.set_band_description(number, name)
                sink.set_band_unit(number, unit)
            sink.update_tags(
                as_of=_moment(surface.newest_ns),
                kinds=json.dumps({kind.name.lower(): int(kind) for kind in ChangeKind}),
                cameras=json.dumps(surface.cameras),
                heights="metres in the vertical datum of the DEM",
            )
        partial.replace(path)
    except (OSError, RasterioIOError) as error:
        partial.unlink(missing_ok=True)
        raise ConfigError(f"{path}: cannot be written ({error}); name a place that can") from error


def _bands(surface: SurfaceMap, what: Exported, window: tuple[int, int, int, int]) -> list[Float32Array]:
    layers = surface.layers(window)
    if what == "surface":
        return [layers.height, layers.sigma]
    known, nan = layers.observed | (layers.change > 0), np.float32(np.nan)
    changed = layers.change > 0
    return [
        np.where(known, surface.accepted_shift(window), nan),
        np.where(known, layers.sigma, nan),
        np.where(known, layers.change, nan).astype(np.float32),
        np.where(changed, layers.since / np.float32(86_400), nan).astype(np.float32),
    ]


def _moment(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC).isoformat() if stamp_ns else "no frame yet"


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
