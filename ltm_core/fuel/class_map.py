"""Count the labels of each cell (the paper's majority map), and read and write maps of classes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ConfigError, ImageError, RasterError
from ltm_core.base.types import Float32Array, Int16Array, Int32Array, UInt8Array
from ltm_core.fuel.codes import fuel_models
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import check_size, open_raster, write_geotiff
from ltm_core.vision.labels import LabelSet

Color = tuple[int, int, int]

_LANDFIRE: Final[dict[int, Color]] = {
    91: (104, 104, 104), 93: (255, 237, 237), 98: (0, 14, 214), 99: (77, 110, 112),
    101: (255, 235, 190), 102: (255, 211, 115), 103: (255, 236, 139), 106: (230, 230, 64),
    121: (255, 170, 0), 122: (255, 167, 127), 123: (255, 99, 0),
    141: (215, 194, 158), 142: (215, 176, 158), 143: (205, 137, 102), 144: (137, 90, 68), 146: (237, 112, 68),
    161: (233, 255, 190), 162: (170, 255, 0), 163: (180, 215, 158), 165: (38, 115, 0),
    181: (190, 255, 232), 182: (0, 255, 197), 183: (190, 210, 255), 184: (123, 104, 238), 185: (190, 232, 255),
    186: (0, 197, 255), 188: (0, 92, 230), 189: (77, 110, 145),
    2: (255, 255, 0), 3: (230, 197, 11), 5: (255, 170, 102), 7: (137, 112, 68), 8: (211, 255, 190), 9: (112, 168, 0),
    10: (38, 115, 0),
}  # fmt: skip
"""Colours of the attribute tables of LANDFIRE 2022 (from a tile of Vermont, which has these codes)."""
_OURS: Final[dict[int, Color]] = {
    92: (225, 240, 255), 104: (240, 200, 60), 105: (215, 190, 90), 107: (200, 170, 20), 108: (180, 150, 60),
    109: (150, 125, 20), 124: (200, 60, 20), 145: (176, 74, 40), 147: (150, 40, 40), 148: (110, 60, 40),
    149: (80, 35, 30), 164: (115, 160, 80), 187: (60, 150, 190),
    201: (230, 190, 255), 202: (200, 120, 220), 203: (160, 60, 190), 204: (110, 0, 140),
    1: (255, 255, 190), 4: (168, 56, 0), 6: (255, 127, 80), 11: (230, 190, 255), 12: (180, 90, 210), 13: (110, 0, 140),
}  # fmt: skip
"""Colours of codes that this tile lacks, similar to those of their group."""
_UNKNOWN: Final[Color] = (222, 222, 220)


def code_color(code: int) -> Color:
    """Return the colour of a fuel code of either system; grey where it is none."""
    return _LANDFIRE.get(code) or _OURS.get(code) or _UNKNOWN


def code_colors(codes: Int16Array) -> UInt8Array:
    """Return (..., 3) colours of codes (...)."""
    table = np.array([code_color(code) for code in range(256)], np.uint8)
    return table[np.where((codes >= 0) & (codes < 256), codes, 0)]


def code_names(codes: Int16Array) -> list[tuple[str, Color]]:
    """Return the name and colour of each code that occurs, the commonest first."""
    found, counts = np.unique(codes[codes != NODATA], return_counts=True)
    return [(fuel_models().name(int(code)), code_color(int(code))) for code in found[np.argsort(-counts)]]


UNSEEN = 255
"""Class of a cell without votes."""


class MajorityFuelMap:
    """Sum votes and give each cell the class with most of them.

    Ties go to the class that stands first in the label set, so the map depends on the votes alone and not on their
    order. Cells partition the plane (`GridGeometry.cell_of`): the paper's "centred at" neighbourhoods, read
    literally, would count a pixel on an edge twice.
    """

    def __init__(self, geometry: GridGeometry, classes: int) -> None:
        self.geometry = geometry
        self.totals: NDArray[np.uint64] = np.zeros((*geometry.shape, classes), np.uint64)

    def add(self, votes: CellVotes) -> tuple[int, int, int, int] | None:
        """Count a frame's votes; the changed tile (row, col, height, width), or None where it saw nothing.

        Raises ImageError for votes on another grid or over other classes.
        """
        if votes.geometry != self.geometry:
            raise ImageError(f"votes of {votes.source} are on {votes.geometry}, but this map is on {self.geometry}")
        if votes.counts.shape[1] != self.totals.shape[2]:
            raise ImageError(
                f"votes of {votes.source} count {votes.counts.shape[1]} classes, this map {self.totals.shape[2]}"
            )
        if len(votes.rows) == 0:
            return None
        np.add.at(self.totals, (votes.rows, votes.cols), votes.counts)
        row, col = int(votes.rows.min()), int(votes.cols.min())
        return row, col, int(votes.rows.max()) - row + 1, int(votes.cols.max()) - col + 1

    def classes(self) -> UInt8Array:
        """Return the winning class of every cell, (H, W) uint8; UNSEEN without votes."""
        winner = self.totals.argmax(axis=2).astype(np.uint8)
        return np.where(self.totals.any(axis=2), winner, np.uint8(UNSEEN))

    def share(self) -> Float32Array:
        """Return the winner's share of all votes in its cell, (H, W) in [0, 1]; NaN without votes."""
        total = self.totals.sum(axis=2).astype(np.float64)
        with np.errstate(invalid="ignore"):
            return np.asarray(self.totals.max(axis=2) / total, np.float32)


