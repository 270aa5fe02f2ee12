"""Prepare the evidence of a photo, and score how well the terrain's contours match its edges, for many poses."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import ImageError
from ltm_core.base.kernels import kernel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, IndexArray, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline.image_edges import (
    ORIENTATIONS,
    ImageContours,
    ImageSkyline,
    image_contours,
    image_skyline,
)
from ltm_core.pose_estimation.skyline.terrain_horizon import TerrainHorizon
from ltm_core.vision.labels import UNLABELLED, Label

MOST_POINTS, _MOST_SCORED = 700, 4000  # maximum number of ridge points in a view by which a pose is refined, or scored
_NEAREST = 150.0  # minimum range of ridges in metres
_EDGE_WIDTH, _COARSE_WIDTH = 640, 320  # widths in pixels of the images in which edges are searched, and poses compared
RIDGE_WEIGHT, _MOST_SCORE = 0.4, 8.0  # weight of half the square of a robust z-score, and its maximum
_ONE_EDGE = 8.0  # length in pixels of the edge image along a ridge within which an edge is continuous
SPREAD = 0.7  # standard deviation of a pixel's response, and so of random scores


@dataclass(frozen=True, eq=False)
class ContourDirections:
    """Directions (M, 3) in the map frame of points of contours, of the next point on each, their range and the DEM's
    cell there (M,), metres. `every`: number of points that each represents."""

    here: Float64Array
    following: Float64Array
    range: Float64Array
    cell: Float64Array
    every: int = 1

    @classmethod
    def of(cls, horizon: TerrainHorizon, with_horizon: bool = False) -> "ContourDirections":
        """Return the points beyond 150 m; nearer ridges are trees as much as terrain. `with_horizon`: including the
        horizon where it is a ridge."""
        c = horizon.contours
        here = np.flatnonzero((c.following >= 0) & (c.range > _NEAREST))
        after, points = c.following[here], [c.azimuth, c.tangent, c.range, c.cell]
        if with_horizon:
            t, r = horizon.tangent, horizon.range
            steady = (np.abs(np.diff(t)) < 4 * horizon.step) & (r[:-1] > _NEAREST) & (r[1:] > _NEAREST)
            steady &= np.abs(np.diff(np.log(np.maximum(r, 1.0)))) < 0.12
            steady &= ~(horizon.at_edge[:-1] | horizon.at_edge[1:])
            k = len(c) + np.flatnonzero(steady)  # the horizon's points come after those of the contours
            here, after = np.concatenate([here, k]), np.concatenate([after, k + 1])
            added = (horizon.azimuths, t, r, horizon.cell)
            points = [np.concatenate(pair) for pair in zip(points, added, strict=True)]
        azimuth, tangent, ranges, cells = points
        seen, following = (_directions(azimuth[at], tangent[at]) for at in (here, after))
        return cls(seen, following, ranges[here], cells[here])

    def in_view(self, pose: Pose, camera: Camera, most: int = MOST_POINTS) -> "ContourDirections":
        """Return at most `most` points in front of a camera or slightly beside it."""
        ahead = self.here @ pose.rotation
        wide = 1.15 * max(camera.cx, camera.width - camera.cx) / camera.fx
        kept = np.flatnonzero((ahead[:, 2] > 0.05) & (np.abs(ahead[:, 0]) < wide * ahead[:, 2]))
        every = max(1, -(-len(kept) // most))
        return self._only(kept[::every], every)

    def thinned(self, every: int) -> "ContourDirections":
        """Return every n-th point."""
        return self._only(np.arange(0, len(self.range), every), every)

    def _only(self, kept: IndexArray, every: int) -> "ContourDirections":
        here, following = self.here[kept], self.following[kept]
        return ContourDirections(here, following, self.range[kept], self.cell[kept], self.every * every)


def _directions(azimuth: Float64Array, tangent: Float64Array) -> Float64Array:
    return np.column_stack([np.sin(azimuth), np.cos(azimuth), tangent])


def contour_scores(
    rotations: Float64Array, directions: ContourDirections, camera: Camera, edges: ImageContours
) -> tuple[Float64Array, Float64Array]:
    """Return the scores (P,) of rotations (P, 3, 3), optical to map, of an undistorted camera of the photo's size: the
    sum of responses over what they are in the mean of the image, by the root of their number; and their number (P,)."""
    mean = edges.response.mean(axis=(1, 2), dtype=np.float64)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    turns, d = np.ascontiguousarray(rotations, np.float64), directions
    scores, counts = _scores(turns, d.here, d.following, lens, edges.response, edges.scale, mean)
    return scores, counts


def ridge_gain(z: ArrayLike) -> Float64Array:
    """Return by how much ridges reduce the cost of poses with these robust z-scores among all compared poses."""
    counted = np.clip(z, 0.0, _MOST_SCORE)
    return np.asarray(RIDGE_WEIGHT * counted * counted / 2, np.float64)


def ridge_strength(
    pose: Pose, directions: ContourDirections, step: float, camera: Camera, edges: ImageContours
) -> float:
    """Return the strength of edges on the ridges of a pose in multiples of chance; ridges within 8 pixels count as one.
    `step`: radians of azimuth between the contours' points."""
    around = directions.in_view(pose, camera, _MOST_SCORED)
    scores, counts = contour_scores(pose.rotation[None], around, camera, edges)
    count = float(counts[0])
    if count < 5:
        return 0.0
    excess = float(scores[0]) * math.sqrt(count + 20.0) / count
    length = count * around.every * step * camera.fx / edges.scale
    return excess * math.sqrt(length / _ONE_EDGE) / SPREAD


