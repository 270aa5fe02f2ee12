"""Reads pose files: what a user knows of each photo, as CSV or YAML. It takes precedence over EXIF."""

from __future__ import annotations

import csv
import io
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from ltm_core.config_io import checked
from ltm_core.errors import ConfigError
from ltm_core.plausibility import AzimuthDeg, PitchDeg, RollDeg
from ltm_core.site import Config, RosName
from ltm_core.text_io import LARGEST_TABLE, read_text
from ltm_core.yaml_io import read_yaml


def _unquoted(value: object) -> object:
    return "true" if value is True else value  # YAML reads the bare word as a boolean


class PhotoPose(Config):
    """One row. What is left out comes from EXIF, or, for pitch, roll and the lens's distortion, is 0.

    Pixels and calibration are those of the upright image.
    """

    name: str = Field(min_length=1)
    """File name of the photo, without its folder."""
    camera: RosName | None = None
    x: float | None = None
    """Metres in the site's CRS (not minus its origin), as is y."""
    y: float | None = None
    lon: float | None = Field(None, ge=-180, le=180)
    """WGS 84 degrees, as is lat; instead of x and y."""
    lat: float | None = Field(None, ge=-90, le=90)
    z: float | None = None
    """Metres, in the DEM's vertical datum."""
    height_above_ground: float | None = Field(None, ge=0)
    """Metres; instead of z."""
    azimuth_deg: AzimuthDeg | None = None
    """Of the optical axis, clockwise from the north that `azimuth_ref` names."""
    azimuth_ref: Annotated[Literal["grid", "true", "magnetic"], BeforeValidator(_unquoted)] = "grid"
    pitch_deg: PitchDeg | None = None
    roll_deg: RollDeg | None = None
    fx: float | None = Field(None, gt=0)
    """Focal length, pixels; fy is the same unless given."""
    fy: float | None = Field(None, gt=0)
    cx: float | None = None
    """Principal point, pixels; the image's centre unless given."""
    cy: float | None = None
    hfov_deg: float | None = Field(None, gt=0, lt=180)
    """Between the image's outer edges; instead of fx."""
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    stamp: datetime | None = None
    """ISO 8601; UTC unless it names a zone."""

    @model_validator(mode="after")
    def _no_contradiction(self) -> PhotoPose:
        for a, b in (("x", "y"), ("lon", "lat")):
            if (getattr(self, a) is None) != (getattr(self, b) is None):
                raise ValueError(f"give both {a} and {b}, or neither")
        for a, b in (("x", "lon"), ("z", "height_above_ground"), ("fx", "hfov_deg")):
            if getattr(self, a) is not None and getattr(self, b) is not None:
                raise ValueError(f"give either {a} or {b}, not both")
        if self.fy is not None and self.fx is None:
            raise ValueError("fy needs fx")
        return self


def read_pose_file(path: Path) -> dict[str, PhotoPose]:
    """Rows by photo name, from a CSV with a header line or a YAML list of mappings.

    Raises ConfigError: no file, another kind of file, unknown columns, wrong or contradicting values (with the line),
    or a photo that comes twice.
    """
    readers = {".csv": _csv_rows, ".yaml": _yaml_rows, ".yml": _yaml_rows}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise ConfigError(f"pose file {path} must end in .csv, .yaml or .yml")
    poses: dict[str, PhotoPose] = {}
    for place, row in reader(path):
        pose = checked(PhotoPose, row, place)
        if pose.name in poses:
            raise ConfigError(f"{place}: {pose.name} comes twice")
        poses[pose.name] = pose
    if not poses:
        raise ConfigError(f"pose file {path} has no rows")
    return poses


def _csv_rows(path: Path) -> list[tuple[str, dict[str, Any]]]:
    lines = io.StringIO(read_text(path, LARGEST_TABLE, ConfigError, "utf-8-sig"), newline="")
    try:
        reader = csv.DictReader((line for line in lines if line.strip()), skipinitialspace=True, strict=True)
        columns = [name.strip() for name in reader.fieldnames or []]
        unknown = sorted(set(columns) - PhotoPose.model_fields.keys())
        if unknown or len(set(columns)) < len(columns):
            raise ConfigError(
                f"pose file {path}: columns {', '.join(unknown) or 'that come twice'} are not known; "
                f"known: {', '.join(PhotoPose.model_fields)}"
            )
        reader.fieldnames = columns
        rows = []
        for number, row in enumerate(reader, start=1):
            place = f"{path}, row {number}"
            if None in row or None in row.values():
                raise ConfigError(f"{place}: has more or fewer values than the header's {len(columns)} columns")
            rows.append((place, {name: value.strip() for name, value in row.items() if value.strip()}))
        return rows
    except csv.Error as error:
        raise ConfigError(f"{path}: cannot be read as CSV ({error})") from error


def _yaml_rows(path: Path) -> list[tuple[str, dict[str, Any]]]:
    content = read_yaml(path)
    if not isinstance(content, list) or not all(isinstance(row, dict) for row in content):
        raise ConfigError(f"pose file {path} must be a YAML list of mappings, one a photo, each with a name")
    return [(f"{path}, entry {number}", row) for number, row in enumerate(content, start=1)]
