"""Find where the search for a mount begins, and decide whether a correction that several photos share is accepted.

A state (8,) is a shift (m), a rotation about the map's axes (rad), the zero of the tilt axis (rad) and the logarithm of
the focal length."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, matrix_of_vector
from ltm_core.geometry.zoom_lens import ZoomLens
from ltm_core.pose_estimation.mount.mount_model import MountModel, Sign, ptz_angles, ptz_rotation
from ltm_core.pose_estimation.points.control_points import PtzPoints
from ltm_core.pose_estimation.skyline.contour_scores import ContourDirections
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig, VerdictConfig
from ltm_core.pose_estimation.skyline.pose_hypothesis import MANY_PLANTS, Word
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between, turned
from ltm_core.pose_estimation.skyline.pose_refinement import SkylineFit, skyline_fit
from ltm_core.visibility.footprint import line_of_sight_vectors, pixel_rays


@dataclass(frozen=True, eq=False)
class MountPicture:
    """Image as stated (`prior`), its own result, and the ridges around."""

    prior: PosePrior
    search: PictureSearch
    ridges: ContourDirections

    def pose(self, state: Float64Array) -> Pose:
        """Return the pose with a correction (8,)."""
        stated, up = self.prior.pose, matrix_of_vector([state[6], 0.0, 0.0])
        return turned(Pose(stated.position, stated.rotation @ up), state[3:6], state[:3])

    def problem(self, config: PicturePoseConfig) -> PoseProblem:
        return PoseProblem(self.search.evidence, self.search.horizon, self.prior, config)

    def camera(self, state: Float64Array) -> Camera:
        """Return the camera with a correction (8,)."""
        return self.search.evidence.camera.zoomed(math.exp(float(state[7])))


def skylines_at(pictures: list[MountPicture], state: Float64Array, config: PicturePoseConfig) -> SkylineFit:
    """Return the median fit of the skylines of images to the terrain's; without any skyline, all fit."""
    fits = [
        skyline_fit(p.pose(state), p.camera(state), p.problem(config))
        for p in pictures
        if p.search.evidence.skyline is not None
    ]
    return SkylineFit(*np.median([astuple(fit) for fit in fits], axis=0)) if fits else SkylineFit(support=1.0)


def alike(picture: MountPicture, pictures: list[MountPicture]) -> float:
    """Return the number of images with this viewing direction: they share the DEM's errors and count as one."""
    width = picture.search.evidence.camera.hfov_deg
    azimuth = picture.prior.pose.angles_deg[0]
    away = [abs((p.prior.pose.angles_deg[0] - azimuth + 180.0) % 360.0 - 180.0) for p in pictures]
    return float(sum(max(0.0, 1.0 - a / width) for a in away))


def judge_mount(
    pictures: Sequence[MountPicture],
    found: Sequence[Pose],
    seen: SkylineFit,
    turns_deg: Float64Array,
    gap: float,
    away: float,
    config: VerdictConfig,
) -> tuple[Word, str]:
    """Return the verdict and its reason. `found`: poses of the images with the correction. `seen`: fit of their
    skylines to the terrain's. `turns_deg` (3,): sigmas of its rotation about the map's axes. `gap`: additional cost of
    the next best correction. `away`: maximum deviation of any angle from the stated one, in stated sigmas."""
    # Degrees between where images are found by themselves and where the mount puts them, and how sure they are.
    alone = [
        (float(np.degrees(np.abs(angles_between(pose, p.search.hypotheses[0].refined.pose)[:2]).max())), verdict)
        for p, pose in zip(pictures, found, strict=True)
        if (verdict := p.search.verdict).word == "accepted"
    ]
    off = max((apart for apart, v in alone if max(v.sigma_deg) <= config.mount_sharp_deg), default=0.0)
    agree = len(alone) > 1 and max(apart for apart, _ in alone) <= config.mount_apart_deg
    if any(p.search.evidence.skyline is not None for p in pictures):
        least = config.gap_asked(seen.veiled, seen.variance)
    else:  # more if only ridges are used, as for an image
        planted = float(np.median([p.search.evidence.plants for p in pictures])) >= MANY_PLANTS
        least = config.plants_gap if planted else config.ridges_gap
    if turns_deg.max() > config.most_sigma_deg or turns_deg[2] > config.mount_azimuth_sigma_deg:
        return "ambiguous", f"the images determine the mount only to {turns_deg.max():.2f} deg"
    if gap < least:
        return "ambiguous", f"another azimuth of the mount costs {gap:.1f} more only"
    if seen.support < config.least_support:
        return "ambiguous", f"only {seen.support:.0%} of the images' skylines fits the terrain's"
    if off > config.mount_apart_deg:
        return "ambiguous", f"an image accepted by itself is {off:.1f} deg from the mount's pose"
    if seen.open > config.open_share and not agree:
        return "ambiguous", "land beyond the DEM may resemble its horizon, and no two images alone agree on the mount"
    if away > config.contradiction:
        return "contradicts_prior", f"the mount is {away:.1f} sigmas from its stated pose"
    return "accepted", f"{len(pictures)} images agree"


