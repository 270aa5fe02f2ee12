"""Trials of unknown lenses: a surveyed webcam with its datasheet's lens, and rendered images that a lens bends."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.lens import LensPrior
from ltm_core.pose_estimation.points.control_points import ControlPoints
from ltm_core.pose_estimation.points.resection import Resection, resect
from ltm_core.pose_estimation.points.resection_adjustment import applied, size_of
from ltm_core.pose_estimation.points.resection_io import read_control_points
from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, SearchTerrain, find_pose, find_pose_and_lens
from ltm_core.pose_estimation.skyline.picture_pose_config import CANOPY_SURFACE
from ltm_core.pose_estimation.skyline.pose_prior import UNKNOWN_DEG, PosePrior, angles_between
from ltm_core.raster.dem import Dem
from ltm_core.tracing.trace_io import load_picture_config, read_photo
from ltm_core.visibility.footprint import line_of_sight_vectors
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.depth.fused_depth import upsampled_labels
from ltm_lab.evaluation.pose.pose_trial import Angles, Sensor, disturbed, sigmas_deg, three
from ltm_lab.evaluation.pose.rendered_terrain_io import RenderedSite

STARTS = 12
_OFF_DEG = 10.0, 3.0, 1.0
"""Errors of the starts' azimuth, pitch and roll."""
_FOLDS = 6
_INSIDE_95 = 5.991
"""Squared Mahalanobis distance of two coordinates within which 95 % lie."""


@dataclass(frozen=True)
class LensTrial:
    """One search. `case`: what it started from; `error`, `sigma`: of azimuth, pitch and roll, degrees; `k1`: the found
    one; `names_lens`: whether the reason names the lens."""

    case: str
    verdict: str
    error: Angles
    sigma: Angles
    k1: float
    names_lens: bool


@dataclass(frozen=True)
class HeldOutScore:
    """Points that were left out of the fit. `inside`: share inside their 95 % ellipses; `inside_used`: the same of
    the `used` points that the fit of all points does not reject; `rmse`, `median`: pixels."""

    fit: str
    points: int
    inside: float
    used: int
    inside_used: float
    rmse: float
    median: float
    median_fitted: float


def _trial(case: str, true: Pose, search: PictureSearch, k1: float) -> LensTrial:
    if not search.hypotheses:
        nothing = (math.inf, math.inf, math.inf)
        return LensTrial(case, search.verdict.word, nothing, nothing, k1, False)
    found = search.hypotheses[0].refined
    error = three(np.degrees(angles_between(true, found.pose)))
    sigma = three(sigmas_deg(found.pose, found.covariance))
    return LensTrial(case, search.verdict.word, error, sigma, k1, "lens" in search.verdict.reason)


