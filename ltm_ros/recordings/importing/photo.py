"""Read photos upright as JPEG or PNG bytes with their sensor data, and the file of their poses."""

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile, get_sampling
from pydantic import Field

from ltm_core.base.errors import ConfigError, ImageError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import UInt8Array
from ltm_core.cameras.camera_config import PartialCalibration, PartialPose
from ltm_core.site.site import RosName
from ltm_core.storage import image_io
from ltm_core.storage.config_io import LARGEST_TABLE, checked, read_text, read_yaml
from ltm_msgs_py.image import encode_rgb
from ltm_ros.recordings.importing.exif import ExifFacts, Sensed, exif_facts, sensed_by_xmp, xmp_values
from ltm_ros.recordings.importing.intrinsics import LensFacts, lens_of_photo

SUFFIXES = (".jpg", ".jpeg", ".png", ".heic", ".heif", ".hif", ".webp", ".avif", ".mpo")
_FORMATS = ("JPEG", "MPO", "PNG", "HEIF", "WEBP", "TIFF", "AVIF")
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
    """One photo. `data`: `image_format` (jpeg or png) bytes of the upright image, `width` x `height` pixels. `turned`:
    what EXIF does to the stored image, `EXIF turns it by 90 degrees clockwise`; empty: nothing."""

    path: Path
    data: bytes
    image_format: str
    width: int
    height: int
    exif: ExifFacts
    sensed: Sensed
    lens: LensFacts = field(default_factory=LensFacts)
    turned: str = ""


@dataclass(frozen=True)
class ImportedImage:
    """A photo to import, whatever file contains it.

    `name`: in a pose file. `path`: of its file, or of its container with its name there. `read`: reads it each time."""

    name: str
    path: Path
    read: Callable[[], Photo]


def read_photo(path: Path) -> Photo:
    """Read a JPEG, PNG, HEIC, WebP, TIFF or AVIF photo, detected by its content.

    JPEG and PNG bytes are unchanged unless EXIF requires a rotation; then, and for other formats, the upright image is
    compressed again: a JPEG with its own quantisation, others with JPEG quality 95. What follows a JPEG's image, such
    as a motion photo's video, is cut off. Raises ImageError for other files, and for corrupt or incomplete ones."""
    return photo_of(image_io.read_picture(path), path)


def photo_of(data: bytes, path: Path) -> Photo:
    """Return the photo of a file's bytes; `path`: its name in errors. Raises as `read_photo`."""
    with image_io.opened_picture(data, path) as image:
        if image.format not in _FORMATS:
            raise ImageError(f"{path} is {image.format}; photos must be JPEG, PNG, HEIC, WebP, TIFF or AVIF")
        exif, xmp = image.getexif(), xmp_values(image.info.get("xmp"))
        facts = exif_facts(exif, str(path))
        turn, encoding = image_io.orientation(data, path), image_io.image_format(data)
        pixels = image_io.upright(image_io.decode_rgb(data, str(path)), turn)
        height, width = pixels.shape[:2]
        lens = lens_of_photo(exif, xmp, width, height)
        if turn == 1 and encoding:
            stored = image_io.without_tail(data)
        elif isinstance(image, JpegImageFile):
            stored = _turned_jpeg(image, pixels, turn)
        else:
            stored = encode_rgb(pixels, encoding or "jpeg", _REENCODED_QUALITY)
    encoding = encoding or "jpeg"
    sensed = sensed_by_xmp(xmp, facts.sensed)
    turned = f"EXIF {_TURNS[turn]}" if turn in _TURNS else ""
    return Photo(path, stored, encoding, width, height, facts, sensed, lens, turned)


