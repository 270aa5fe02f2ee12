"""Detect a camera whose stated poses cannot belong to its images, by the skyline of its labels."""

import math
from collections import deque

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.pipeline.site_surface import site_terrain
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem, skyline_observations
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior
from ltm_core.site.site import Site
from ltm_core.vision.labels import Label

FRAMES = 10
"""Number of clear images that are compared with the terrain."""
_EVERY_NS, _SETTLED_NS = 60 * 10**9, 600 * 10**9
"""Minimum time between two images that are compared, before and after the poses have been confirmed."""
_LEAST_SKYLINE = 0.5
"""Minimum share of the columns that have a skyline, so that an image is clear. Images with less show sky between
branches, and labels of sky on the land."""
_CONTRADICTED, _CONFIRMED = 0.2, 0.05
"""Mean share of the columns that contradict the terrain, from which poses are wrong, and up to which they are
confirmed. With correct poses it is 0.00 on the rendered frames of `bags/demo` and `bags/phone` and in a real webcam's
photo (Finse). Haze that hides far slopes adds to it."""
_SIGMAS, _LEAST = 4.0, math.radians(1.0)
"""Error of a column, in standard deviations and in radians, above both of which it contradicts the terrain. Smaller
errors of the pose are for `refine_poses`."""
_MOST_ANGLE_SIGMA = math.radians(1.0)
"""Standard deviation of a stated direction above which it is not compared: the skyline may lie anywhere."""


class PoseWatch:
    """Compare the skyline of one camera's labels with that of the terrain at the stated poses.

    Land beyond the DEM may stand over its horizon; a skyline that such land explains contradicts nothing."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self._shares: deque[float] = deque(maxlen=FRAMES)
        self._last_ns: int | None = None
        self.reason = ""
        """Why the poses cannot be right; empty if they may be."""

    def look(
        self, labels: UInt8Array, camera: Camera, pose: Pose, covariance: Float64Array | None, stamp_ns: int
    ) -> None:
        """Compare a frame, if the last one is long enough ago. `labels`: (H, W); `covariance`: (6, 6) of the pose;
        None: it is exact."""
        settled = len(self._shares) == FRAMES and np.mean(self._shares) <= _CONFIRMED
        if self._last_ns is not None and 0 <= stamp_ns - self._last_ns < (_SETTLED_NS if settled else _EVERY_NS):
            return
        if covariance is not None and not np.sqrt(np.diag(covariance)[3:].max()) <= _MOST_ANGLE_SIGMA:
            return
        share = contradicted_share(labels, camera, pose, site_terrain(self._site))
        if share is None:
            return
        self._last_ns = stamp_ns
        self._shares.append(share)
        mean = float(np.mean(self._shares))
        if len(self._shares) == FRAMES and mean >= _CONTRADICTED:
            self.reason = (
                f"in the last {FRAMES} clear images {mean:.0%} of the skyline contradict the terrain at the stated "
                f"poses (newest azimuth {pose.angles_deg[0]:.0f} deg): check position, direction and field of view, "
                "and whether the images are of this camera"
            )
        elif mean < _CONTRADICTED / 2:
            self.reason = ""


def contradicted_share(labels: UInt8Array, camera: Camera, pose: Pose, terrain: SearchTerrain) -> float | None:
    """Return the share of the columns whose skyline contradicts the terrain; None for an image without a clear skyline,
    and for a camera beside the DEM or under its ground, which the tracer reports."""
    sky = np.where(labels == np.uint8(Label.SKY), np.uint8(255), np.uint8(0))
    evidence = picture_evidence(np.repeat(sky[..., None], 3, axis=2), labels, camera)
    skyline = evidence.skyline
    if skyline is None or len(skyline.u) * skyline.spacing < _LEAST_SKYLINE * evidence.camera.width:
        return None
    try:
        prior = PosePrior(pose, 1.0, 1.0, 1.0)
        horizon = terrain.horizon_for(evidence.camera, prior)
    except PoseError:
        return None
    rows = skyline_observations(pose, evidence.camera, PoseProblem(evidence, horizon, prior), 1.0)
    if rows is None:
        return None
    limit = np.maximum(_SIGMAS * rows.sigma, _LEAST * evidence.camera.fy)
    return float(((np.abs(rows.error) > limit) & (rows.weight > 0)).mean())