@dataclass(frozen=True, eq=False)
class Seen:
    """Coverage by one camera, (H, W) each. `frames`: number that saw the cell. `footprint`: smallest extent of a pixel
    on the ground, away from the camera, in metres, NaN if unknown."""

    frames: Int32Array
    footprint: Float32Array


class CoverageMap:
    """Count the votes of frames by camera, on one fuel grid."""

    def __init__(self, geometry: GridGeometry) -> None:
        self.geometry = geometry
        self.cameras: dict[str, Seen] = {}

    def add(self, votes: CellVotes) -> None:
        """Count a frame."""
        shape = self.geometry.shape
        if votes.source not in self.cameras:
            self.cameras[votes.source] = Seen(np.zeros(shape, np.int32), np.full(shape, np.nan, np.float32))
        seen, cells = self.cameras[votes.source], (votes.rows, votes.cols)
        seen.frames[cells] += 1
        if votes.visibility is not None:
            seen.footprint[cells] = np.fmin(seen.footprint[cells], votes.visibility.footprint)

    def count(self) -> Int32Array:
        """Return (H, W): how many cameras saw each cell."""
        seen = [camera.frames > 0 for camera in self.cameras.values()]
        return np.sum(seen, axis=0, dtype=np.int32) if seen else np.zeros(self.geometry.shape, np.int32)


def write_fuel_map(
    path: Path | str,
    classes: UInt8Array,
    geometry: GridGeometry,
    labels: LabelSet,
    tags: Mapping[str, str] | None = None,
) -> Path:
    """Write class indices, (H, W) uint8 with 255 unseen, with the palette and the classes' names.

    The file appears whole or not at all. Raises ConfigError where `path` is empty, its folder is missing or the file
    cannot be written.
    """
    if not str(path):
        raise ConfigError("no file is configured for the fuel map: set the parameter export_path")
    path = Path(path)
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: the folder {path.parent} does not exist; create it first")
    partial = path.with_name(f".{path.name}.partial")
    try:
        write_geotiff(
            partial,
            classes,
            geometry,
            nodata=UNSEEN,
            colormap=dict(enumerate(labels.colors)),
            tags={"classes": json.dumps(labels.names), **(tags or {})},
        )
        partial.replace(path)
    except OSError as error:  # rasterio's own errors of opening a file among them
        partial.unlink(missing_ok=True)
        raise ConfigError(f"{path}: cannot write the fuel map ({error})") from error
    return path


def read_fuel_map(path: Path | str) -> tuple[UInt8Array, GridGeometry]:
    """Return the class indices (255 unseen) and geometry of a fuel map. Raises RasterError on any other raster."""
    with open_raster(path) as source:
        if source.dtypes[0] != "uint8" or source.crs is None:
            raise RasterError(f"{path}: a fuel map is uint8 with a CRS, this is {source.dtypes[0]}, {source.crs}")
        t = source.transform
        if t.b or t.d or t.a <= 0 or t.e != -t.a:
            raise RasterError(f"{path}: a fuel map is north-up with square cells, this has {tuple(t)[:6]}")
        geometry = GridGeometry(t.c, t.f, t.a, source.width, source.height, str(source.crs))
        check_size(source, path, source.height, source.width)
        classes = source.read(1)
        if source.nodata is not None:
            classes = np.where(classes == source.nodata, np.uint8(UNSEEN), classes)
    return classes, geometry


def resampled(
    classes: UInt8Array, geometry: GridGeometry, crs: str, phase: float = 15.0
) -> tuple[UInt8Array, GridGeometry]:
    """Return the map by nearest cell on the grid of the same resolution in another CRS, edges at phase mod resolution.

    EPSG:5070 gives LANDFIRE's grid. Raises ConfigError where `crs` is unknown or not projected in metres.
    """
    from rasterio.warp import Resampling, reproject, transform_bounds

    SiteFrame(crs)  # cells of 30 degrees or feet would be no map
    bounds = transform_bounds(geometry.crs, crs, *geometry.bounds)
    target = GridGeometry.snapped(bounds, geometry.resolution, phase, crs)
    result = np.full(target.shape, UNSEEN, np.uint8)
    reproject(
        classes,
        result,
        src_transform=geometry.transform(),
        src_crs=geometry.crs,
        src_nodata=UNSEEN,
        dst_transform=target.transform(),
        dst_crs=crs,
        dst_nodata=UNSEEN,
        resampling=Resampling.nearest,
    )
    return result, target
