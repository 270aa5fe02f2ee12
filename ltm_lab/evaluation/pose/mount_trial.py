"""Presets of one head with the errors of its mount, and what is found from all their pictures together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.mount.mount_fit import TILT_ZERO_SIGMA_DEG, fit_mount, widened
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain, find_pose
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angle_slopes, angles_between, turned
from ltm_lab.evaluation.pose.pose_trial import PreparedFrame

_ENCODER_DEG = 0.03


@dataclass(frozen=True)
class MountTrial:
    """Of one head: `verdict`, and of each picture the errors (3) of azimuth, pitch and roll, degrees, and in sigmas;
    `focal`: the focal length found over the true one.
    """

    head: str
    verdict: str
    errors: tuple[tuple[float, ...], ...]
    z: tuple[tuple[float, ...], ...]
    focal: float = 1.0


def run_mount_trial(
    head: str,
    frames: Sequence[PreparedFrame],
    terrain: SearchTerrain,
    config: PicturePoseConfig,
    rng: np.random.Generator,
    focal_factor: float = 1.0,
    focal_sigma: float = 0.0,
) -> MountTrial:
    """Lean and turn the mount of a head (1.5 deg of yaw, 0.5 of lean), move its tilt zero (0.3) and its encoder (0.03)
    for every picture, and fit the mount from all of them; with a focal length that is off by a factor, it too."""
    lean = np.radians(rng.normal(size=3) * (0.5, 0.5, 1.5))
    tilt = np.radians(TILT_ZERO_SIGMA_DEG * rng.normal())
    priors, searches = [], []
    for prepared in frames:
        noise = np.radians(_ENCODER_DEG * rng.normal(size=3))
        up = Rotation.from_rotvec([tilt, 0.0, 0.0]).as_matrix()
        true = prepared.frame.pose
        told = turned(turned(Pose(true.position, true.rotation @ up), lean), noise)
        prior = PosePrior(told, 1.5, 0.5, 0.5)
        priors.append(prior)
        evidence = prepared.evidence
        if focal_factor != 1.0:
            evidence = replace(evidence, camera=evidence.camera.zoomed(focal_factor))
        searches.append(find_pose(evidence, terrain, widened(prior, TILT_ZERO_SIGMA_DEG), config, focal_sigma))
    fit = fit_mount(priors, searches, config, focal_sigma=focal_sigma)
    errors, z = [], []
    for k, prepared in enumerate(frames):
        away = np.degrees(angles_between(prepared.frame.pose, fit.found[k]))
        slopes = angle_slopes(fit.found[k])
        sigma = np.degrees(np.sqrt(np.diag(slopes @ fit.pose_covariance(k)[3:, 3:] @ slopes.T)))
        errors.append(tuple(map(float, away)))
        z.append(tuple(map(float, away / sigma)))
    return MountTrial(head, fit.word, tuple(errors), tuple(z), focal_factor * fit.focal)
