"""Votes of one frame: the fuel cells that it sees, how well it sees them, and their pixels by label."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Float32Array, Int32Array, UInt8Array, UInt32Array
from ltm_core.fuel.cell_visibility import CellVisibility, cell_visibility
from ltm_core.fuel.life_form import GroundLimits
from ltm_core.fuel.rules import FRAME_CAP
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem


@dataclass(frozen=True, eq=False)
class CellVotes:
    """Sparse votes of one frame over the fuel grid.

    `geometry`: the fuel grid in the map frame. `rows`, `cols`: (N,) int32, its cells that the frame sees, each once,
    in row-major order. `counts`: (N, K) uint32 pixels per class. `z`: (N,) float32 terrain height at the cell
    centres, so that the votes are labelled 3D points, the paper's P(x, y) and L(x, y). `source`: the camera.
    `confidence`: (N,) float32, the pixels' mean in [0, 1]; None: 1, the labels say nothing of it. `visibility`: how the
    frame sees each cell; None: not known, and evidence then takes the votes as perfectly placed. `too_steep`,
    `above_tree_line`: pixels of plants that the terrain withdrew (`growth_limits`), for whoever watches; no evidence.
    """

    geometry: GridGeometry
    rows: Int32Array
    cols: Int32Array
    counts: UInt32Array
    z: Float32Array
    stamp_ns: int
    source: str
    confidence: Float32Array | None = None
    visibility: CellVisibility | None = None
    too_steep: int = 0
    above_tree_line: int = 0

    def __post_init__(self) -> None:
        n = len(self.rows)
        if self.cols.shape != (n,) or self.z.shape != (n,) or self.counts.ndim != 2 or len(self.counts) != n:
            raise ImageError(
                f"votes of {self.source} differ in length: {n} rows, {self.cols.shape} columns, "
                f"{self.counts.shape} counts, {self.z.shape} heights"
            )
        if self.confidence is not None and self.confidence.shape != (n,):
            raise ImageError(f"votes of {self.source} for {n} cells have confidence of shape {self.confidence.shape}")
        if self.visibility is not None and len(self.visibility) != n:
            raise ImageError(f"votes of {self.source} for {n} cells have {len(self.visibility)} visibilities")
        inside = self.geometry.contains(self.rows, self.cols)
        if not inside.all():
            first = int(np.argmin(inside))
            raise ImageError(
                f"votes of {self.source} name cell ({self.rows[first]}, {self.cols[first]}), "
                f"outside a fuel grid of {self.geometry.shape} cells"
            )

    def __len__(self) -> int:
        return len(self.rows)

    def strongest(self, limit: int) -> CellVotes:
        """Return the votes of at most `limit` cells with the highest weight as evidence: the best located ones with at
        least one pixel; in row-major order."""
        if len(self) <= limit:
            return self
        pixels = np.minimum(self.counts.sum(axis=1), FRAME_CAP).astype(np.float64)
        worth = pixels if self.visibility is None else pixels * self.visibility.placement(self.geometry.resolution)
        return self.only(np.sort(np.argsort(-worth, kind="stable")[:limit]))

    def only(self, chosen: NDArray[Any]) -> CellVotes:
        """Return the votes of some of the cells: indices in rising order, or a mask (N,)."""
        return replace(
            self,
            rows=self.rows[chosen],
            cols=self.cols[chosen],
            counts=self.counts[chosen],
            z=self.z[chosen],
            confidence=None if self.confidence is None else self.confidence[chosen],
            visibility=None if self.visibility is None else self.visibility.only(chosen),
        )

    def centres(self) -> Float32Array:
        """Return the map coordinates of the cells' centres on the terrain, (N, 3) metres."""
        x, y = self.geometry.to_map(self.rows, self.cols)
        return np.column_stack([x, y, self.z]).astype(np.float32)


class VoteCaster:
    """Compute the votes of frames over one fuel grid.

    Args:
        geometry: the fuel grid, in the map frame.
        dem: the terrain, for the cells' heights and slopes.
        votes_for: (K,) which classes are ground cover; the sky, and ids of K and more, never vote.
        max_range: slant metres beyond which pixels are too coarse to vote.
        bend: of sight by curvature and refraction (`geodesy.ray_bend`).
        limits: where plants cannot stand; None: anywhere they can.
    """

    def __init__(
        self,
        geometry: GridGeometry,
        dem: Dem,
        votes_for: BoolArray,
        max_range: float = np.inf,
        bend: float = 0.0,
        limits: GroundLimits | None = None,
    ) -> None:
        self.geometry = geometry
        self._dem = dem
        self._classes = len(votes_for)
        self._counted = np.zeros(256, np.bool_)
        self._counted[: self._classes] = votes_for
        self._max_range = max_range
        self._bend = bend
        self._limits = limits

    def cast(
        self,
        distance: Float32Array,
        camera: Camera,
        pose: Pose,
        labels: UInt8Array,
        stamp_ns: int,
        source: str,
        confidence: UInt8Array | None = None,
        covariance: ArrayLike | None = None,
        along_axis: bool = True,
    ) -> CellVotes:
        """Count each pixel's label in the fuel cell that it sees.

        Args:
            distance: (H, W) metres along the optical axis (a REP-118 depth image), or along the rays where not
                `along_axis`; +inf sky, NaN unknown.
            labels: (H, W) uint8 class ids.
            confidence: (H, W) uint8, of the labels, x 255.
            covariance: (6, 6) of the pose, as in geometry_msgs/PoseWithCovariance; None: the pose is exact.

        Raises ImageError when the images differ in shape, PoseError for a covariance that is none.
        """
        shape = (camera.height, camera.width)
        images: list[tuple[str, NDArray[Any] | None]] = [("labels", labels), ("distances", distance)]
        for name, image in [*images, ("confidence", confidence)]:
            if image is not None and image.shape != shape:
                raise ImageError(f"{name} of {image.shape} does not match the camera of {shape} of {source}")
        # Here, for who only passes votes on (the uplink, the viewer) needs no numba.
        from ltm_core.fuel.vote_kernel import sum_pixels

        of_frame = distance, along_axis, camera, pose, labels, confidence
        grid = self._counted, self._classes, self.geometry, self._max_range
        limits = self._limits
        sums = sum_pixels(*of_frame, *grid, limits if limits is not None and limits.any else None)
        if limits is not None and limits.learn(sums.cells):
            sums = sum_pixels(*of_frame, *grid, limits)
        rows = (sums.cells // self.geometry.width).astype(np.int32)
        cols = (sums.cells % self.geometry.width).astype(np.int32)
        x, y = self.geometry.to_map(rows, cols)
        z = self._dem.elevation_at(x, y).astype(np.float32)
        visibility = cell_visibility(
            sums.x, sums.y, self._dem, self.geometry.resolution, camera, pose, self._bend, covariance
        )
        # Of the cells themselves and not of where in them pixels happen to lie: a camera that stays sees each of them
        # in one bearing.
        east, north = x - pose.position[0], y - pose.position[1]
        visibility = replace(visibility, bearing=np.arctan2(east, north).astype(np.float32))
        mean = None if confidence is None else (sums.confidence / 255).astype(np.float32)
        too_steep, above = (int(n) for n in sums.withdrawn)
        return CellVotes(
            self.geometry, rows, cols, sums.counts, z, stamp_ns, source, mean, visibility, too_steep, above
        )
