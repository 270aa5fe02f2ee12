"""Fit one correction to several images of one mount: presets of a PTZ head, or days of a fixed camera.

An image's pose is exp(w) R exp(t x): R as the mount states it, w a rotation about the map's axes that all share (the
mount's yaw, pitch and roll), t the zero of the tilt axis, about each camera's own right; and all share a place and,
where it is free, a factor of the focal length. Single images propose corrections; that which explains all images
best is refined over all of them at once.

A state (8,) is a shift (m), a rotation about the map's axes (rad), the zero of the tilt axis (rad) and the logarithm of
the focal length."""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, matrix_of_vector, nearest_vector, pose_covariance, vector_of_matrix
from ltm_core.pose_estimation.skyline.contour_scores import ContourDirections, ridge_gain, ridge_strength
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch
from ltm_core.pose_estimation.skyline.picture_pose_config import MOUNT_FLOOR_DEG, Criteria
from ltm_core.pose_estimation.skyline.pose_hypothesis import MANY_PLANTS, Word, mean_about_best
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between, turned
from ltm_core.pose_estimation.skyline.pose_refinement import (
    MOST_FOCAL_STEP,
    ROUNDS,
    SkylineFit,
    picture_system,
    skyline_fit,
)

TILT_ZERO_SIGMA_DEG = 0.3
_SURE = 3.0  # number of sigmas by which a tilt zero must be significant
_PROPOSALS = 3  # number of hypotheses of each image that are tested on all images
_STARTS, _APART, _FOCAL_APART = 6, math.radians(0.25), 0.01
"""Number of corrections that are refined, and their minimum distance in azimuth and in the logarithm of the focal
length. Far ridges are periodic, with one local optimum per peak."""


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

    def problem(self) -> PoseProblem:
        return PoseProblem(self.search.evidence, self.search.horizon, self.prior)

    def camera(self, state: Float64Array) -> Camera:
        """Return the camera with a correction (8,)."""
        return self.search.evidence.camera.zoomed(math.exp(float(state[7])))


