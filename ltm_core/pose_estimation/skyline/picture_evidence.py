"""Prepare a photo for the search of its pose: undistort and resize it, and find its skyline and edges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.pose_estimation.skyline.image_edges import ImageContours, ImageSkyline, image_contours, image_skyline
from ltm_core.pose_estimation.skyline.picture_pose_config import ContourConfig, PicturePoseConfig
from ltm_core.vision.labels import UNLABELLED, Label

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
