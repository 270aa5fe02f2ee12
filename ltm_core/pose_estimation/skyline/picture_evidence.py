"""Prepare what is known before the search of a pose: its prior, and the evidence in the photo."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from ltm_core.base.errors import ImageError, PoseError
from ltm_core.base.types import BoolArray, Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import UNKNOWN_AZIMUTH_SIGMA_DEG, Pose, axes_of_angles, matrix_of_vector, pose_covariance
from ltm_core.pose_estimation.skyline.image_edges import ImageContours, ImageSkyline, image_contours, image_skyline
from ltm_core.pose_estimation.skyline.picture_pose_config import ContourConfig, PicturePoseConfig
from ltm_core.vision.labels import UNLABELLED, Label

UNKNOWN_DEG = UNKNOWN_AZIMUTH_SIGMA_DEG
"""Standard deviation of an unknown azimuth in degrees."""


@dataclass(frozen=True, eq=False)
class PosePrior:
    """Prior pose with independent standard deviations: degrees of azimuth, pitch and roll, metres of x and y, and of z.

    An azimuth sigma of UNKNOWN_DEG or more says that the heading is unknown. A position sigma of 0 holds the position.
    Raises PoseError for sigmas that are none.
    """

    pose: Pose
    azimuth_sigma_deg: float = 1.5
    pitch_sigma_deg: float = 0.5
    roll_sigma_deg: float = 0.5
    position_sigma: float = 0.0
    height_sigma: float = 0.0

    def __post_init__(self) -> None:
        angles = (self.azimuth_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg)
        if not all(math.isfinite(s) and s > 0 for s in angles):
            raise PoseError(f"sigmas of azimuth, pitch and roll must be positive degrees, got {angles}")
        places = (self.position_sigma, self.height_sigma)
        if not all(math.isfinite(s) and s >= 0 for s in places):
            raise PoseError(f"sigmas of position and height must be metres, 0 or more, got {places}")

    @classmethod
    def of_covariance(cls, pose: Pose, covariance: Float64Array) -> PosePrior:
        """Return the prior of a (6, 6) covariance as in `pose_covariance`. Raises PoseError if its angles have none."""
        slopes = angle_slopes(pose)
        angles = np.degrees(np.sqrt(np.maximum(np.diag(slopes @ covariance[3:, 3:] @ slopes.T), 0.0)))
        place = np.sqrt(np.maximum(np.diag(covariance)[:3], 0.0))
        azimuth, pitch, roll = (float(a) for a in angles)
        return cls(pose, azimuth, pitch, roll, float(max(place[0], place[1])), float(place[2]))

    @property
    def heading_known(self) -> bool:
        return self.azimuth_sigma_deg < 0.99 * UNKNOWN_DEG  # it may have come through a covariance

    @property
    def sigmas(self) -> Float64Array:
        """Return (6,) sigmas: x, y, z (m), azimuth, pitch, roll (rad)."""
        angles = np.radians([self.azimuth_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg])
        return np.array([self.position_sigma, self.position_sigma, self.height_sigma, *angles])

    @property
    def covariance(self) -> Float64Array:
        """Return the covariance (6, 6) as in `pose_covariance`."""
        angles = (self.azimuth_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg)
        return pose_covariance(self.pose, self.position_sigma, self.height_sigma, *angles)

    def deviation(self, pose: Pose) -> Float64Array:
        """Return (6,) the deviation of a pose from this one: x, y, z (m), azimuth, pitch, roll (rad)."""
        return np.concatenate([pose.position - self.pose.position, angles_between(self.pose, pose)])


def angles_between(a: Pose, b: Pose) -> Float64Array:
    """Return the azimuth, pitch and roll (3,), radians in [-pi, pi), by which `b` differs from `a`."""
    change = np.radians(np.subtract(b.angles_deg, a.angles_deg))
    return np.asarray((change + math.pi) % (2 * math.pi) - math.pi, np.float64)


def angle_slopes(pose: Pose) -> Float64Array:
    """Return (3, 3) derivatives of azimuth, pitch and roll (rad) by rotations about the map's x, y and z (rad).
    Straight up or down, where azimuth and roll have one axis, each takes half of a turn about it."""
    return np.asarray(np.linalg.pinv(axes_of_angles(pose)), np.float64)


def rotations_of(angles_deg: Float64Array) -> Float64Array:
    """Return (P, 3, 3), optical to map, of azimuth, pitch and roll (P, 3), as `Pose.from_angles` has them."""
    a, p, r = np.radians(angles_deg).T
    zero = np.zeros_like(a)
    forward = np.stack([np.sin(a) * np.cos(p), np.cos(a) * np.cos(p), np.sin(p)], axis=-1)
    level_right = np.stack([np.cos(a), -np.sin(a), zero], axis=-1)
    level_down = np.cross(forward, level_right)
    c, s = np.cos(r)[:, None], np.sin(r)[:, None]
    return np.stack([c * level_right + s * level_down, c * level_down - s * level_right, forward], axis=-1)


def turned(pose: Pose, rotation: Float64Array, shift: Float64Array | None = None) -> Pose:
    """Return a pose turned by a rotation vector (3,) about the map's axes, and shifted."""
    matrix = matrix_of_vector(rotation) @ pose.rotation
    u, _, vt = np.linalg.svd(matrix)  # many small turns stay a rotation
    return Pose(pose.position if shift is None else pose.position + shift, u @ vt)