@kernel(nogil=True)
def _scores(
    rotations: Float64Array,
    here: Float64Array,
    following: Float64Array,
    lens: Float64Array,
    response: Float32Array,
    scale: float,
    mean: Float64Array,
) -> tuple[Float64Array, Float64Array]:
    scores, counts = np.zeros(len(rotations)), np.zeros(len(rotations))
    fx, fy, cx, cy = lens
    height, width = response.shape[1], response.shape[2]
    for p in range(len(rotations)):
        m = rotations[p]
        total, count = 0.0, 0
        for k in range(len(here)):
            x, y, t = here[k, 0], here[k, 1], here[k, 2]
            z = m[0, 2] * x + m[1, 2] * y + m[2, 2] * t
            if z < 0.1:
                continue
            u = (fx * (m[0, 0] * x + m[1, 0] * y + m[2, 0] * t) / z + cx + 0.5) / scale
            v = (fy * (m[0, 1] * x + m[1, 1] * y + m[2, 1] * t) / z + cy + 0.5) / scale
            if u < 2 or v < 2 or u >= width - 2 or v >= height - 2:
                continue
            x, y, t = following[k, 0], following[k, 1], following[k, 2]
            z = m[0, 2] * x + m[1, 2] * y + m[2, 2] * t
            du = (fx * (m[0, 0] * x + m[1, 0] * y + m[2, 0] * t) / z + cx + 0.5) / scale - u
            dv = (fy * (m[0, 1] * x + m[1, 1] * y + m[2, 1] * t) / z + cy + 0.5) / scale - v
            normal = math.atan2(du, -dv)
            o = math.floor(normal * (ORIENTATIONS / math.pi) + 0.5) % ORIENTATIONS
            total += response[o, int(v), int(u)] - mean[o]
            count += 1
        scores[p], counts[p] = total / math.sqrt(count + 20.0), count
    return scores, counts


_WORKING_WIDTH = 1280  # pixels; wider photos are reduced to it
_BORDER = 0.006  # share of the width within which a skyline beside a hidden area is the border of that area
_SKY_EDGE = 0.01  # distance from land, share of the width, within which edges are kept; clouds' are further up
_LEAST_SKY = 0.1  # minimum share of columns that must have a skyline


