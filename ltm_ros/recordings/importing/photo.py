"""Find photo files, and read them upright as JPEG or PNG bytes, with their sensor data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import ImageOps

from ltm_core.base.errors import ImageError
from ltm_core.storage.text_io import opened_picture, read_picture
from ltm_msgs_py.image import decode_rgb, encode_rgb
from ltm_ros.recordings.importing.dji import sensed_by_xmp
from ltm_ros.recordings.importing.exif import ExifFacts, exif_facts, xmp_values
from ltm_ros.recordings.importing.intrinsics import LensFacts, lens_of_photo
from ltm_ros.recordings.importing.sensor_track import Sensed

SUFFIXES = (".jpg", ".jpeg", ".png", ".heic", ".heif")
_FORMATS = {"JPEG": "jpeg", "MPO": "jpeg", "PNG": "png"}
_REENCODED_QUALITY = 95
_TURNS = {
    2: "mirrors it",
    3: "turns it by 180 degrees",
    4: "turns it by 180 degrees and mirrors it",
    5: "turns it by 90 degrees and mirrors it",
    6: "turns it by 90 degrees clockwise",
    7: "turns it by 90 degrees and mirrors it",
    8: "turns it by 90 degrees counter-clockwise",
}
"""Effect of EXIF's orientation tag on the stored image: CIPA DC-008 (Exif 2.32), 4.6.4."""


@dataclass(frozen=True)
class Photo:
    """One photo. `data`: `image_format` (jpeg or png) bytes of the upright image, `width` x `height` pixels. `sensed`:
    known position and direction.

    `reencoded`: whether `data` differs from the file, because it is HEIC or was turned upright.
    """

    path: Path
    data: bytes
    image_format: str
    width: int
    height: int
    exif: ExifFacts
    sensed: Sensed
    reencoded: bool
    lens: LensFacts = field(default_factory=LensFacts)

    @property
    def turned(self) -> str:
        """Return what EXIF does to the stored image: `EXIF turns it by 90 degrees clockwise`; empty: nothing."""
        # libheif has rotated a HEIC image by its own format, so its EXIF tag has no effect.
        known = self.path.suffix.lower() not in (".heic", ".heif") and self.exif.orientation in _TURNS
        return f"EXIF {_TURNS[self.exif.orientation]}" if known else ""


@dataclass(frozen=True)
class ImportedImage:
    """A photo to import, whatever file contains it.

    `name`: in a pose file. `path`: of its file, or of its container with its name there. `read`: reads the photo
    each time, because a season's photos do not fit in memory. `capture`: name in a pose file for all images of one
    capture, if its row gives the start; empty: none.
    """

    name: str
    path: Path
    read: Callable[[], Photo]
    capture: str = ""


def photos_in(folder: Path) -> list[Path]:
    """Return the photos in a folder (not below it), by name."""
    return sorted(
        p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith(".") and p.is_file()
    )


def read_photo(path: Path) -> Photo:
    """Read a JPEG, PNG or HEIC photo, detected by its content.

    JPEG and PNG bytes are unchanged unless EXIF requires a rotation; then, and for HEIC, the upright image is
    compressed again (JPEG quality 95). Raises ImageError for other files, and for corrupt ones.
    """
    return photo_of(read_picture(path), path)


def photo_of(data: bytes, path: Path) -> Photo:
    """Return the photo of a file's bytes; `path`: its name in errors. Raises as `read_photo`."""
    with opened_picture(data, path) as image:
        found = image.format or "unknown"
        if found not in _FORMATS and found != "HEIF":
            raise ImageError(f"{path} is {found}; photos must be JPEG, PNG or HEIC")
        exif, xmp = image.getexif(), xmp_values(image.info.get("xmp"))
        facts = exif_facts(exif, str(path))
        # libheif has already rotated a HEIC image, whatever its EXIF says.
        reencoded = found not in _FORMATS or facts.orientation != 1
        if reencoded:
            upright = image if found == "HEIF" else ImageOps.exif_transpose(image)
            pixels = np.asarray(upright.convert("RGB"), np.uint8)
        else:
            pixels = decode_rgb(data, str(path))
        height, width = pixels.shape[:2]
        lens = lens_of_photo(exif, xmp, width, height)
    image_format = _FORMATS.get(found, "jpeg")
    if reencoded:
        data = encode_rgb(pixels, image_format, _REENCODED_QUALITY)
    return Photo(
        path, data, image_format, width, height, facts, sensed_by_xmp(xmp, sensed_by_exif(facts)), reencoded, lens
    )


def sensed_by_exif(facts: ExifFacts) -> Sensed:
    """Return position and direction from EXIF, which has no pitch and no roll."""
    return Sensed(
        lon=facts.lon,
        lat=facts.lat,
        position_sigma=facts.position_error,
        altitude=facts.altitude,
        ellipsoidal=False if facts.above_sea else None,
        missing=facts.no_position,
        azimuth_deg=facts.direction_deg,
        azimuth_ref=facts.direction_ref,
    )
