"""Read pose files: known values of each photo, as CSV or YAML, which override EXIF."""

from __future__ import annotations

import csv
import io
from datetime import datetime
from pathlib import Path
from typing import Any

from pydantic import Field

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import StrictModel
from ltm_core.cameras.camera_config import PartialCalibration, PartialPose
from ltm_core.site.site import RosName
from ltm_core.storage.config_io import checked, read_yaml
from ltm_core.storage.text_io import LARGEST_TABLE, read_text

POSES = "poses.csv"
"""Name of the pose file beside photos that were written upright."""

_SECTIONS: dict[str, type[StrictModel]] = {"pose": PartialPose, "calibration": PartialCalibration}


class PhotoPose(StrictModel):
    """Known values of one photo; others come from the site file's camera, or from EXIF.

    `pose` and `calibration` are those of a site file. In a CSV their keys are columns beside `name`.
    """

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
    """Return rows by photo name, from a CSV with a header line or a YAML list of mappings; or by the photos' names
    without suffix, from a folder of pose files, as `ltm pose photo` writes it.

    Raises ConfigError: missing file, another file type, unknown columns, invalid or contradictory values (with the
    line), or a photo listed twice.
    """
    if path.is_dir():
        return _pose_files(path)
    readers = {".csv": _csv_rows, ".yaml": _yaml_rows, ".yml": _yaml_rows}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise ConfigError(f"pose file {path} must end in .csv, .yaml or .yml")
    poses: dict[str, PhotoPose] = {}
    unnamed = _SECTIONS if path.suffix.lower() == ".csv" else ()
    for place, row in reader(path):
        pose = checked(PhotoPose, row, place, unnamed=unnamed)
        if pose.name in poses:
            raise ConfigError(f"{place}: {pose.name} is listed twice")
        poses[pose.name] = pose
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


def _csv_rows(path: Path) -> list[tuple[str, dict[str, Any]]]:
    lines = io.StringIO(read_text(path, LARGEST_TABLE, ConfigError, "utf-8-sig"), newline="")
    try:
        reader = csv.DictReader((line for line in lines if line.strip()), skipinitialspace=True, strict=True)
        header = [name.strip() for name in reader.fieldnames or []]
        unknown = sorted(set(header) - set(columns()))
        if unknown or len(set(header)) < len(header):
            raise ConfigError(
                f"pose file {path}: unknown columns {', '.join(unknown) or '(duplicates)'}; known: "
                f"{', '.join(columns())}"
            )
        reader.fieldnames = header
        rows = []
        for number, row in enumerate(reader, start=1):
            place = f"{path}, row {number}"
            if None in row or None in row.values():
                raise ConfigError(f"{place}: the number of values differs from the header's {len(header)} columns")
            rows.append((place, _sectioned({name: value.strip() for name, value in row.items() if value.strip()})))
        return rows
    except csv.Error as error:
        raise ConfigError(f"{path}: cannot be read as CSV ({error})") from error


def _sectioned(row: dict[str, str]) -> dict[str, Any]:
    """Group the columns of a row by section."""
    content: dict[str, Any] = {name: value for name, value in row.items() if name in PhotoPose.model_fields}
    for section, model in _SECTIONS.items():
        if values := {name: value for name, value in row.items() if name in model.model_fields}:
            content[section] = values
    return content


def _yaml_rows(path: Path) -> list[tuple[str, dict[str, Any]]]:
    content = read_yaml(path)
    if not isinstance(content, list) or not all(isinstance(row, dict) for row in content):
        raise ConfigError(f"pose file {path} must be a YAML list of mappings, one per photo, each with a name")
    return [(f"{path}, entry {number}", row) for number, row in enumerate(content, start=1)]
