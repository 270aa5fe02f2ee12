"""Prepares a photo for the search of its pose: undistorted, in a working size, its skyline and edges found."""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.camera import Camera
from ltm_core.errors import ImageError
from ltm_core.pose_estimation.image_contours import image_contours
from ltm_core.pose_estimation.image_skyline import image_skyline
from ltm_core.pose_estimation.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.pose_refinement import PictureEvidence
from ltm_core.types import BoolArray, UInt8Array
from ltm_core.vision.labels import UNLABELLED, Label

_LEAST_SKY = 0.1
"""Share of columns that a skyline must have to be one."""


def picture_evidence(
    photo: UInt8Array,
    labels: UInt8Array,
    camera: Camera,
    config: PicturePoseConfig = PicturePoseConfig(),
    hidden: BoolArray | None = None,
) -> PictureEvidence:
    """Of a photo (H, W, 3) of `camera`, its labels (H, W), and where it shows something else (`hidden`, (H, W): a
    caption, parts of a tower). Raises ImageError where their sizes differ.
    """
    size = (camera.height, camera.width)
    if photo.shape != (*size, 3) or labels.shape != size or (hidden is not None and hidden.shape != size):
        raise ImageError(
            f"photo {photo.shape}, labels {labels.shape} and camera {size} must be of one size, (H, W, 3) and (H, W)"
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
    skyline = image_skyline(small, ids)
    sky = ids == np.uint8(Label.SKY)
    kept = ~shut[np.clip(np.rint(skyline.v).astype(np.intp), 0, work.height - 1), skyline.u.astype(np.intp)]
    skyline = skyline.only(kept)
    found = len(skyline.u) * skyline.spacing >= _LEAST_SKY * work.width
    edges = image_contours(small, config.contours.width, shut | sky)
    coarse = image_contours(small, config.contours.coarse_width, shut | sky)
    return PictureEvidence(work, ids, skyline if found else None, edges, coarse)
