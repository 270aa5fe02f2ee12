"""Votes of one frame: which fuel cells it sees, and how many of their pixels carry each label."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ltm_core.dem import Dem
from ltm_core.depth.range_image import RangeImage
from ltm_core.errors import ImageError
from ltm_core.grid import GridGeometry


@dataclass(frozen=True, eq=False)
class CellVotes:
    """Sparse votes of one frame over the fuel grid.

    `geometry`: the fuel grid in the map frame. `rows`, `cols`: (N,) int32, its cells that the frame sees, each once,
    in row-major order. `counts`: (N, K) uint32 pixels per class. `z`: (N,) float32 terrain height at the cell
    centres, so that the votes are labelled 3D points, the paper's P(x, y) and L(x, y). `source`: the camera.
    """

    geometry: GridGeometry
    rows: NDArray[np.int32]
    cols: NDArray[np.int32]
    counts: NDArray[np.uint32]
    z: NDArray[np.float32]
    stamp_ns: int
    source: str

    def __post_init__(self) -> None:
        n = len(self.rows)
        if self.cols.shape != (n,) or self.z.shape != (n,) or self.counts.ndim != 2 or len(self.counts) != n:
            raise ImageError(
                f"votes of {self.source} disagree in length: {n} rows, {self.cols.shape} columns, "
                f"{self.counts.shape} counts, {self.z.shape} heights"
            )
        inside = self.geometry.contains(self.rows, self.cols)
        if not inside.all():
            first = int(np.argmin(inside))
            raise ImageError(
                f"votes of {self.source} name cell ({self.rows[first]}, {self.cols[first]}), "
                f"outside a fuel grid of {self.geometry.shape} cells"
            )

    def centres(self) -> NDArray[np.float32]:
        """Map coordinates of the cells' centres on the terrain, (N, 3) metres."""
        x, y = self.geometry.to_map(self.rows, self.cols)
        return np.column_stack([x, y, self.z]).astype(np.float32)


def cast_votes(
    ranges: RangeImage,
    labels: NDArray[np.uint8],
    geometry: GridGeometry,
    dem: Dem,
    votes_for: NDArray[np.bool_],
    stamp_ns: int,
    source: str,
    max_range: float = np.inf,
) -> CellVotes:
    """Count each pixel's label in the fuel cell that it sees.

    `labels`: (H, W) uint8 class ids. `votes_for`: (K,) which classes are ground cover; the sky, and ids of K and
    more, never vote. `max_range`: slant metres beyond which pixels are too coarse to vote. Raises ImageError when
    labels and ranges differ in shape.
    """
    if labels.shape != ranges.range.shape:
        raise ImageError(f"labels of {labels.shape} and ranges of {ranges.range.shape} are not of one image")
    classes = len(votes_for)
    counted = np.zeros(256, bool)
    counted[:classes] = votes_for
    voting = np.isfinite(ranges.range) & (ranges.range <= max_range) & counted[labels]
    points = ranges.points()[voting]
    row, col = geometry.cell_of(points[:, 0], points[:, 1])
    inside = geometry.contains(row, col)
    cell = row[inside] * geometry.width + col[inside]
    ballots, counts_of = np.unique(cell * classes + labels[voting][inside], return_counts=True)
    seen, position = np.unique(ballots // classes, return_inverse=True)
    counts = np.zeros((len(seen), classes), np.uint32)
    counts[position, ballots % classes] = counts_of
    rows, cols = (seen // geometry.width).astype(np.int32), (seen % geometry.width).astype(np.int32)
    z = dem.elevation_at(*geometry.to_map(rows, cols)).astype(np.float32)
    return CellVotes(geometry, rows, cols, counts, z, stamp_ns, source)
