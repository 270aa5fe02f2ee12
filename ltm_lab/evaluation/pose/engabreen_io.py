"""Trials on a real photo with surveyed control points (Engabreen): its pose is found without them, from far off."""

import json
import math
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.points.resection import Resection, resect
from ltm_core.pose_estimation.points.resection_io import read_control_points
from ltm_core.pose_estimation.skyline.contour_scores import picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import SearchTerrain, find_pose
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between
from ltm_core.raster.dem import Dem
from ltm_core.storage.config_io import read_text
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.trace_io import read_photo
from ltm_core.visibility.footprint import pixel_rays
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.pose.pose_trial import Angles, three

_FRAME = SiteFrame("EPSG:32633", 446_000.0, 7_396_000.0)
STARTS = 12
_OFF_DEG = 10.0, 3.0, 1.0
"""Errors of the starts' azimuth, pitch and roll."""
VARIANTS = {
    "place and focal length of the control points": (0.0, False),
    "focal length as stated (2.8 % off), fitted": (0.0, True),
    "place 30 m off, fitted": (30.0, False),
}
"""Metres by which the place of the starts is off, and whether the focal length is the stated one."""


class _Stated(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    image: str
    position_e_n_z: tuple[float, float, float]
    focal_mm: float
    sensor_mm: tuple[float, float]
    size_px: tuple[int, int]


@dataclass(frozen=True, eq=False)
class RealPhoto:
    """The photo, its DEM, the pose and camera that its control points give, and the camera that is stated."""

    photo: UInt8Array
    terrain: SearchTerrain
    points: Resection
    stated: Camera


@dataclass(frozen=True)
class RealTrial:
    """One start. `error`: of azimuth, pitch and roll from the control points' pose, degrees; `moved`: metres between
    the two places; `focal`: found focal length over the points'; `rmse`, `median`: metres on the ground, of the control
    points on ground that the DEM shows; `seconds`: processor time."""

    variant: str
    start: Angles
    verdict: str
    error: Angles
    moved: float
    focal: float
    rmse: float
    median: float
    seconds: float


@dataclass(frozen=True)
class RealJob:
    """One of the VARIANTS on the photo of a folder, with the labels of a network."""

    folder: Path
    model: str
    variant: str


def read_real_photo(folder: Path) -> RealPhoto:
    """Read the photo's folder. Raises RecordingError for any other folder."""
    place = folder / "camera_stated.json"
    try:
        stated = _Stated.model_validate(json.loads(read_text(place, 1 << 16, RecordingError)))
    except (ValidationError, ValueError) as error:
        raise RecordingError(f"{place}: not the stated camera of the Engabreen data ({error})") from error
    width, height = stated.size_px
    fx = stated.focal_mm / stated.sensor_mm[0] * width
    camera = Camera(width, height, fx, fx, (width - 1) / 2, (height - 1) / 2)
    x, y, z = stated.position_e_n_z
    bend = ray_bend(True, 0.13)
    points = read_control_points(folder / "gcp8902.csv", _FRAME, first_pixel=1.0)
    fitted = resect(points, camera, (x - _FRAME.x_origin, y - _FRAME.y_origin, z), bend=bend)
    dem = Dem.open(folder / "dem_3m_f64.tif").in_frame(_FRAME)
    return RealPhoto(read_photo(folder / stated.image, camera), SearchTerrain(dem, bend), fitted, camera)


def run_real_job(job: RealJob) -> list[RealTrial]:
    """Run the trials of a variant."""
    real = read_real_photo(job.folder)
    trials = run_real_trials(real, Segmenter.open(job.model).segment(real.photo).labels, *VARIANTS[job.variant])
    return [replace(trial, variant=job.variant) for trial in trials]


def run_real_trials(
    real: RealPhoto, labels: UInt8Array, position_off: float = 0.0, focal_free: bool = False
) -> list[RealTrial]:
    """Search the pose from 12 starts, with the calibration of the control points.

    `focal_free`: with the stated focal length, which is fitted. `position_off`: metres by which the start's place is
    off, in as many directions; it is then fitted."""
    true, camera = real.points.pose, real.points.camera
    if focal_free:
        camera = replace(camera, fx=real.stated.fx, fy=real.stated.fy)
    evidence = picture_evidence(real.photo, labels, camera)
    dem, tracer = real.terrain.dem, TerrainTracer(real.terrain.dem)
    trials = []
    for k in range(STARTS):
        off = np.multiply(_OFF_DEG, (1 if k % 2 else -1, 1 if k // 2 % 2 else -1, k // 4 - 1))
        angle = 2 * math.pi * k / STARTS
        place = true.position + position_off * np.array([math.cos(angle), math.sin(angle), 0.0])
        place[2] += dem.elevation_at(*place[:2]) - dem.elevation_at(*true.position[:2])
        start = Pose.from_angles(place, *three(np.add(true.angles_deg, off)))
        begin = time.process_time()
        prior = PosePrior(start, *_OFF_DEG, position_off / 1.5, position_off / 6)
        search = find_pose(evidence, real.terrain, prior, 0.03 if focal_free else 0.0)
        spent = time.process_time() - begin
        best = search.hypotheses[0].refined if search.hypotheses else None
        pose = start if best is None else best.pose
        lens = camera.zoomed(1.0 if best is None else best.camera.fx / evidence.camera.fx)
        ground = _ground_errors(real.points, pose, lens, tracer)
        trials.append(
            RealTrial(
                "",
                three(off),
                search.verdict.word,
                three(np.degrees(angles_between(true, pose))),
                float(np.linalg.norm(pose.position - true.position)),
                lens.fx / real.points.camera.fx,
                float(np.sqrt(np.mean(ground**2))) if ground.size else math.nan,
                float(np.median(ground)) if ground.size else math.nan,
                spent,
            )
        )
    return trials


def _ground_errors(points: Resection, pose: Pose, camera: Camera, tracer: TerrainTracer) -> Float64Array:
    """Return the horizontal metres between surveyed points and the places to which their pixels are traced, of the
    points that the true pose traces to within 10 m: the DEM hides the others."""

    def errors(at: Pose, lens: Camera) -> Float64Array:
        rays = pixel_rays(lens, points.points.pixels) @ at.rotation.T
        ranges = tracer.trace_rays(at.position, rays).astype(np.float64)
        places = at.position + rays * np.where(np.isfinite(ranges), ranges, np.nan)[:, None]
        return np.asarray(np.hypot(*(places - points.points.places)[:, :2].T), np.float64)

    shown = errors(points.pose, points.camera) < 10.0
    found = errors(pose, camera)[shown]
    return found[np.isfinite(found)]