def run_finse(folder: Path, kind: str, starts: int) -> list[LensTrial]:
    """Search the webcam's pose with its datasheet's focal length and no distortion, from `starts` poses that are 10, 3
    and 1 degrees off, and without azimuth. The truth is the pose of all its surveyed points."""
    known = load_picture_config(folder / "f3.yaml")
    frame = SiteFrame("EPSG:32632", 419_000.0, 6_718_000.0)
    dem = Dem.open(folder / "dsm_4m_no_crs.tif", crs=frame.crs).in_frame(frame)
    true, fitted = known.pose.pose(dem, frame), known.calibration.camera()
    stated = replace(fitted, fx=1484.0, fy=1484.0, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    photo = read_photo(folder / "2019-05-24.jpg", stated)
    labels = Segmenter.open().segment(photo).labels
    terrain = SearchTerrain(dem, ray_bend(True, 0.13), cover=CANOPY_SURFACE)
    evidence_of = _evidence_of(photo, labels)
    trials = []
    for k in range(starts + 1):
        off = np.multiply(_OFF_DEG, (1 if k % 2 else -1, 1 if k // 2 % 2 else -1, k // 4 % 3 - 1))
        start = Pose.from_angles(true.position, *three(np.add(true.angles_deg, off)))
        prior = PosePrior(start, UNKNOWN_DEG if k == starts else _OFF_DEG[0], *_OFF_DEG[1:])
        search, lens = find_pose_and_lens(evidence_of, stated, terrain, prior, LensPrior.of(kind, stated))
        case = "Finse, no azimuth" if k == starts else "Finse, {:+.0f} {:+.0f} {:+.0f} deg".format(*off)
        trials.append(_trial(case, true, search, lens.distortion[0]))
    return trials


def _evidence_of(photo: UInt8Array, labels: UInt8Array) -> Callable[[Camera], PictureEvidence]:
    @lru_cache(maxsize=64)
    def evidence(camera: Camera) -> PictureEvidence:
        return picture_evidence(photo, labels, camera)

    return evidence


def bent(values: UInt8Array, camera: Camera, k1: float, interpolation: int) -> UInt8Array:
    """Return an image of an undistorted camera as a lens with this k1 would show it."""
    lens = replace(camera, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
    at = camera.project(lens.rays()).astype(np.float32)
    at[~np.isfinite(at)] = -1
    return np.asarray(
        cv2.remap(values, at[..., 0], at[..., 1], interpolation, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def run_rendered(folder: Path, k1: float, every: int, seed: int) -> list[LensTrial]:
    """Search the poses of rendered images as they are and bent by k1, with the lens as stated (none) and free."""
    site = RenderedSite(folder, "", False, False, every)
    terrain = site.terrain()
    trials = []
    for prepared in site.frames(terrain):
        frame, camera = prepared.frame, prepared.frame.camera
        labels = upsampled_labels(frame.labels, (camera.height, camera.width))
        prior = disturbed(frame.pose, Sensor.mount, terrain.dem, np.random.default_rng([seed, prepared.number]))
        for name, value in (("no distortion", 0.0), (f"k1 {k1:+.2f}", k1)):
            photo = bent(frame.photo, camera, value, cv2.INTER_LINEAR)
            evidence_of = _evidence_of(photo, bent(labels, camera, value, cv2.INTER_NEAREST))
            stated = find_pose(evidence_of(camera), terrain, prior)
            trials.append(_trial(f"{name}, lens stated", frame.pose, stated, 0.0))
            prior_of_lens = LensPrior.of("any", camera)
            search, lens = find_pose_and_lens(evidence_of, camera, terrain, prior, prior_of_lens)
            trials.append(_trial(f"{name}, lens free", frame.pose, search, lens.distortion[0]))
    return trials


def score_held_out(folder: Path, kind: str) -> list[HeldOutScore]:
    """Fit each fold's other points, with k1 only and with the whole lens, and score the points of the fold."""
    frame = SiteFrame("EPSG:32632", 419_000.0, 6_718_000.0)
    marked = read_control_points(folder / "gcps_dev.csv", frame)
    stated = Camera(1920, 1080, 1484.0, 1484.0, 959.5, 539.5)
    position, bend = np.array([169.2, 421.3, 1212.0]), ray_bend(True, 0.13)
    scores = []
    folds = np.arange(len(marked.names)) % _FOLDS
    away, inside = np.zeros(len(folds)), np.zeros(len(folds), np.bool_)
    for name, lens in (("focal, k1", None), (f"lens:{kind}", LensPrior.of(kind, stated))):
        fits = [
            resect(_some(marked, ~left), stated, position, None, ("focal", "k1", "position"), bend, 3.0, lens=lens)
            for left in (folds == fold for fold in range(_FOLDS + 1))  # the last leaves nothing out
        ]
        used, own = fits.pop().used, []
        for fold, fit in enumerate(fits):
            left = folds == fold
            error, square = _predicted(fit, _some(marked, left), bend)
            away[left], inside[left] = np.hypot(*error.T), square < _INSIDE_95
            own += list(fit.residual_px[fit.used])
        rmse, typical = float(np.sqrt(np.mean(away**2))), float(np.median(away))
        agreed = int(used.sum()), float(inside[used].mean())
        scores.append(
            HeldOutScore(name, len(away), float(inside.mean()), *agreed, rmse, typical, float(np.median(own)))
        )
    return scores


def _some(points: ControlPoints, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> ControlPoints:
    names = tuple(np.array(points.names)[kept].tolist())
    return ControlPoints(names, points.places[kept], points.pixels[kept])


def _predicted(fit: Resection, points: ControlPoints, bend: float) -> tuple[Float64Array, Float64Array]:
    """Return the errors (N, 2) of points that were not fitted, pixels, and their squares by the fit's covariance and
    the standard deviation of a mark (N,)."""

    def projected(change: Float64Array) -> Float64Array:
        camera, pose = applied(change, fit.camera, fit.pose, fit.fitted)
        return camera.project(line_of_sight_vectors(pose.position, points.places, bend) @ pose.rotation)

    size, step = 3 + size_of(fit.fitted), 1e-5
    middle = projected(np.zeros(size))
    slopes = np.stack([(projected(step * axis) - middle) / step for axis in np.eye(size)], axis=-1)
    covariance = slopes @ fit.covariance @ np.swapaxes(slopes, 1, 2) + fit.sigma_px**2 * np.eye(2)
    error = points.pixels - middle
    return error, np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