STEEPEST_LEAN = math.radians(20.0)  # maximum lean of a mount from its stated orientation
_REACHED = 3  # number of landmarks that must fit the mount of a pair before it is fitted to all of them
_MOST_PAIRS = 200


def closed_forms(
    points: PtzPoints, start: MountModel, lens: ZoomLens, bend: float
) -> dict[tuple[Sign, Sign], MountModel]:
    """Return, for each sign of pan and tilt (the stated ones first), the mount that most landmarks agree on, without a
    tilt zero."""
    sights = line_of_sight_vectors(start.base.position, points.places, bend)
    sights /= np.linalg.norm(sights, axis=1, keepdims=True)
    cameras = [lens.camera(zoom) for zoom in points.readings[:, 2]]
    rays = np.array([pixel_rays(c, p[None])[0] for c, p in zip(cameras, points.pixels, strict=True)])
    either: tuple[Sign, Sign] = (1, -1)
    found = {}
    for pan, tilt in sorted(itertools.product(either, either), key=lambda s: s != (start.pan_sign, start.tilt_sign)):
        turns = np.array([ptz_rotation(*ptz_angles(p, t, pan, tilt)) for p, t, _ in points.readings])
        best = _best_rotation(np.einsum("nij,nj->ni", turns, rays), sights, start)
        if best is not None:
            base = Pose(start.base.position, best)
            found[pan, tilt] = replace(start, base=base, tilt_zero=0.0, pan_sign=pan, tilt_sign=tilt)
    return found


def _best_rotation(in_ptz: Float64Array, sights: Float64Array, start: MountModel) -> Float64Array | None:
    """Return the rotation of the mount with the least median angle: from a pair of landmarks, then from all that fit
    this; None if all lean too far."""

    def off(rotation: Float64Array) -> Float64Array:
        cosine = np.einsum("ni,ni->n", in_ptz @ rotation.T, sights)
        return np.asarray(np.arccos(np.clip(cosine, -1, 1)), np.float64)

    pairs = np.array(list(itertools.combinations(range(len(sights)), 2)))
    best: tuple[float, Float64Array] | None = None
    for two in pairs[np.linspace(0, len(pairs) - 1, min(len(pairs), _MOST_PAIRS)).astype(int)]:
        if np.linalg.norm(np.cross(sights[two[0]], sights[two[1]])) < 0.01:
            continue
        rotation = Rotation.align_vectors(sights[two], in_ptz[two])[0].as_matrix()
        near = off(rotation) <= max(2 * float(np.median(off(rotation))), math.radians(0.5))
        if near.sum() >= _REACHED:
            rotation = Rotation.align_vectors(sights[near], in_ptz[near])[0].as_matrix()
        median = float(np.median(off(rotation)))
        lean = math.acos(float(np.clip(rotation[:, 1] @ start.base.rotation[:, 1], -1, 1)))
        if lean <= STEEPEST_LEAN and (best is None or median < best[0]):
            best = median, rotation
    return None if best is None else best[1]
