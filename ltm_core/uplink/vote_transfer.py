"""Transfer votes from the fuel grid of a tower's site to that of its region, which may have another origin or CRS."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
from pyproj.exceptions import ProjError

from ltm_core.base.errors import MessageError
from ltm_core.base.types import Int64Array
from ltm_core.fuel.export.export_grid import GridTransfer
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.geodesy import SiteFrame, same_crs
from ltm_core.geometry.grid import GridGeometry

MOST_CELLS: Final = 4_000_000
"""Maximum number of cells of a tower's grid: 60 km square at 30 m."""


class VoteTransfer:
    """Transfer by nearest cell, as `GridTransfer`; exact if both grids have one CRS and coinciding cells, else evidence
    moves by half a cell at most. Bearings are turned from one grid north to the other.

    `source`: the tower's fuel grid, `target`: the region's, in their CRSs. `in_map`: the latter in the map frame of the
    region, on which the votes are afterwards. Raises MessageError for another cell size, a grid that is too large, or
    no transformation; ConfigError for an invalid CRS."""

    def __init__(self, source: GridGeometry, target: GridGeometry, in_map: GridGeometry) -> None:
        if source.resolution != target.resolution:
            raise MessageError(
                f"the tower's fuel cells are {source.resolution:g} m wide, the region's {target.resolution:g} m: "
                "evidence of different cells cannot be added; set fuel.resolution of the tower's site"
            )
        if source.width * source.height > MOST_CELLS:
            raise MessageError(f"the tower's fuel grid has {source.shape} cells; the limit is {MOST_CELLS}")
        self.source, self._in_map = source, in_map
        self._source_frame, self._target_frame = SiteFrame(str(source.crs)), SiteFrame(str(target.crs))
        number = np.arange(source.width * source.height, dtype=np.int64).reshape(source.shape)
        try:
            from_cell = GridTransfer(source, target).layer(number, -1).ravel()
        except ProjError as error:
            raise MessageError(f"no transformation from {target.crs} to the tower's {source.crs} ({error})") from error
        cells = np.flatnonzero(from_cell >= 0)
        self._targets: Int64Array = cells[np.argsort(from_cell[cells], kind="stable")]
        """Cells of the region by the tower's cells that they take from; `_first` has the start of each list."""
        self._first = np.searchsorted(from_cell[self._targets], np.arange(number.size + 1))
        self._same_crs = same_crs(source.crs, target.crs)
        self._same_cells = source == target

    def votes(self, votes: CellVotes) -> CellVotes:
        """Return the votes, which are on `source`, on the region's grid, in row-major order; votes outside it are
        dropped."""
        if votes.geometry.shape != self.source.shape:
            raise MessageError(f"votes of {votes.source} are on {votes.geometry}, not on {self.source}")
        if self._same_cells:
            return replace(votes, geometry=self._in_map)
        own = votes.rows.astype(np.int64) * self.source.width + votes.cols
        first, counts = self._first[own], self._first[own + 1] - self._first[own]
        taken = np.repeat(np.arange(len(own)), counts)
        cells = self._targets[np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(len(taken))]
        order = np.argsort(cells)
        moved = votes.only(taken[order])
        rows, cols = (index.astype(np.int32) for index in np.divmod(cells[order], self._in_map.width))
        if moved.visibility is not None and not self._same_crs and len(moved):
            bearing = np.mod(moved.visibility.bearing.astype(np.float64) + self._turn(moved), 2 * math.pi)
            moved = replace(moved, visibility=replace(moved.visibility, bearing=bearing.astype(np.float32)))
        return replace(moved, geometry=self._in_map, rows=rows, cols=cols)

    def _turn(self, votes: CellVotes) -> float:
        """Return the radians from a bearing of the tower's grid to that of the region's: the difference of their
        convergences. Raises MessageError if the tower's CRS has none."""
        # Over what a camera sees the difference changes by less than a hundredth of a degree.
        x, y = self.source.to_map(votes.rows.mean(), votes.cols.mean())
        lon, lat = self._source_frame.to_lonlat(float(x), float(y))
        there = self._target_frame.from_lonlat(lon, lat)
        own = self._source_frame.grid_convergence_deg(float(x), float(y))
        other = self._target_frame.grid_convergence_deg(float(there[0]), float(there[1]))
        if not math.isfinite(own - other):
            raise MessageError(f"{self.source.crs} is not defined in the region: check the CRS of the tower's site")
        return math.radians(own - other)
