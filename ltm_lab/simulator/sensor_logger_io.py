"""Writes simulated photos as a recording of the phone app Sensor Logger: a zip of CSV tables and camera frames.

Columns and their order, units and axes are the app's (its UNITS.md, COORDINATES.md and CROSSPLATFORM.md). Between two
photos the phone goes and turns evenly from one to the next.
"""

import math
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ltm_core.base.types import Float64Array, Int64Array
from ltm_core.cameras.sensor_pose import ENU_FROM_ENU, ENU_FROM_NWU, phone_camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.phone_photo_io import (
    PhonePhoto,
    magnetic_azimuth_deg,
    time_of,
    true_azimuth_deg,
    upright_jpeg,
)

_BEFORE_NS = 2_000_000_000
"""The recording begins so long before its first photo, and ends so long after the last."""
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)
"""Of all members, that the same photos give the same bytes."""


def write_sensor_logger(
    path: Path,
    photos: Sequence[PhonePhoto],
    frame: SiteFrame,
    quality: int,
    geoid_undulation: float,
    platform: Literal["ios", "android"] = "ios",
    attitude_hz: float = 5.0,
    with_frames: bool = True,
) -> None:
    """The zip of one walk. `geoid_undulation`: metres of the geoid above the ellipsoid there. `with_frames`: also the
    photos, as the app's sensor `Camera` takes them.
    """
    photos = sorted(photos, key=lambda photo: photo.stamp_ns)
    stamps = np.array([photo.stamp_ns for photo in photos], np.int64)
    start, end = int(stamps[0]) - _BEFORE_NS, int(stamps[-1]) + _BEFORE_NS
    seconds = np.arange(start, end + 1, 1_000_000_000, dtype=np.int64)
    turns = np.arange(start, end + 1, round(1e9 / attitude_hz), dtype=np.int64)
    places = np.array([photo.pose.position for photo in photos])
    sigma = photos[0].position_sigma
    members = {
        "Metadata.csv": _metadata(photos[0], start, platform),
        "Location.csv": _location(seconds, start, _along(stamps, places, seconds), frame, geoid_undulation, sigma),
        "Barometer.csv": _barometer(seconds, start, _along(stamps, places, seconds)[:, 2]),
        "Orientation.csv": _orientation(turns, start, stamps, _attitudes(photos, frame, platform), platform),
    }
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in members.items():
            archive.writestr(zipfile.ZipInfo(name, _ZIP_DATE), text, zipfile.ZIP_DEFLATED)
        for photo in photos if with_frames else ():
            info = zipfile.ZipInfo(f"Camera/{photo.stamp_ns // 1_000_000}.jpg", _ZIP_DATE)
            archive.writestr(info, upright_jpeg(photo, quality))


def _metadata(first: PhonePhoto, start: int, platform: str) -> str:
    begun = time_of(first).strftime("%Y-%m-%d_%H-%M-%S")
    return _csv(
        "version,device name,recording epoch time,recording time,recording timezone,platform,appVersion,device id,"
        "sensors,sampleRateMs,standardisation,platform version",
        [
            f"3,simulated phone,{start // 1_000_000},{begun},UTC,{platform},1.64,simulated,"
            "Location|Barometer|Orientation|Camera,0|1000|200|0,false,0"
        ],
    )


def _location(
    stamps: Int64Array, start: int, places: Float64Array, frame: SiteFrame, undulation: float, sigma: float
) -> str:
    lon, lat = frame.to_lonlat(places[:, 0], places[:, 1])
    rows = (
        f"{ns},{(ns - start) / 1e9:.3f},-1,-1,{1.6 * sigma:.3f},{sigma:.3f},1.2,{z:.4f},-1,{z + undulation:.4f},"
        f"{float(x):.9f},{float(y):.9f}"
        for ns, x, y, z in zip(stamps, lon, lat, places[:, 2], strict=True)
    )
    return _csv(
        "time,seconds_elapsed,bearingAccuracy,speedAccuracy,verticalAccuracy,horizontalAccuracy,speed,"
        "altitudeAboveMeanSeaLevel,bearing,altitude,longitude,latitude",
        rows,
    )


def _barometer(stamps: Int64Array, start: int, heights: Float64Array) -> str:
    rows = (
        f"{ns},{(ns - start) / 1e9:.3f},{z - heights[0]:.4f},{1013.25 * (1 - z / 44_330) ** (1 / 0.1903):.5f}"
        for ns, z in zip(stamps, heights, strict=True)
    )
    return _csv("time,seconds_elapsed,relativeAltitude,pressure", rows)


def _attitudes(photos: Sequence[PhonePhoto], frame: SiteFrame, platform: str) -> Rotation:
    """Of each photo, the phone's axes to the platform's world."""
    world = (ENU_FROM_ENU if platform == "android" else ENU_FROM_NWU).T
    matrices = []
    for photo in photos:
        north = magnetic_azimuth_deg if platform == "android" else true_azimuth_deg
        _, pitch, roll = photo.pose.angles_deg
        enu_from_optical = Pose.from_angles((0.0, 0.0, 0.0), north(photo, frame), pitch, roll).rotation
        landscape = photo.camera.width > photo.camera.height
        matrices.append(world @ enu_from_optical @ phone_camera(90.0 if landscape else 0.0).T)
    return Rotation.from_matrix(np.array(matrices))


def _orientation(turns: Int64Array, start: int, stamps: Int64Array, attitudes: Rotation, platform: str) -> str:
    """Held still for a second about each photo, and turned evenly in between."""
    still = 500_000_000
    keys = np.concatenate([stamps - still, stamps + still]).reshape(2, -1).T.ravel()
    held = Rotation.concatenate([attitudes[i // 2] for i in range(2 * len(stamps))])
    at = np.clip(turns, keys[0], keys[-1])
    rotations = Slerp((keys - keys[0]) / 1e9, held)((at - keys[0]) / 1e9)
    matrices, quaternions = rotations.as_matrix(), rotations.as_quat()
    rows = []
    for ns, m, (qx, qy, qz, qw) in zip(turns, matrices, quaternions, strict=True):
        raised = math.asin(max(-1.0, min(1.0, m[2, 1])))
        if platform == "android":  # SensorManager.getOrientation
            yaw, pitch, roll = math.atan2(m[0, 1], m[1, 1]), -raised, math.atan2(-m[2, 0], m[2, 2])
        else:  # CMAttitude: R = Rz(yaw) Rx(pitch) Ry(roll)
            yaw, pitch, roll = math.atan2(-m[0, 1], m[1, 1]), raised, math.atan2(-m[2, 0], m[2, 2])
        rows.append(
            f"{ns},{(ns - start) / 1e9:.3f},{yaw:.6f},{qx:.7f},{qz:.7f},{roll:.6f},{qw:.7f},{qy:.7f},{pitch:.6f}"
        )
    return _csv("time,seconds_elapsed,yaw,qx,qz,roll,qw,qy,pitch", rows)


def _along(stamps: Int64Array, values: Float64Array, at: Int64Array) -> Float64Array:
    """Values (N, 3) at `stamps` (N,), between them at other times."""
    return np.column_stack([np.interp(at - stamps[0], stamps - stamps[0], column) for column in values.T])


def _csv(header: str, rows: Iterable[str]) -> str:
    return "\n".join([header, *rows]) + "\n"
