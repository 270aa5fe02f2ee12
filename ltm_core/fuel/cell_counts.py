"""Count frames and labels of each fuel cell: coverage, and the paper's majority map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, Int32Array, UInt8Array
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.grid import GridGeometry

UNSEEN = 255
"""Class of a cell that no pixel has voted in."""


class MajorityFuelMap:
    """Sums votes and names each cell's winner.

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
            raise ImageError(f"votes of {votes.source} are on {votes.geometry}, this map is on {self.geometry}")
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
        """The winning class of every cell, (H, W) uint8; UNSEEN where none has voted."""
        winner = self.totals.argmax(axis=2).astype(np.uint8)
        return np.where(self.totals.any(axis=2), winner, np.uint8(UNSEEN))

    def share(self) -> Float32Array:
        """The winner's share of all votes in its cell, (H, W) in [0, 1]; NaN where none has voted."""
        total = self.totals.sum(axis=2).astype(np.float64)
        with np.errstate(invalid="ignore"):
            return np.asarray(self.totals.max(axis=2) / total, np.float32)


@dataclass(frozen=True, eq=False)
class Seen:
    """By one camera, (H, W) each. `frames`: how many saw the cell. `footprint`: metres of ground away from the camera
    that a pixel covered at best, NaN where none is known.
    """

    frames: Int32Array
    footprint: Float32Array


class CoverageMap:
    """Counts the votes of frames by camera, on one fuel grid."""

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
        """(H, W): how many cameras saw each cell."""
        seen = [camera.frames > 0 for camera in self.cameras.values()]
        return np.sum(seen, axis=0, dtype=np.int32) if seen else np.zeros(self.geometry.shape, np.int32)