@dataclass(frozen=True, eq=False)
class PictureEvidence:
    """Evidence in a photo, undistorted and at its working size: `skyline` (None: no sky), the labels (H, W) for the
    cover of ridges, and `find`, which returns the edges at a width in pixels, and keeps them."""

    camera: Camera
    labels: UInt8Array
    skyline: ImageSkyline | None
    find: Callable[[int], ImageContours]

    @property
    def edges(self) -> ImageContours:
        """Return the edges to which ridges are fitted."""
        return self.find(_EDGE_WIDTH)

    @property
    def coarse_edges(self) -> ImageContours:
        """Return the edges by which poses are compared; tracking a pose does not need them."""
        return self.find(_COARSE_WIDTH)

    @property
    def plants(self) -> float:
        """Return the share of trees and shrubs in the land."""
        land = self.labels != np.uint8(Label.SKY)
        grown = (self.labels == np.uint8(Label.TREE)) | (self.labels == np.uint8(Label.SHRUB))
        return float(grown.sum()) / max(float(land.sum()), 1.0)


def picture_evidence(
    photo: UInt8Array,
    labels: UInt8Array,
    camera: Camera,
    hidden: BoolArray | None = None,
) -> PictureEvidence:
    """Return the evidence in a photo (H, W, 3) with labels (H, W), except in `hidden` (H, W). Raises ImageError."""
    size = (camera.height, camera.width)
    if photo.shape != (*size, 3) or labels.shape != size or (hidden is not None and hidden.shape != size):
        raise ImageError(f"photo {photo.shape}, labels {labels.shape} and camera {size} must have one size (H, W)")
    masked = np.zeros(size, np.uint8) if hidden is None else hidden.astype(np.uint8)
    width = min(camera.width, _WORKING_WIDTH)
    work = camera.resized(width, max(2, round(camera.height * width / camera.width)))
    shape = (work.width, work.height)
    small = cv2.resize(photo, shape, interpolation=cv2.INTER_AREA) if width < camera.width else photo
    ids, masked = (cv2.resize(of, shape, interpolation=cv2.INTER_NEAREST) for of in (labels, masked))
    if any(work.distortion):
        lens = work.matrix, np.array(work.distortion)
        x, y = cv2.initUndistortRectifyMap(*lens, np.eye(3), work.matrix, shape, cv2.CV_32FC1)
        small = cv2.remap(small, x, y, cv2.INTER_LINEAR)
        ids = cv2.remap(ids, x, y, cv2.INTER_NEAREST, borderValue=int(UNLABELLED))
        masked = cv2.remap(masked, x, y, cv2.INTER_NEAREST, borderValue=1)
        work = Camera(work.width, work.height, work.fx, work.fy, work.cx, work.cy)
    shut = masked > 0
    ids = np.where(shut, np.uint8(UNLABELLED), ids).astype(np.uint8)
    skyline = image_skyline(small, ids if hidden is None else _seen_through(ids, shut))
    sky, near = ids == np.uint8(Label.SKY), shut
    if hidden is not None:  # where the skyline may be the border of a hidden area
        reach = max(4, round(_BORDER * work.width))
        near = cv2.dilate(masked, np.ones((2 * reach + 1, 1), np.uint8)) > 0
    rows = np.clip(np.rint(skyline.v).astype(np.intp), 0, work.height - 1)
    skyline = skyline.only(~near[rows, skyline.u.astype(np.intp)])
    found = len(skyline.u) * skyline.spacing >= _LEAST_SKY * work.width

    @cache
    def edges(pixels: int) -> ImageContours:
        # Of the sky what is well above the land alone: where it ends stands a crest's own edge, without which the crest
        # would be laid on what is below it.
        reach = max(3, round(_SKY_EDGE * work.width))
        clear = cv2.erode(sky.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
        return image_contours(small, pixels, shut | clear)

    return PictureEvidence(work, ids, skyline if found else None, edges)


def _seen_through(ids: UInt8Array, shut: BoolArray) -> UInt8Array:
    """Return the labels (H, W) in whose columns a hidden pixel goes on what is above it, or, at the top, what comes
    below: a caption over the sky is no land, and a lens's corner does not cover its columns."""
    first = np.argmin(shut, axis=0)
    row = ids[first, np.arange(ids.shape[1])]
    found = np.empty_like(ids)
    for v in range(len(ids)):
        row = np.where(shut[v], row, ids[v])
        found[v] = row
    return found
