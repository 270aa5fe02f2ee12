"""Count the labels of each cell (the paper's majority map), and read and write maps of classes."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ConfigError, ImageError, RasterError
from ltm_core.base.types import Float32Array, Int32Array, UInt8Array
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.geodesy import MOST_EXPORTED, SiteFrame, scale_problem
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import check_size, open_raster, write_geotiff
from ltm_core.storage.disk_io import written_whole
from ltm_core.vision.labels import LabelSet

UNSEEN = 255
"""Class of a cell without votes."""
_CLASSES = 8
"""Number of classes of a map that does not name its own: sky and the life forms."""


class MajorityFuelMap:
    """Sum votes and give each cell the class with most of them. Ties go to the class that stands first in the label
    set, so the map depends on the votes alone and not on their order. Cells partition the plane
    (`GridGeometry.cell_of`): the paper's "centred at" neighbourhoods, read literally, would count a pixel on an edge
    twice."""

    def __init__(self, geometry: GridGeometry, classes: int) -> None:
        self.geometry = geometry
        self.totals: NDArray[np.uint64] = np.zeros((*geometry.shape, classes), np.uint64)

    def add(self, votes: CellVotes) -> None:
        """Count a frame's votes. Raises ImageError for votes on another grid or over other classes."""
        own, given = (self.geometry, self.totals.shape[2]), (votes.geometry, votes.counts.shape[1])
        if given != own:
            raise ImageError(f"votes of {votes.source} have grid and classes {given}, but this map {own}")
        np.add.at(self.totals, (votes.rows, votes.cols), votes.counts)

    def classes(self) -> UInt8Array:
        """Return the winning class of every cell, (H, W) uint8; UNSEEN without votes."""
        winner = self.totals.argmax(axis=2).astype(np.uint8)
        return np.where(self.totals.any(axis=2), winner, np.uint8(UNSEEN))


@dataclass(frozen=True, eq=False)
class Seen:
    """Coverage by one camera, (H, W) each. `frames`: number that saw the cell. `footprint`: smallest extent of a pixel
    on the ground, away from the camera, in metres, NaN if unknown."""

    frames: Int32Array
    footprint: Float32Array


class CoverageMap:
    """Count the votes of frames by camera, on one fuel grid in the map frame."""

    def __init__(self, geometry: GridGeometry, frames: Iterable[CellVotes] = ()) -> None:
        self.geometry = geometry
        self.cameras: dict[str, Seen] = {}
        for votes in frames:
            self.add(votes)

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
    """Write class indices, (H, W) uint8 with 255 unseen, with the palette and the classes' names. The file appears
    whole or not at all. Raises ConfigError where `path` is empty, its folder is missing or the file cannot be
    written."""
    if not str(path):
        raise ConfigError("no file is configured for the fuel map: set the parameter export_path")
    path = Path(path)
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: the folder {path.parent} does not exist; create it first")
    with written_whole(path) as partial:
        tags = {"classes": json.dumps(labels.names), **(tags or {})}
        write_geotiff(partial, classes, geometry, UNSEEN, dict(enumerate(labels.colors)), tags)
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
        most = int(classes[classes != UNSEEN].max(initial=0))
        if source.count > 1 or (most >= _CLASSES and "classes" not in source.tags()):
            raise RasterError(
                f"{path}: has {source.count} bands with values up to {most}; a fuel map has one of classes below "
                f"{_CLASSES}: give a map of `ltm export`"
            )
    return classes, geometry


def snapped_grid(geometry: GridGeometry, crs: str, phase: float = 15.0) -> GridGeometry:
    """Return the grid of the same resolution over `geometry` in another CRS, edges at phase mod resolution, as
    LANDFIRE's in EPSG:5070. Raises ConfigError for a CRS that is unknown, no map's, or distorts areas and slopes."""
    from rasterio.warp import transform_bounds

    SiteFrame(crs)
    if geometry.crs is None:
        raise ConfigError("a fuel grid without a CRS cannot be reprojected")
    bounds = transform_bounds(geometry.crs, crs, *geometry.bounds)
    snapped = GridGeometry.snapped(bounds, geometry.resolution, phase, crs)
    if (problem := scale_problem(crs, snapped, MOST_EXPORTED)) is not None:
        raise ConfigError(f"--crs {crs}: areas and slopes would be wrong: {problem}")
    return snapped
