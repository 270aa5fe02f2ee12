"""Hold the cells whose height independent views have confirmed, and the list of their versions.

All other cells of a terrain stay as they were given, to the bit."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field, model_validator

from ltm_core.base.errors import RasterError, StoreError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int32Array, Int64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import BAND, DemStack
from ltm_core.raster.prepared_heights_io import own_copy


@dataclass(frozen=True, eq=False)
class ConfirmedSurface:
    """Changed cells of the grid `geometry`, (N,) each, in row-major order.

    `surface`: what cameras see there now, metres. `ground`: bare earth where that has changed, NaN where it is as it
    was given. Raises RasterError where the cells are none of the grid, out of order or without a height."""

    geometry: GridGeometry
    rows: Int32Array
    cols: Int32Array
    surface: Float32Array
    ground: Float32Array

    def __post_init__(self) -> None:
        arrays = (self.rows, self.cols, self.surface, self.ground)
        if any(a.shape != self.rows.shape or a.ndim != 1 for a in arrays):
            raise RasterError(f"confirmed cells have one value each, got arrays of {[a.shape for a in arrays]}")
        if not bool(self.geometry.contains(self.rows, self.cols).all()) or (np.diff(self._places()) <= 0).any():
            raise RasterError(f"confirmed cells outside their grid of {self.geometry.shape}, or not in row-major order")
        if not np.isfinite(self.surface).all() or np.isinf(self.ground).any():
            raise RasterError("confirmed cells without a finite height")

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def lowered(self) -> int:
        """Return the cells whose bare earth has changed."""
        return int(np.isfinite(self.ground).sum())

    def differs_from(self, other: "ConfirmedSurface", least: float) -> bool:
        """Return whether other cells have changed, or one has moved by more than `least` metres."""
        if len(self) != len(other) or not np.array_equal(self._places(), other._places()):
            return True
        moved = np.abs(self.surface - other.surface) > least
        sunk = np.abs(self.ground - other.ground) > least
        return bool((moved | sunk | (np.isnan(self.ground) != np.isnan(other.ground))).any())

    def ground_over(self, given: Dem) -> Dem:
        """Return `given`, bare earth, with changed ground cells replaced in all levels except near their seams; `given`
        itself if there are none."""
        return self._over(given, self.ground)

    def surface_over(self, given: Dem) -> Dem:
        """Return `given`, the visible surface, with changed cells replaced; otherwise as `ground_over`."""
        return self._over(given, self.surface)

    def _over(self, given: Dem, heights: Float32Array) -> Dem:
        x, y = self.geometry.to_map(self.rows, self.cols)
        used = np.isfinite(heights) & _clear_of_seams(given, x, y)
        if not used.any():
            return given
        places, heights = self._places()[used], heights[used]
        levels = [self._level(level, places, heights) for level in given.levels]
        return DemStack(levels, fitted=True) if len(levels) > 1 else levels[0]

    def _level(self, level: Dem, places: Int64Array, heights: Float32Array) -> Dem:
        """Return one raster, each node of which takes the height of the changed cell in which it lies."""
        grid, cells = level.geometry, self.geometry
        rows, cols = np.divmod(places, cells.width)
        west, north = cells.to_map(rows.min() - 0.5, cols.min() - 0.5)
        east, south = cells.to_map(rows.max() + 0.5, cols.max() + 0.5)
        first, last = grid.to_grid(west, north), grid.to_grid(east, south)
        top, left = (max(0, int(np.ceil(v))) for v in first)
        bottom, right = (min(n - 1, int(np.floor(v))) for v, n in zip(last, grid.shape, strict=True))
        elevation = own_copy(level.elevation)
        x, y = grid.to_map(np.arange(top, bottom + 1), np.arange(left, right + 1))
        in_row, in_col = cells.cell_of(x, y)
        inside = (in_col >= 0) & (in_col < cells.width)
        for row, of_cells in enumerate(in_row, start=top):
            place = np.where(inside, of_cells * cells.width + in_col, -1)
            at = np.minimum(np.searchsorted(places, place), len(places) - 1)
            part = elevation[row, left : right + 1]
            hit = (places[at] == place) & np.isfinite(part)
            part[hit] = heights[at[hit]]
        return Dem(elevation, grid)

    def _places(self) -> Int64Array:
        return self.rows.astype(np.int64) * self.geometry.width + self.cols


def _clear_of_seams(dem: Dem, x: Float64Array, y: Float64Array) -> BoolArray:
    """Return (N,): points that no seam of a stack is near. There the finer raster gives way to the coarser one."""
    clear = np.ones(x.shape, np.bool_)
    for fine, coarse in zip(dem.levels[:-1], dem.levels[1:], strict=True):
        g = fine.geometry
        near = (BAND + 1) * coarse.geometry.resolution
        inner = np.minimum(np.minimum(x - g.x_min, g.x_max - x), np.minimum(y - g.y_min, g.y_max - y))
        outer = np.maximum(np.maximum(g.x_min - x, x - g.x_max), np.maximum(g.y_min - y, y - g.y_max))
        clear &= (inner > near) | (outer > near)
    return clear


AS_GIVEN = ""
"""Version of a terrain without confirmed changes, as given by its rasters."""
VERSION = r"[0-9a-f]{16}"
KEPT = 100
"""Number of versions whose files are kept; frames of months refer to the surface to which they were traced."""


class SurfaceVersion(StrictModel):
    """Version of the confirmed surface. `version`: the first 16 digits of `digest`, the SHA-256 of its file. `parent`:
    the previous version when it came last. `as_of_ns`: stamp of the newest contributing frame. `seen`: cells judged by
    independent views, of the `cells` of the grid; `changed` of them are confirmed as changed, `lowered` with their bare
    earth."""

    version: str = Field(pattern=f"^{VERSION}$")
    digest: str = Field(pattern="^[0-9a-f]{64}$")
    parent: str = Field(pattern=f"^({VERSION})?$")
    as_of_ns: int = Field(ge=0)
    cells: int = Field(ge=1)
    seen: int = Field(ge=0)
    changed: int = Field(ge=0)
    lowered: int = Field(ge=0)

    @model_validator(mode="after")
    def _named_by_content(self) -> "SurfaceVersion":
        if not self.digest.startswith(self.version):
            raise ValueError(f"version {self.version} is not the start of its digest {self.digest}")
        return self

    @property
    def changed_share(self) -> float:
        """Return the changed share of the cells that independent views have seen."""
        return self.changed / max(1, self.seen)


class SurfaceManifest(StrictModel):
    """List of `versions` in the order in which they came into use; one that returns is listed
    again. `forgotten`: earlier ones were dropped."""

    site: str
    versions: tuple[SurfaceVersion, ...] = ()
    forgotten: bool = False

    @property
    def current(self) -> str:
        """Return the version in use; AS_GIVEN if there is none."""
        return self.versions[-1].version if self.versions else AS_GIVEN

    def entry(self, version: str) -> SurfaceVersion | None:
        """Return the entry of a version; None if it is not listed."""
        return next((one for one in self.versions[::-1] if one.version == version), None)

    def at(self, moment_ns: int | None) -> SurfaceVersion | None:
        """Return the version in use at a time; None: as given. Raises StoreError for a time of which nothing is kept
        any more."""
        past = [one for one in self.versions if moment_ns is None or one.as_of_ns <= moment_ns]
        if past:
            return past[-1]
        if self.forgotten and moment_ns is not None:
            kept = "none is kept"
            if self.versions:
                since = np.datetime64(self.versions[0].as_of_ns, "ns").astype("datetime64[s]")
                kept = f"{KEPT} are kept, the first of {since} UTC; give a later time"
            raise StoreError(
                f"the surface used at that time is not kept: {kept}, or export bare earth as given with a site file "
                "without terrain.trace_confirmed"
            )
        return None
