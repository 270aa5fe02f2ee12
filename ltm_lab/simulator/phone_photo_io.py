"""Writes simulated frames as a phone's camera app does: JPEG with EXIF, a portrait stored as its sensor reads it."""

import io
import math
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from ltm_core.base.number_text import moment_of_stamp
from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, magnetic_declination_deg
from ltm_core.geometry.pose import Pose
from ltm_ros.recordings.importing.intrinsics import FULL_FRAME_DIAGONAL_MM


@dataclass(frozen=True, eq=False)
class PhonePhoto:
    """`image` (H, W, 3) upright; `camera` and `pose`: what the phone's sensors took for true, in a site's map frame.

    `position_sigma`: metres, as its GPS receiver states it.
    """

    name: str
    image: UInt8Array
    camera: Camera
    pose: Pose
    stamp_ns: int
    position_sigma: float


def true_azimuth_deg(photo: PhonePhoto, frame: SiteFrame) -> float:
    """From true north, in [0, 360)."""
    x, y, _ = photo.pose.position
    return (photo.pose.angles_deg[0] + frame.grid_convergence_deg(x, y)) % 360.0


def magnetic_azimuth_deg(photo: PhonePhoto, frame: SiteFrame) -> float:
    """From magnetic north, in [0, 360)."""
    x, y, z = photo.pose.position
    lon, lat = frame.to_lonlat(x, y)
    declination = magnetic_declination_deg(float(lon), float(lat), time_of(photo).date(), z)
    return (true_azimuth_deg(photo, frame) - declination) % 360.0


def time_of(photo: PhonePhoto) -> datetime:
    """UTC."""
    return moment_of_stamp(photo.stamp_ns)


def write_phone_photo(
    path: Path, photo: PhonePhoto, frame: SiteFrame, quality: int, north: Literal["T", "M"] = "T"
) -> None:
    """One JPEG. Tags: CIPA DC-008 (Exif 2.32), 4.6.4 to 4.6.6; altitude above sea level, direction from `north`."""
    height, width = photo.image.shape[:2]
    portrait = height > width
    # The sensor's rows lie along the screen's long side: orientation 6 turns them upright, clockwise by a quarter.
    stored = np.rot90(photo.image) if portrait else photo.image
    image = Image.fromarray(np.ascontiguousarray(stored))
    taken = time_of(photo)
    lon, lat = (float(v) for v in frame.to_lonlat(photo.pose.position[0], photo.pose.position[1]))
    altitude = float(photo.pose.position[2])
    azimuth = true_azimuth_deg(photo, frame) if north == "T" else magnetic_azimuth_deg(photo, frame)
    exif = image.getexif()
    exif[0x0112] = 6 if portrait else 1
    exif.get_ifd(0x8769).update(
        {
            0x9003: taken.strftime("%Y:%m:%d %H:%M:%S"),
            0x9011: "+00:00",
            0x9291: f"{taken.microsecond // 1000:03d}",
            0xA002: stored.shape[1],
            0xA003: stored.shape[0],
            0xA405: round(photo.camera.fx * FULL_FRAME_DIAGONAL_MM / math.hypot(width, height)),
        }
    )
    exif.get_ifd(0x8825).update(
        {
            1: "N" if lat >= 0 else "S",
            2: _sexagesimal(abs(lat)),
            3: "E" if lon >= 0 else "W",
            4: _sexagesimal(abs(lon)),
            5: b"\0" if altitude >= 0 else b"\1",
            6: _rational(abs(altitude)),
            7: tuple(_rational(v) for v in (taken.hour, taken.minute, taken.second)),
            16: north,
            17: _rational(azimuth),
            29: taken.strftime("%Y:%m:%d"),
            31: _rational(photo.position_sigma),
        }
    )
    image.save(path, "JPEG", quality=quality, subsampling=2, exif=exif.tobytes())


def upright_jpeg(photo: PhonePhoto, quality: int) -> bytes:
    """The upright picture without EXIF, as apps store it that take frames from the camera."""
    file = io.BytesIO()
    Image.fromarray(photo.image).save(file, "JPEG", quality=quality, subsampling=2)
    return file.getvalue()


def _sexagesimal(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    whole = int(degrees)
    minutes = int((degrees - whole) * 60)
    return _rational(whole), _rational(minutes), _rational((degrees - whole - minutes / 60) * 3600)


def _rational(value: float) -> IFDRational:
    fraction = Fraction(value).limit_denominator(100_000)
    return IFDRational(fraction.numerator, fraction.denominator)
