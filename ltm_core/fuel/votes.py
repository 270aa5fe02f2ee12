"""Votes of one frame: the fuel cells that it sees, how well it sees them, and their pixels by label."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int32Array, UInt8Array, UInt32Array
from ltm_core.fuel.life_form import GroundLimits
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose, checked_covariance
from ltm_core.raster.dem import Dem
from ltm_core.visibility.footprint import arrival_directions, ground_normals

_LEAST_FACING = 0.02
"""Sine of about 1 degree, the flattest line of sight; flatter ones would give infinities to first order."""


@dataclass(frozen=True, eq=False)
class CellVisibility:
    """Visibility of cells, (N,) float32 each. `cos_incidence`: of the angle between sight and the ground's normal; 0
    along the ground and where it is not known. `footprint`: metres of ground, away from the camera, that one pixel
    covers. `sigma_along`, `sigma_across`: metres by which the pose's uncertainty may misplace the cell on the map, away
    from the camera and sideways. `bearing`: radians clockwise from grid north from the camera to the cell."""

    cos_incidence: Float32Array
    footprint: Float32Array
    sigma_along: Float32Array
    sigma_across: Float32Array
    bearing: Float32Array

    def __post_init__(self) -> None:
        lengths = [np.shape(column) for column in self.columns()]
        if len(set(lengths)) != 1 or len(lengths[0]) != 1:
            raise ImageError(f"the columns of a cell visibility differ in shape: {lengths}")

    def columns(self) -> tuple[Float32Array, ...]:
        return self.cos_incidence, self.footprint, self.sigma_along, self.sigma_across, self.bearing

    def placement(self, cell: float) -> Float64Array:
        """Return the weight in (0, 1] of a cell of `cell` metres; 1 for a frame that resolves it and views it
        perpendicularly. It is the share of the cell in the area over which one pixel's vote may lie."""
        along = np.hypot(self.footprint, self.sigma_along).astype(np.float64)
        return np.asarray(cell / np.hypot(cell, along) * (cell / np.hypot(cell, self.sigma_across)), np.float64)

    def only(self, chosen: NDArray[Any]) -> "CellVisibility":
        return CellVisibility(*(column[chosen] for column in self.columns()))

    def __len__(self) -> int:
        return len(self.bearing)


def cell_visibility(
    x: Float64Array,
    y: Float64Array,
    dem: Dem,
    cell: float,
    camera: Camera,
    pose: Pose,
    bend: float = 0.0,
    covariance: ArrayLike | None = None,
) -> CellVisibility:
    """Return how a camera sees the ground at map points (N,), with its slope taken over the width of a cell.

    To first order, on the ground's plane at each point: with the ray arriving along the unit vector d, the ground's
    normal n and p the way from camera to point, a camera moved by o and turned by w moves the ray's end by
    q = o + w x p, and the traced point by q - d (n.q) / (n.d). Source: forward propagation, e.g. Luhmann et al.,
    Close-Range Photogrammetry, 3rd ed., 2.4.3. Raises PoseError for a covariance that is none."""
    ground = np.column_stack([x, y, dem.elevation_at(x, y)])
    normals = ground_normals(dem, x, y, cell / 2)
    known = np.isfinite(ground[:, 2]) & np.isfinite(normals[:, 0])
    ground[~known, 2] = pose.position[2]
    normals[~known] = (0.0, 0.0, 1.0)
    arriving = arrival_directions(pose.position, ground, bend)
    lever = ground - pose.position
    facing = -np.einsum("ni,ni->n", normals, arriving)
    cosine = np.where(known, np.clip(facing, 0.0, 1.0), 0.0)
    facing = np.maximum(facing, _LEAST_FACING)
    distance = np.linalg.norm(lever, axis=1)
    footprint = distance / (min(camera.fx, camera.fy) * facing)
    bearing = np.arctan2(lever[:, 0], lever[:, 1])
    sigmas = [np.zeros(len(lever))] * 2
    if covariance is not None:
        matrix, east, north = checked_covariance(covariance), np.sin(bearing), np.cos(bearing)
        for k, level in enumerate(((east, north), (north, -east))):  # away from the camera, and sideways
            # The component h.(q - d (n.q) / (n.d)) of a level direction h is g.q with g = h + n (h.d) / facing.
            slope = (level[0] * arriving[:, 0] + level[1] * arriving[:, 1]) / facing
            g = normals * slope[:, None]
            g[:, 0] += level[0]
            g[:, 1] += level[1]
            row = np.concatenate([g, np.cross(lever, g)], axis=1)
            sigmas[k] = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", row, matrix, row), 0))
    return CellVisibility(*(np.asarray(c, np.float32) for c in (cosine, footprint, *sigmas, bearing)))


