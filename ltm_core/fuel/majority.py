"""The paper's fuel map: a majority vote of all pixels in each 30 m cell, over frames and cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ltm_core.errors import ImageError
from ltm_core.fuel.votes import CellVotes
from ltm_core.grid import GridGeometry
from ltm_core.types import Float32Array, UInt8Array

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
