"""For each fuel cell and camera, the number of frames that saw the cell and the finest pixel footprint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.fuel.votes import CellVotes
from ltm_core.grid import GridGeometry
from ltm_core.types import Float32Array, Int32Array


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