@dataclass(frozen=True, eq=False)
class CellVotes:
    """Sparse votes of one frame over the fuel grid.

    `geometry`: the fuel grid in the map frame. `rows`, `cols`: (N,) int32, its cells that the frame sees, each once,
    in row-major order. `counts`: (N, K) uint32 pixels per class. `z`: (N,) float32 terrain height at the cell
    centres, so that the votes are labelled 3D points, the paper's P(x, y) and L(x, y). `source`: the camera.
    `confidence`: (N,) float32, the pixels' mean in [0, 1]; None: 1, the labels say nothing of it. `visibility`: how the
    frame sees each cell; None: not known, and evidence then takes the votes as perfectly placed. `too_steep`:
    pixels that the terrain withdrew (`GroundLimits`), for whoever watches; no evidence."""

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

    def __post_init__(self) -> None:
        n, shapes = len(self.rows), {"columns": self.cols.shape, "heights": self.z.shape}
        shapes["counts"] = self.counts.shape[:1] if self.counts.ndim == 2 else ()
        shapes |= {} if self.confidence is None else {"confidence": self.confidence.shape}
        shapes |= {} if self.visibility is None else {"visibility": (len(self.visibility),)}
        if wrong := {name: shape for name, shape in shapes.items() if shape != (n,)}:
            raise ImageError(f"votes of {self.source} for {n} cells differ in length: {wrong}")
        inside = self.geometry.contains(self.rows, self.cols)
        if not inside.all():
            first = int(np.argmin(inside))
            raise ImageError(
                f"votes of {self.source} name cell ({self.rows[first]}, {self.cols[first]}), "
                f"outside a fuel grid of {self.geometry.shape} cells"
            )

    def __len__(self) -> int:
        return len(self.rows)

    def only(self, chosen: NDArray[Any]) -> "CellVotes":
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
    """Compute the votes of frames over the fuel grid `geometry`, in the map frame, on the terrain `dem`.

    Args:
        votes_for: (K,) which classes are ground cover; the sky, and ids of K and more, never vote.
        max_range: slant metres beyond which pixels are too coarse to vote.
        bend: of sight by curvature and refraction (`geodesy.ray_bend`).
        limits: where classes cannot be; None: they can be anywhere."""

    def __init__(
        self,
        geometry: GridGeometry,
        dem: Dem,
        votes_for: BoolArray,
        max_range: float = np.inf,
        bend: float = 0.0,
        limits: GroundLimits | None = None,
    ) -> None:
        self.geometry, self._dem, self._classes = geometry, dem, len(votes_for)
        self._counted = np.zeros(256, np.bool_)
        self._counted[: self._classes] = votes_for
        self._max_range, self._bend, self._limits = max_range, bend, limits

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
        """Count each pixel's label in the fuel cell that it sees. Raises ImageError if the images differ in shape,
        PoseError for an invalid covariance.

        Args:
            distance: (H, W) metres along the optical axis (a REP-118 depth image), or along the rays where not
                `along_axis`; +inf sky, NaN unknown.
            labels, confidence: (H, W) uint8 class ids, and their confidence x 255.
            covariance: (6, 6) of the pose, as in geometry_msgs/PoseWithCovariance; None: the pose is exact."""
        shape = (camera.height, camera.width)
        images: dict[str, NDArray[Any] | None] = {"labels": labels, "distances": distance, "confidence": confidence}
        for name, image in images.items():
            if image is not None and image.shape != shape:
                raise ImageError(f"{name} of {image.shape} does not match the camera of {shape} of {source}")
        # Here, for who only passes votes on (the uplink, the viewer) needs no numba.
        from ltm_core.fuel.vote_kernel import sum_pixels

        of_frame = distance, along_axis, camera, pose, labels, confidence
        given = *of_frame, self._counted, self._classes, self.geometry, self._max_range, self._limits
        sums = sum_pixels(*given)
        if self._limits is not None and sums.counts[:, self._limits.learn(sums.cells)[: self._classes]].any():
            sums = sum_pixels(*given)
        rows, cols = (index.astype(np.int32) for index in np.divmod(sums.cells, self.geometry.width))
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
        return CellVotes(self.geometry, rows, cols, sums.counts, z, stamp_ns, source, mean, visibility, sums.withdrawn)