_BORDER = 0.006
"""Distance, as a share of the width, within which a skyline next to a hidden area is the border of that area."""
_SKY_EDGE = 0.01
"""Distance from the land, as a share of the width, within which edges are kept; edges of clouds further up are not."""
_LEAST_SKY = 0.1
"""Minimum share of columns that must have a skyline."""


@dataclass(frozen=True, eq=False)
class PictureEdges:
    """Edges of a photo, each computed on first use: `find` returns those at a width in pixels."""

    find: Callable[[int], ImageContours]
    config: ContourConfig

    @cached_property
    def fine(self) -> ImageContours:
        """Return the edges to which ridges are fitted."""
        return self.find(self.config.width)

    @cached_property
    def coarse(self) -> ImageContours:
        """Return the edges by which poses are compared; tracking a pose does not need them."""
        return self.find(self.config.coarse_width)


@dataclass(frozen=True, eq=False)
class PictureEvidence:
    """Evidence in a photo, undistorted and at its working size: `skyline` (None: no sky), `found`, its edges, and the
    labels (H, W) for the cover of ridges."""

    camera: Camera
    labels: UInt8Array
    skyline: ImageSkyline | None
    found: PictureEdges

    @property
    def edges(self) -> ImageContours:
        return self.found.fine

    @property
    def coarse_edges(self) -> ImageContours:
        return self.found.coarse

    @property
    def unseen(self) -> PictureEvidence:
        """Return a copy whose edges are not computed yet, to measure the time."""
        return replace(self, found=replace(self.found))

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
    config: PicturePoseConfig = PicturePoseConfig(),
    hidden: BoolArray | None = None,
) -> PictureEvidence:
    """Return the evidence in a photo (H, W, 3) of `camera` with its labels (H, W); `hidden` (H, W): captions and parts
    of a tower. Raises ImageError if their sizes differ."""
    size = (camera.height, camera.width)
    if photo.shape != (*size, 3) or labels.shape != size or (hidden is not None and hidden.shape != size):
        raise ImageError(
            f"photo {photo.shape}, labels {labels.shape} and camera {size} must have the same size, (H, W, 3) "
            "and (H, W)"
        )
    masked = np.zeros(size, np.uint8) if hidden is None else hidden.astype(np.uint8)
    width = min(camera.width, config.working_width)
    work = camera.resized(width, max(2, round(camera.height * width / camera.width)))
    shape = (work.width, work.height)
    small = cv2.resize(photo, shape, interpolation=cv2.INTER_AREA) if width < camera.width else photo
    ids = cv2.resize(labels, shape, interpolation=cv2.INTER_NEAREST)
    masked = cv2.resize(masked, shape, interpolation=cv2.INTER_NEAREST)
    if any(work.distortion):
        k1, k2, p1, p2, k3 = work.distortion
        to_x, to_y = cv2.initUndistortRectifyMap(
            work.matrix, np.array([k1, k2, p1, p2, k3]), np.eye(3), work.matrix, shape, cv2.CV_32FC1
        )
        small = cv2.remap(small, to_x, to_y, cv2.INTER_LINEAR)
        ids = cv2.remap(ids, to_x, to_y, cv2.INTER_NEAREST, borderValue=int(UNLABELLED))
        masked = cv2.remap(masked, to_x, to_y, cv2.INTER_NEAREST, borderValue=1)
        work = Camera(work.width, work.height, work.fx, work.fy, work.cx, work.cy)
    shut = masked > 0
    ids = np.where(shut, np.uint8(UNLABELLED), ids).astype(np.uint8)
    skyline = image_skyline(small, ids if hidden is None else _seen_through(ids, shut))
    sky = ids == np.uint8(Label.SKY)
    if hidden is None:
        kept = ~shut[np.clip(np.rint(skyline.v).astype(np.intp), 0, work.height - 1), skyline.u.astype(np.intp)]
        skyline = skyline.only(kept)
    else:
        skyline = _beside(skyline, shut)
    found = len(skyline.u) * skyline.spacing >= _LEAST_SKY * work.width

    def edges(pixels: int) -> ImageContours:
        # Of the sky what is well above the land alone: where it ends stands a crest's own edge, without which the crest
        # would be laid on what is below it.
        reach = max(3, round(_SKY_EDGE * work.width))
        clear = cv2.erode(sky.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
        return image_contours(small, pixels, shut | clear)

    return PictureEvidence(work, ids, skyline if found else None, PictureEdges(edges, config.contours))


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


def _beside(skyline: ImageSkyline, shut: BoolArray) -> ImageSkyline:
    """Without the columns where it may be the border of what is hidden (H, W), and without those that what is hidden
    covers up to the image's upper edge."""
    reach = max(4, round(_BORDER * shut.shape[1]))
    tall = cv2.dilate(shut.astype(np.uint8), np.ones((2 * reach + 1, 1), np.uint8)) > 0
    v = np.clip(np.rint(skyline.v).astype(np.intp), 0, len(shut) - 1)
    kept = skyline.only(~tall[v, skyline.u.astype(np.intp)])
    return replace(kept, covered_u=kept.covered_u[~shut[0, kept.covered_u.astype(np.intp)]])
