"""Find where the search for a mount begins, and decide whether a correction that several photos share is accepted.

A state (8,) is a shift (m), a rotation about the map's axes (rad), the zero of the tilt axis (rad) and the logarithm of
the focal length."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

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
    apart = _alone_apart(pictures, found, config.mount_sharp_deg)
    if turns_deg.max() > config.most_sigma_deg or turns_deg[2] > config.mount_azimuth_sigma_deg:
        return "ambiguous", f"the images determine the mount only to {turns_deg.max():.2f} deg"
    if gap < _gap_asked(pictures, seen, config):
        return "ambiguous", f"another azimuth of the mount costs {gap:.1f} more only"
    if seen.support < config.least_support:
        return "ambiguous", f"only {seen.support:.0%} of the images' skylines fits the terrain's"
    if max(apart, default=0.0) > config.mount_apart_deg:
        return "ambiguous", f"an image accepted by itself is {max(apart):.1f} deg from the mount's pose"
    if seen.open > config.open_share and not _told_alone(pictures, found, config):
        return ("ambiguous", "land beyond the DEM may resemble its horizon, and no two images alone agree on the mount")
    if away > config.contradiction:
        return "contradicts_prior", f"the mount is {away:.1f} sigmas from its stated pose"
    return "accepted", f"{len(pictures)} images agree"


def _told_alone(pictures: Sequence[MountPicture], found: Sequence[Pose], config: VerdictConfig) -> bool:
    """Return whether two images or more are accepted by themselves, and all of these lie where the mount puts them."""
    apart = _alone_apart(pictures, found)
    return len(apart) > 1 and max(apart) <= config.mount_apart_deg


def _alone_apart(
    pictures: Sequence[MountPicture], found: Sequence[Pose], most_sigma_deg: float = math.inf
) -> list[float]:
    """Return the degrees of azimuth or pitch between where images are found by themselves and where the mount puts
    them, of those that are accepted and so sure."""
    return [
        float(np.degrees(np.abs(angles_between(pose, p.search.hypotheses[0].refined.pose)[:2]).max()))
        for p, pose in zip(pictures, found, strict=True)
        if p.search.verdict.word == "accepted" and max(p.search.verdict.sigma_deg) <= most_sigma_deg
    ]


def _gap_asked(pictures: Sequence[MountPicture], seen: SkylineFit, config: VerdictConfig) -> float:
    """Return the minimum gap of a mount as of an image (`pose_verdict.judge`): more if only ridges are used."""
    evidences = [p.search.evidence for p in pictures]
    if any(evidence.skyline is not None for evidence in evidences):
        return config.gap_asked(seen.veiled, seen.variance)
    plants = float(np.median([evidence.plants for evidence in evidences]))
    return config.plants_gap if plants >= MANY_PLANTS else config.ridges_gap


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
    order = sorted(itertools.product(either, either), key=lambda signs: signs != (start.pan_sign, start.tilt_sign))
    for pan_sign, tilt_sign in order:
        turns = np.array([ptz_rotation(*ptz_angles(p, t, pan_sign, tilt_sign)) for p, t, _ in points.readings])
        best = _best_rotation(np.einsum("nij,nj->ni", turns, rays), sights, start)
        if best is not None:
            base = Pose(start.base.position, best)
            found[pan_sign, tilt_sign] = replace(
                start, base=base, tilt_zero=0.0, pan_sign=pan_sign, tilt_sign=tilt_sign
            )
    return found


def _best_rotation(in_ptz: Float64Array, sights: Float64Array, start: MountModel) -> Float64Array | None:
    """Return the rotation of the mount with the least median angle: from a pair of landmarks, then from all that fit
    this; None if all lean too far."""
    pairs = list(itertools.combinations(range(len(sights)), 2))
    pairs = [pairs[k] for k in np.linspace(0, len(pairs) - 1, min(len(pairs), _MOST_PAIRS)).astype(int)]
    best: tuple[float, Float64Array] | None = None
    for pair in pairs:
        two = list(pair)
        if np.linalg.norm(np.cross(sights[two[0]], sights[two[1]])) < 0.01:
            continue
        rotation = _aligned(in_ptz[two], sights[two])
        off = _angles_off(rotation, in_ptz, sights)
        near = off <= max(2 * float(np.median(off)), math.radians(0.5))
        if near.sum() >= _REACHED:
            rotation = _aligned(in_ptz[near], sights[near])
        median = float(np.median(_angles_off(rotation, in_ptz, sights)))
        if _lean_between(rotation, start.base.rotation) <= STEEPEST_LEAN and (best is None or median < best[0]):
            best = median, rotation
    return None if best is None else best[1]


def _aligned(in_ptz: Float64Array, sights: Float64Array) -> Float64Array:
    """Return the rotation that turns directions (N, 3) onto others with the least squares."""
    u, _, vt = np.linalg.svd(sights.T @ in_ptz)
    turn = np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)])
    return np.asarray(u @ turn @ vt, np.float64)


def _angles_off(rotation: Float64Array, in_ptz: Float64Array, sights: Float64Array) -> Float64Array:
    cosine = np.einsum("ni,ni->n", in_ptz @ rotation.T, sights)
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)), np.float64)


def _lean_between(a: Float64Array, b: Float64Array) -> float:
    """Between the upright axes of two mounts, rad."""
    return math.acos(float(np.clip(a[:, 1] @ b[:, 1], -1, 1)))
