"""Set up the search of an image's pose from a guess file, and write the result."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import ImageError, PoseError
from ltm_core.base.types import BoolArray, Float64Array, UInt8Array
from ltm_core.cameras.plausibility import doubt_of_height
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.geometry.pose import Pose, pose_sigmas, sigma_keys
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, SearchTerrain
from ltm_core.pose_estimation.skyline.picture_pose_config import CrestCover
from ltm_core.pose_estimation.skyline.pose_prior import UNKNOWN_DEG, PosePrior
from ltm_core.raster.dem import Dem
from ltm_core.storage.image_io import read_values
from ltm_core.tracing.trace_io import GuessConfig, near_frame, write_pose_file
from ltm_core.vision.labels import Label

AZIMUTH_SIGMA_DEG, TILT_SIGMA_DEG = 6.0, 2.0  # stated without a sigma: a phone's compass, a level held by hand
UNSTATED_TILT_SIGMA_DEG = 5.0  # standard deviation in degrees of a pitch or roll that is not stated


@dataclass(frozen=True, eq=False)
class SearchSetup:
    """Initial guess on a DEM, ready for `find_pose`."""

    frame: SiteFrame
    camera: Camera
    prior: PosePrior
    terrain: SearchTerrain


@dataclass(frozen=True, eq=False)
class PoseResult:
    """Result of a search: the pose with its covariance (6, 6), as in `pose_covariance`, and the camera. They are the
    estimated ones if the verdict is `accepted`, and the given ones otherwise."""

    pose: Pose
    camera: Camera
    covariance: Float64Array
    accepted: bool


def set_up_search(guess: GuessConfig, dem: Dem, cover: CrestCover) -> SearchSetup:
    """Place a guess on `dem`. `cover`: of crests over it. Raises PoseError for a camera under the ground or outside the
    DEM, and ConfigError."""
    frame, local = near_frame(guess, dem)
    stated = guess.pose
    position = stated.position(local, frame)
    ground = float(local.elevation_at(*position[:2]))
    if position[2] <= ground:
        raise PoseError(f"camera at {stated.described(frame)}: {doubt_of_height(position[2], ground)}")
    azimuth = stated.grid_azimuth_deg(frame, position, None)
    pose = Pose.from_angles(position, azimuth or 0.0, stated.pitch_deg or 0.0, stated.roll_deg or 0.0)

    def tilt(value: float | None, sigma: float | None) -> float:
        return sigma or (UNSTATED_TILT_SIGMA_DEG if value is None else TILT_SIGMA_DEG)

    prior = PosePrior(
        pose,
        UNKNOWN_DEG if azimuth is None else (stated.azimuth_sigma_deg or AZIMUTH_SIGMA_DEG),
        tilt(stated.pitch_deg, stated.pitch_sigma_deg),
        tilt(stated.roll_deg, stated.roll_sigma_deg),
        stated.position_sigma or 0.0,
        stated.height_sigma or stated.position_sigma or 0.0,
    )
    bend = ray_bend(guess.curvature, guess.refraction)
    terrain = SearchTerrain(local, bend, guess.possible_ground, cover)
    return SearchSetup(frame, guess.calibration.camera(), prior, terrain)


def read_labels(path: Path | str, camera: Camera) -> UInt8Array:
    """Read class ids (H, W) from a single-channel PNG of the camera's size. Raises ImageError."""
    labels = read_values(Path(path))
    if labels.ndim != 2 or labels.dtype != np.uint8 or labels.shape != (camera.height, camera.width):
        found = f"{labels.shape} {labels.dtype}"
        raise ImageError(f"{path}: expected a PNG of class ids, {camera.width} x {camera.height} pixels, found {found}")
    return labels


def doubt_of_sky(labels: UInt8Array, hidden: BoolArray | None = None) -> str | None:
    """Return a warning if the sky of labels (H, W) is below the land, outside of masked areas (H, W)."""
    seen = np.ones(labels.shape, np.bool_) if hidden is None else ~hidden
    sky = seen & (labels == np.uint8(Label.SKY))
    land = seen & ~sky
    if not 0.05 * seen.sum() < sky.sum() < 0.95 * seen.sum():
        return None
    rows = np.arange(len(sky))
    if rows @ sky.sum(axis=1) / sky.sum() < rows @ land.sum(axis=1) / land.sum():
        return None
    return "the sky is below the land: the photo seems to be upside down; turn it, or correct its orientation tag"


def result_of(search: PictureSearch, prior: PosePrior, camera: Camera) -> PoseResult:
    """Return the result; a pose that is not accepted is replaced by the prior one. `camera`: the photo's."""
    if search.verdict.word != "accepted":
        return PoseResult(prior.pose, camera, prior.covariance, False)
    found = search.hypotheses[0].refined
    lens = camera.zoomed(found.camera.fx / search.evidence.camera.fx)
    return PoseResult(found.pose, lens, found.covariance[:6, :6], True)


def write_result(
    path: Path | str, result: PoseResult, reason: str, word: str, guess: GuessConfig, frame: SiteFrame
) -> None:
    """Write the pose file of a result, with the verdict at the top."""
    notes = [f"Pose from the photo: {word} ({reason})."]
    if not result.accepted:
        notes.append("The result was rejected: this is the given pose.")
    sigmas, rays = sigma_keys(result.pose, result.covariance), (guess.curvature, guess.refraction)
    write_pose_file(path, result.camera, result.pose, sigmas, rays, frame, notes)


def figures(search: PictureSearch, result: PoseResult, prior: PosePrior, frame: SiteFrame) -> dict[str, Any]:
    """Return the JSON-ready results; positions in the frame's CRS."""
    verdict = search.verdict

    def place(pose: Pose) -> list[float]:
        x, y, z = (float(v) for v in pose.position)
        return [x + frame.x_origin, y + frame.y_origin, z]

    def described(pose: Pose, covariance: Float64Array) -> dict[str, Any]:
        sigma = pose_sigmas(pose, covariance)[3:].tolist()
        angles = dict(zip(("azimuth_deg", "pitch_deg", "roll_deg"), pose.angles_deg, strict=True))
        known = {"sigma_deg": [s if math.isfinite(s) else None for s in sigma], "covariance": covariance.tolist()}
        return {"position": place(pose), **angles, **known}

    factor = 1 / search.evidence.camera.fx
    return {
        "verdict": verdict.word,
        "reason": verdict.reason,
        "gap": verdict.gap if math.isfinite(verdict.gap) else None,
        "runner_up_azimuth_deg": verdict.alternative_deg,
        "skyline_that_fits": verdict.support,
        "variance_of_misfits": search.hypotheses[0].refined.skyline.variance if search.hypotheses else None,
        "crs": frame.crs,
        "given": described(prior.pose, prior.covariance),
        "result": described(result.pose, result.covariance),
        "fx": result.camera.fx,
        "k1": result.camera.distortion[0],
        "hypotheses": [
            {"angles_deg": [*h.refined.pose.angles_deg], "cost": h.cost, "ridge_score": h.ridge_score}
            | {"focal_factor": h.refined.camera.fx * factor}
            for h in search.hypotheses
        ],
    }