def skylines_at(pictures: list[MountPicture], state: Float64Array) -> SkylineFit:
    """Return the median fit of the skylines of images to the terrain's; without any skyline, all fit."""
    fits = [
        skyline_fit(p.pose(state), p.camera(state), p.problem())
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
    off = max((apart for apart, v in alone if max(v.sigma_deg) <= Criteria.mount_sharp_deg), default=0.0)
    agree = len(alone) > 1 and max(apart for apart, _ in alone) <= Criteria.mount_apart_deg
    if any(p.search.evidence.skyline is not None for p in pictures):
        least = Criteria.gap_asked(seen.veiled, seen.variance)
    else:  # more if only ridges are used, as for an image
        planted = float(np.median([p.search.evidence.plants for p in pictures])) >= MANY_PLANTS
        least = Criteria.plants_gap if planted else Criteria.ridges_gap
    if turns_deg.max() > Criteria.most_sigma_deg or turns_deg[2] > Criteria.mount_azimuth_sigma_deg:
        return "ambiguous", f"the images determine the mount only to {turns_deg.max():.2f} deg"
    if gap < least:
        return "ambiguous", f"another azimuth of the mount costs {gap:.1f} more only"
    if seen.support < Criteria.least_support:
        return "ambiguous", f"only {seen.support:.0%} of the images' skylines fits the terrain's"
    if off > Criteria.mount_apart_deg:
        return "ambiguous", f"an image accepted by itself is {off:.1f} deg from the mount's pose"
    if seen.open > Criteria.open_share and not agree:
        return "ambiguous", "land beyond the DEM may resemble its horizon, and no two images alone agree on the mount"
    if away > Criteria.contradiction:
        return "contradicts_prior", f"the mount is {away:.1f} sigmas from its stated pose"
    return "accepted", f"{len(pictures)} images agree"


@dataclass(frozen=True, eq=False)
class MountFit:
    """`rotation`: (3,) about the map's axes (rad), `tilt_zero` (rad), `shift` (3,) m: what is to be added to the stated
    poses; `covariance`: (7, 7) of shift, rotation, tilt zero. `poses`: of the images, with it, where it is accepted,
    else as stated. `gap`: by which the next best correction costs more. `cost`: by the images and by what is stated.
    `focal`: factor of the focal length, `focal_sigma` of its logarithm; 1 and 0 where it is held."""

    rotation: Float64Array
    tilt_zero: float
    shift: Float64Array
    covariance: Float64Array
    poses: tuple[Pose, ...]
    found: tuple[Pose, ...]
    word: Word
    reason: str
    gap: float
    cost: float
    focal: float = 1.0
    focal_sigma: float = 0.0

    def pose_covariance(self, picture: int) -> Float64Array:
        """Return the covariance (6, 6) of an image's pose, as in `pose_covariance`."""
        to_pose = np.zeros((6, 7))
        to_pose[:, :6] = np.eye(6)
        to_pose[3:, 6] = self.found[picture].rotation[:, 0]
        return np.asarray(to_pose @ self.covariance @ to_pose.T, np.float64)


def fit_mount(
    priors: Sequence[PosePrior],
    searches: Sequence[PictureSearch],
    tilt_zero_sigma_deg: float = TILT_ZERO_SIGMA_DEG,
    focal_sigma: float = 0.0,
) -> MountFit:
    """Fit one correction to the images of `searches`, each searched from its own of `priors`.

    The sigmas of the first prior are those of the mount; of its azimuth about the vertical, of pitch and roll about the
    level axes. `tilt_zero_sigma_deg`: 0 for a camera that does not tilt. `focal_sigma`: of the focal length, relative,
    which was free in the searches, too; 0 holds it. Raises PoseError without images."""
    if not priors or len(priors) != len(searches):
        raise PoseError(f"{len(priors)} stated poses for {len(searches)} images; give one for each")
    pictures = [
        MountPicture(prior, search, ContourDirections.of(search.horizon))
        for prior, search in zip(priors, searches, strict=True)
    ]
    level = max(priors[0].pitch_sigma_deg, priors[0].roll_sigma_deg)
    turns = np.radians([level, level, priors[0].azimuth_sigma_deg, tilt_zero_sigma_deg])
    sigma = np.concatenate([priors[0].sigmas[:3], turns, [focal_sigma]])
    starts = _proposals(pictures)
    if not starts:
        poses, none = tuple(p.prior.pose for p in pictures), np.zeros(3)
        reason = "no image shows a skyline or a ridge of the DEM"
        return MountFit(none, 0.0, none, np.diag(sigma[:7] ** 2), poses, poses, "no_skyline", reason, 0.0, math.inf)
    starts.sort(key=lambda state: _cost(pictures, state, sigma))
    refined = [_refined(pictures, start, sigma) for start in _apart(starts)]
    fits = sorted(((_cost(pictures, state, sigma), state, c) for state, c in refined), key=lambda fit: fit[0])
    least, best, covariance = fits[0]
    for _, state, _ in fits[1:]:
        # Turns of half a circle to the right and to the left are one, and so is their mean.
        state[3:6] = nearest_vector(state[3:6], best[3:6])
    others = (
        cost - least for cost, state, _ in fits if abs(state[5] - best[5]) > math.radians(Criteria.alternative_deg)
    )
    gap, states = next(others, math.inf), np.array([state for _, state, _ in fits])
    variance = skylines_at(pictures, best).variance
    mean, spread = mean_about_best([cost for cost, *_ in fits], states[:, 5], states, variance)
    covariance = covariance + spread
    found = tuple(p.pose(mean) for p in pictures)
    away = float((np.abs(_deviation(mean)[3:]) / np.where(sigma[3:] > 0, sigma[3:], np.inf)).max())
    turns = np.degrees(np.sqrt(np.diag(covariance)[3:6]))
    word, reason = judge_mount(pictures, found, skylines_at(pictures, mean), turns, gap, away)
    poses = found if word == "accepted" else tuple(p.prior.pose for p in pictures)
    cost, focal_off = _cost(pictures, mean, sigma), math.sqrt(covariance[7, 7])
    told = covariance[:7, :7], poses, found, word, reason, gap, cost, math.exp(mean[7]), focal_off
    return MountFit(mean[3:6], float(mean[6]), mean[:3], *told)


def fit_ptz_mount(
    priors: Sequence[PosePrior], searches: Sequence[PictureSearch], tilt_zero_sigma_deg: float
) -> MountFit:
    """Fit a PTZ mount, with the zero of its tilt axis if it lowers the cost by what three sigmas do and is itself
    significant by three sigmas; no image's direction is then more certain than without it."""
    plain = fit_mount(priors, searches, tilt_zero_sigma_deg=0.0)
    if tilt_zero_sigma_deg == 0:
        return plain
    ptz = fit_mount(priors, searches, tilt_zero_sigma_deg)
    # A floor of pitch is in the mount's rotation, once for each image's pose; the zero by itself has it, too.
    sigma = math.hypot(math.sqrt(ptz.covariance[6, 6]), math.radians(MOUNT_FLOOR_DEG[1]))
    if ptz.word != "accepted" or abs(ptz.tilt_zero) < _SURE * sigma or plain.cost - ptz.cost < _SURE**2 / 2:
        return plain
    pairs = [(plain.pose_covariance(k)[3:, 3:], ptz.pose_covariance(k)[3:, 3:]) for k in range(len(priors))]
    wider = max(1.0, *(float(np.trace(a) / np.trace(b)) for a, b in pairs))
    reason = f"{ptz.reason}, with a tilt zero off by {math.degrees(ptz.tilt_zero):+.2f}deg"
    return replace(ptz, covariance=ptz.covariance * wider, reason=reason)


def _proposals(pictures: list[MountPicture]) -> list[Float64Array]:
    """States (8,), as in `_cost`."""
    found = [np.zeros(8)]
    for picture in pictures:
        for hypothesis in picture.search.hypotheses[:_PROPOSALS]:
            refined = hypothesis.refined
            turn = vector_of_matrix(refined.pose.rotation @ picture.prior.pose.rotation.T)
            focal = math.log(refined.camera.fx / picture.search.evidence.camera.fx)
            found.append(np.array([0.0, 0.0, 0.0, *turn, 0.0, focal]))
    return found if len(found) > 1 else []


def _apart(states: list[Float64Array]) -> list[Float64Array]:
    """Return, of corrections from the best down, the first few that differ in azimuth or focal length."""
    kept: list[Float64Array] = []
    for state in states:
        turns = (abs(nearest_vector(state[3:6], other[3:6])[2] - other[5]) for other in kept)
        zooms = (abs(state[7] - other[7]) for other in kept)
        alike = (turn <= _APART and zoom <= _FOCAL_APART for turn, zoom in zip(turns, zooms, strict=True))
        if len(kept) < _STARTS and not any(alike):
            kept.append(state)
    return kept


def _deviation(state: Float64Array) -> Float64Array:
    """Return (8,) of a state from what is stated: of the rotation, its tips of the vertical about x and y, its turn."""
    tipped = matrix_of_vector(state[3:6])[:, 2]
    return np.array([*state[:3], -tipped[1], tipped[0], *state[5:]])


def _cost(pictures: list[MountPicture], state: Float64Array, sigma: Float64Array) -> float:
    """Return the cost of a state (8,): shift, rotation, tilt zero, logarithm of the focal length."""
    away = _deviation(state) / np.where(sigma > 0, sigma, np.inf)
    total = 0.5 * float(away @ away)
    for p in pictures:
        pose, camera = p.pose(state), p.camera(state)
        cost = skyline_fit(pose, camera, p.problem()).cost
        z = ridge_strength(pose, p.ridges, p.search.horizon.step, camera, p.search.evidence.edges)
        total += (cost - float(ridge_gain(z))) / alike(p, pictures)
    return total


def _refined(
    pictures: list[MountPicture], start: Float64Array, sigma: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return the state (8,) as in `_cost` and its covariance."""
    free = np.flatnonzero(sigma > 0)
    state = np.where(sigma > 0, start, 0.0)
    state[3:6] = start[3:6]
    covariance = np.zeros((8, 8))
    for k, (search, wide) in enumerate((*ROUNDS, ROUNDS[-1])):
        last = k == len(ROUNDS)
        normal, gradient = np.zeros((8, 8)), np.zeros(8)
        for p in pictures:
            pose, camera = p.pose(state), p.camera(state)
            around = p.ridges.in_view(pose, camera)
            n, g = picture_system(pose, camera, p.problem(), around, search, wide, expected=last)
            shared = np.zeros((7, 8))
            shared[:6, :6] = np.eye(6)
            shared[3:6, 6] = pose.rotation[:, 0]
            shared[6, 7] = 1.0
            alone = 1.0 / alike(p, pictures)
            normal += alone * (shared.T @ n @ shared)
            gradient += alone * (shared.T @ g)
        inverse = np.where(sigma > 0, 1 / np.maximum(sigma, 1e-12) ** 2, 0.0)
        normal += np.diag(inverse)
        gradient += inverse * _deviation(state)
        if last:
            covariance[np.ix_(free, free)] = np.linalg.inv(normal[np.ix_(free, free)])
            # Of pitch, what a lens is off by where the skyline lies in the image: that of every direction is another,
            # and their mean is surer.
            azimuth, pitch, roll = MOUNT_FLOOR_DEG
            pitch /= math.sqrt(sum(1.0 / alike(p, pictures) for p in pictures))
            covariance[3:6, 3:6] += pose_covariance(pictures[0].prior.pose, 0.0, 0.0, azimuth, pitch, roll)[3:, 3:]
        else:
            step = np.zeros(8)
            step[free] = np.linalg.solve(normal[np.ix_(free, free)], gradient[free])
            step[7] = min(max(step[7], -MOST_FOCAL_STEP), MOST_FOCAL_STEP)
            turn = matrix_of_vector(-step[3:6]) @ matrix_of_vector(state[3:6])
            state -= step
            # A turn about the map's axes comes after what the state has turned: of large ones no sum would do.
            state[3:6] = vector_of_matrix(turn)
    return state, covariance


def widened(prior: PosePrior, extra_deg: float) -> PosePrior:
    """Return the prior for a single image of a mount whose tilt zero, too, is unknown."""
    return replace(prior, pitch_sigma_deg=math.hypot(prior.pitch_sigma_deg, extra_deg))
