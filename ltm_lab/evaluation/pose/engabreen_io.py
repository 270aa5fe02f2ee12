"""A real photo with surveyed control points (Engabreen): its pose found without them, from starts that are far off."""

from __future__ import annotations

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
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, SearchTerrain, find_pose
from ltm_core.pose_estimation.skyline.picture_evidence import picture_evidence
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between
from ltm_core.raster.dem import Dem
from ltm_core.storage.text_io import read_text
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.trace_io import read_photo

_FRAME = SiteFrame("EPSG:32633", 446_000.0, 7_396_000.0)
STARTS = 12
AZIMUTH_OFF_DEG, PITCH_OFF_DEG, ROLL_OFF_DEG = 10.0, 3.0, 1.0


class _Stated(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    image: str
    position_e_n_z: tuple[float, float, float]
    focal_mm: float
    sensor_mm: tuple[float, float]
    size_px: tuple[int, int]


@dataclass(frozen=True, eq=False)
class RealPhoto:
    """The photo, its DEM, and the pose and camera that its control points give."""

    photo: UInt8Array
    terrain: SearchTerrain
    points: Resection
    stated: Camera


@dataclass(frozen=True, eq=False)
class RealTrial:
    """Of one start: error (3) of azimuth, pitch and roll from the control points' pose, degrees; metres between the
    camera's places; the focal length over the points'; RMSE and median, metres on the ground, of control points."""

    start: tuple[float, float, float]
    verdict: str
    error: tuple[float, float, float]
    moved: float
    focal: float
    rmse: float
    median: float
    seconds: float
    search: PictureSearch


def read_real_photo(folder: Path) -> RealPhoto:
    """Raises RecordingError for a folder that is another, and what its files raise."""
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


def run_real_trials(
    real: RealPhoto,
    labels: UInt8Array,
    position_off: float = 0.0,
    focal_free: bool = False,
    config: PicturePoseConfig = PicturePoseConfig(),
) -> list[RealTrial]:
    """Search the pose from 12 starts, 10 deg of azimuth and 3 of pitch off each way, with the calibration of the
    control points; `focal_free`: with the stated focal length, to be fitted. `position_off`: metres that the start's
    place is off, in as many directions; it is then fitted too.
    """
    true, camera = real.points.pose, real.points.camera
    if focal_free:
        camera = replace(camera, fx=real.stated.fx, fy=real.stated.fy)
    evidence = picture_evidence(real.photo, labels, camera, config)
    tracer = TerrainTracer(real.terrain.dem)
    trials = []
    for k in range(STARTS):
        off = (
            AZIMUTH_OFF_DEG * (1 if k % 2 else -1),
            PITCH_OFF_DEG * (1 if k // 2 % 2 else -1),
            ROLL_OFF_DEG * (k // 4 - 1),
        )
        angle = 2 * math.pi * k / STARTS
        away = position_off * np.array([math.cos(angle), math.sin(angle), 0.0])
        azimuth, pitch, roll = np.add(true.angles_deg, off)
        place = true.position + away
        place[2] += real.terrain.dem.elevation_at(*place[:2]) - real.terrain.dem.elevation_at(*true.position[:2])
        start = Pose.from_angles(place, float(azimuth), float(pitch), float(roll))
        prior = PosePrior(start, AZIMUTH_OFF_DEG, PITCH_OFF_DEG, ROLL_OFF_DEG, position_off / 1.5, position_off / 6)
        begin = time.process_time()
        search = find_pose(evidence, real.terrain, prior, config, 0.03 if focal_free else 0.0)
        spent = time.process_time() - begin
        best = search.hypotheses[0].refined if search.hypotheses else None
        pose = start if best is None else best.pose
        factor = 1.0 if best is None else best.camera.fx / evidence.camera.fx
        lens = camera.zoomed(factor)
        error = np.degrees(angles_between(true, pose))
        ground = _ground_errors(real.points, pose, lens, tracer)
        trials.append(
            RealTrial(
                off,
                search.verdict.word,
                (float(error[0]), float(error[1]), float(error[2])),
                float(np.linalg.norm(pose.position - true.position)),
                lens.fx / real.points.camera.fx,
                float(np.sqrt(np.mean(ground**2))) if ground.size else math.nan,
                float(np.median(ground)) if ground.size else math.nan,
                spent,
                search,
            )
        )
    return trials


def _ground_errors(points: Resection, pose: Pose, camera: Camera, tracer: TerrainTracer) -> Float64Array:
    """Horizontal metres (K,) between surveyed points and where their marked pixels are traced to, of those that the
    true pose traces to within 10 m of them: the others the DEM hides."""

    def errors(at: Pose, lens: Camera) -> Float64Array:
        rays = _rays(points.points.pixels, lens) @ at.rotation.T
        ranges = tracer.trace_rays(at.position, rays).astype(np.float64)
        places = at.position + rays * np.where(np.isfinite(ranges), ranges, np.nan)[:, None]
        return np.asarray(np.hypot(*(places - points.points.places)[:, :2].T), np.float64)

    shown = errors(points.pose, points.camera) < 10.0
    found = errors(pose, camera)[shown]
    return found[np.isfinite(found)]


def _rays(pixels: Float64Array, camera: Camera) -> Float64Array:
    import cv2

    k1, k2, p1, p2, k3 = camera.distortion
    flat = cv2.undistortPoints(pixels.reshape(-1, 1, 2), camera.matrix, np.array([k1, k2, p1, p2, k3])).reshape(-1, 2)
    rays = np.column_stack([flat, np.ones(len(flat))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True), np.float64)
