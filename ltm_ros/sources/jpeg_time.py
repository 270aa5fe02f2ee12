"""When a picture was taken, as its EXIF says."""

from __future__ import annotations

import io
from datetime import UTC, tzinfo

import PIL.Image

from ltm_core.errors import ImageError
from ltm_core.picture_io import BROKEN
from ltm_ros.importer.exif import exif_facts
from ltm_ros.sources.picture import CameraTime

_HEAD = 64 << 10
"""EXIF stands in a JPEG's first segment, which holds no more."""


def exif_time(data: bytes, zone: tzinfo = UTC) -> CameraTime | None:
    """By the camera's clock; None where none is stated. `zone`: of one that states no zone."""
    if b"Exif\0\0" not in data[:_HEAD]:
        return None
    try:
        with PIL.Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as picture:
            taken = exif_facts(picture.getexif(), "picture").taken
    except (ImageError, *BROKEN):
        return None
    if taken is None:
        return None
    moment = taken if taken.tzinfo is not None else taken.replace(tzinfo=zone)
    # Thousandths, where the camera states a fraction; it says nothing of how exact that is.
    return CameraTime(moment.timestamp(), 0.001 if taken.microsecond else 1.0, "exif")
