"""Place one photo: camera, pose and stamp from its row in the pose file, the site's fixed camera and its sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import datetime

from ltm_core.base.errors import CameraError, PoseError, RecordingError
from ltm_core.base.number_text import stamp_of_moment
from ltm_core.base.types import Float64Array
from ltm_core.cameras.camera_config import PartialCalibration, PartialPose, PoseConfig
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import UNKNOWN_AZIMUTH_SIGMA_DEG, UNKNOWN_PITCH_SIGMA_DEG, Pose
from ltm_core.site.sections import CameraConfig
from ltm_ros.recordings.importing.assumptions import Assumptions, Surroundings, height_of, photo_time
from ltm_ros.recordings.importing.intrinsics import intrinsics
from ltm_ros.recordings.importing.photo import Photo, PhotoPose

_NOT_PLACED = "so that it places nothing until a pose is found (ltm pose photo)"


@dataclass(frozen=True, eq=False)
class PlacedPhoto:
    """A photo with everything that the graph needs. `covariance`: (6, 6) of the pose; None: the site's default.
    `notes`: assumptions, for the user."""

    photo: Photo
    camera: Camera
    pose: Pose
    covariance: Float64Array | None
    stamp_ns: int
    notes: list[str] = field(default_factory=list)


def place(photo: Photo, row: PhotoPose, camera: str, site: Surroundings, assumed: Assumptions) -> PlacedPhoto:
    """Combine what is known of a photo: its row precedes the site's fixed pose and calibration of `camera`, which
    precede its sensors and EXIF.

    Raises PoseError, CameraError or RecordingError with the remedy if position, azimuth, pitch, focal length or date
    are unknown."""
    notes: list[str] = []
    taken = photo_time(photo, row.stamp, assumed.time_zone, notes)
    stamp_ns = _stamp_ns(photo, taken)
    fixed = site.cameras.get(camera, CameraConfig())
    known = row.pose.over(_whole(fixed.pose))
    found: dict[str, float] = {}
    x, y = _position(photo, known, site, assumed, found)
    z = height_of(photo, known, x, y, site, assumed, notes, found)
    azimuth = _azimuth_deg(photo, known, site.frame, (x, y, z), taken, assumed, notes, found)
    pitch, roll = _tilt(photo, known, assumed, notes, found)
    if photo.turned:
        notes.append(
            f"{photo.turned}: the upright image of {photo.width} x {photo.height} pixels is used; calibration, "
            "pitch and roll must be for it"
        )
    pose = Pose.from_angles((x, y, z), azimuth, pitch, roll)
    stated = known.model_dump(include=set(found), exclude_none=True)
    error = site.pose_error
    covariance = known.model_copy(update=found | stated).covariance(pose, error.position, error.angle_deg)
    return PlacedPhoto(photo, _camera(photo, row, fixed, assumed), pose, covariance, stamp_ns, notes)


def _tilt(
    photo: Photo, known: PartialPose, assumed: Assumptions, notes: list[str], found: dict[str, float]
) -> tuple[float, float]:
    """Return pitch and roll in degrees."""
    sensed, sigma = photo.sensed, photo.sensed.tilt_sigma_deg or assumed.attitude_sigma_deg
    pitch, roll = known.pitch_deg, known.roll_deg
    if pitch is None and sensed.pitch_deg is not None:
        pitch, found["pitch_sigma_deg"] = sensed.pitch_deg, sigma
    if roll is None and sensed.roll_deg is not None:
        roll, found["roll_sigma_deg"] = sensed.roll_deg, sigma
    if pitch is None and assumed.pitch_deg is not None:
        pitch, found["pitch_sigma_deg"] = assumed.pitch_deg, assumed.tilt_sigma_deg
        notes.append(
            f"pitch is unknown ({sensed.source} has none): {pitch:g} +- {assumed.tilt_sigma_deg:g} deg is assumed"
        )
    if pitch is None and assumed.keep_unknown:
        pitch, found["pitch_sigma_deg"] = 0.0, UNKNOWN_PITCH_SIGMA_DEG
        notes.append(f"pitch is unknown (0 +- {UNKNOWN_PITCH_SIGMA_DEG:.0f} deg), {_NOT_PLACED}")
    if pitch is None:
        raise PoseError(
            f"{photo.path}: its pitch is unknown ({sensed.source} has none): give pitch_deg in a pose file "
            "(--poses), --pitch-deg for all photos, or --refine"
        )
    if roll is None:
        roll, found["roll_sigma_deg"] = 0.0, assumed.tilt_sigma_deg
        notes.append(f"roll is unknown: 0 +- {assumed.tilt_sigma_deg:g} deg is assumed")
    return pitch, roll


def _whole(fixed: PoseConfig | None) -> PartialPose | None:
    """Complete a pose: pitch and roll that a site file omits are 0."""
    if fixed is None:
        return None
    return fixed.model_copy(update={"pitch_deg": fixed.pitch_deg or 0.0, "roll_deg": fixed.roll_deg or 0.0})


def _stamp_ns(photo: Photo, taken: datetime) -> int:
    stamp_ns = stamp_of_moment(taken)
    if stamp_ns < 0:
        raise RecordingError(
            f"{photo.path} is dated {taken.isoformat()}, before 1970: give it a `stamp` in the pose file"
        )
    return stamp_ns


def _position(
    photo: Photo, known: PartialPose, site: Surroundings, assumed: Assumptions, found: dict[str, float]
) -> tuple[float, float]:
    frame = site.frame
    sensed, stated = photo.sensed, known.xy(frame)
    if stated is not None:
        if not site.covers(*stated):
            east, north = stated[0] + frame.x_origin, stated[1] + frame.y_origin
            raise PoseError(
                f"{photo.path}: the stated position ({east:.1f}, {north:.1f}) in {frame.crs} is outside the DEM: "
                "check the order of its coordinates and its CRS"
            )
        return stated
    lon, lat = sensed.lon, sensed.lat
    if lon is None or lat is None:
        why = f": {sensed.missing}" if sensed.missing else ""
        raise PoseError(
            f"{photo.path} has no position in {sensed.source}{why}; give it x, y or lon, lat in a pose file (--poses)"
        )
    found["position_sigma"] = sensed.position_sigma or assumed.gps_sigma
    x, y = frame.from_lonlat(lon, lat)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise PoseError(f"{photo.path}: position lon {lon}, lat {lat} lies outside the site's CRS {frame.crs}")
    if not site.covers(float(x), float(y)):
        raise PoseError(
            f"{photo.path}: position lon {lon:.6f}, lat {lat:.6f} in {sensed.source} is outside the DEM: give another "
            "--site, or the right position in a pose file (--poses)"
        )
    return float(x), float(y)


def _azimuth_deg(
    photo: Photo,
    known: PartialPose,
    frame: SiteFrame,
    position: tuple[float, float, float],
    taken: datetime,
    assumed: Assumptions,
    notes: list[str],
    found: dict[str, float],
) -> float:
    stated = known.grid_azimuth_deg(frame, position, taken.date())
    if stated is not None:
        return stated
    x, y, z = position
    sensed = photo.sensed
    azimuth = sensed.azimuth_deg
    if azimuth is None and assumed.keep_unknown:
        found["azimuth_sigma_deg"] = UNKNOWN_AZIMUTH_SIGMA_DEG
        notes.append(f"direction is unknown (0 +- {UNKNOWN_AZIMUTH_SIGMA_DEG:.0f} deg), {_NOT_PLACED}")
        return 0.0
    if azimuth is None:
        raise PoseError(
            f"{photo.path} has no direction in {sensed.source}: give azimuth_deg in a pose file (--poses), or --refine"
        )
    found["azimuth_sigma_deg"] = assumed.compass_sigma_deg
    if sensed.azimuth_ref == "M":
        return frame.magnetic_to_grid_deg(azimuth, x, y, taken.date(), z)
    if sensed.azimuth_ref is None:
        notes.append(
            f"{sensed.source} direction {azimuth:.1f} deg does not state its north reference: true north is assumed"
        )
    return frame.true_to_grid_deg(azimuth, x, y)


def _camera(photo: Photo, row: PhotoPose, fixed: CameraConfig, assumed: Assumptions) -> Camera:
    """Return the camera model. Raises CameraError as `intrinsics`, or if the row's calibration has another size."""
    width, height = photo.width, photo.height
    stated: PartialCalibration = row.calibration
    if stated.width is not None and (stated.width, stated.height) != (width, height):
        raise CameraError(
            f"{photo.path} has {width} x {height} pixels upright, but its calibration in the pose file is of "
            f"{stated.width} x {stated.height}: give fx or hfov_deg for this image size, or photos of that size"
        )
    if stated == PartialCalibration() and fixed.calibration is not None:
        stated = fixed.calibration
    cx, cy = stated.cx or 0.0, stated.cy or 0.0
    if photo.turned and not (0 <= cx < width and 0 <= cy < height):  # for a cropped image, it may be outside
        raise CameraError(
            f"{photo.path}: principal point cx, cy = ({cx:g}, {cy:g}) is outside the image of {width} x {height} "
            f"pixels, as {photo.turned}: give that of the upright image"
        )
    if stated.fx is not None or stated.hfov_deg is not None:
        return stated.camera_of(width, height, 0.0)
    read = intrinsics(photo.lens, width, height, str(photo.path), assumed.focal_35mm)
    return (read if stated == PartialCalibration() else stated).camera_of(width, height, read.fx or 0.0)