def _turned_jpeg(stored: JpegImageFile, pixels: UInt8Array, turn: int) -> bytes:
    """Return turned pixels as a JPEG with the quantisation of the stored image, so that they change hardly."""
    tables = {number: np.reshape(table, (8, 8)) for number, table in stored.quantization.items()}
    tables = {number: table.T if turn > 4 else table for number, table in tables.items()}  # a quarter turn
    written = BytesIO()
    Image.fromarray(pixels).save(
        written,
        "JPEG",
        qtables={number: table.ravel().tolist() for number, table in tables.items()},
        subsampling=get_sampling(stored) if stored.layers == 3 else -1,
    )
    return written.getvalue()


_SECTIONS: dict[str, type[StrictModel]] = {"pose": PartialPose, "calibration": PartialCalibration}


class PhotoPose(StrictModel):
    """Known values of one photo; others come from the site file's camera, or from EXIF.

    `pose` and `calibration` are those of a site file. In a CSV their keys are columns beside `name`."""

    name: str = Field(min_length=1)
    """File name of the photo, without its folder."""
    camera: RosName | None = None
    stamp: datetime | None = None
    """Time of the photo in ISO 8601, UTC unless it states a zone."""
    pose: PartialPose = PartialPose()
    calibration: PartialCalibration = PartialCalibration()


def columns() -> list[str]:
    """Return all columns that a CSV may have."""
    own = [name for name in PhotoPose.model_fields if name not in _SECTIONS]
    return own + [name for model in _SECTIONS.values() for name in model.model_fields]


def read_pose_file(path: Path) -> dict[str, PhotoPose]:
    """Return rows by photo name, from a CSV with a header; or by names without suffix, from a folder of pose files.

    Raises ConfigError for another file, unknown columns, invalid values (with the line), or a photo listed twice."""
    if path.is_dir():
        return _pose_files(path)
    if path.suffix.lower() != ".csv":
        raise ConfigError(f"pose file {path} must be a CSV file (.csv), or a folder of pose files")
    lines = io.StringIO(read_text(path, LARGEST_TABLE, ConfigError, "utf-8-sig"), newline="")
    poses: dict[str, PhotoPose] = {}
    try:
        reader = csv.DictReader((line for line in lines if line.strip()), skipinitialspace=True, strict=True)
        header = reader.fieldnames = [name.strip() for name in reader.fieldnames or []]
        unknown = sorted(set(header) - set(columns()))
        if unknown or len(set(header)) < len(header):
            named = ", ".join(unknown) or "(duplicates)"
            raise ConfigError(f"pose file {path}: unknown columns {named}; known: {', '.join(columns())}")
        for number, row in enumerate(reader, start=1):
            place = f"{path}, row {number}"
            if None in row or None in row.values():
                raise ConfigError(f"{place}: the number of values differs from the header's {len(header)} columns")
            stated = {name: value.strip() for name, value in row.items() if value.strip()}
            content: dict[str, Any] = {name: v for name, v in stated.items() if name in PhotoPose.model_fields}
            for section, model in _SECTIONS.items():
                if values := {name: v for name, v in stated.items() if name in model.model_fields}:
                    content[section] = values
            pose = checked(PhotoPose, content, place, unnamed=_SECTIONS)
            if pose.name in poses:
                raise ConfigError(f"{place}: {pose.name} is listed twice")
            poses[pose.name] = pose
    except csv.Error as error:
        raise ConfigError(f"{path}: cannot be read as CSV ({error})") from error
    if not poses:
        raise ConfigError(f"pose file {path} has no rows")
    return poses


def _pose_files(folder: Path) -> dict[str, PhotoPose]:
    poses = {}
    for path in sorted(folder.glob("*.yaml")):
        content = read_yaml(path)
        if not isinstance(content, dict) or "pose" not in content:
            raise ConfigError(f"{path} is not a pose file: it has no section `pose`")
        known = {section: content[section] for section in _SECTIONS if section in content}
        poses[path.stem] = checked(PhotoPose, {"name": path.stem, **known}, str(path))
    if not poses:
        raise ConfigError(f"{folder} contains no pose files (NAME.yaml for the photo NAME)")
    return poses
