"""Read landmarks and photos of a mount's presets; store the state of a mount across restarts."""

import csv
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError

from ltm_core.base.errors import ConfigError, PoseError, StoreError
from ltm_core.base.strict_model import StrictModel
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_core.pose_estimation.mount.mount_watch import MountState, MountWatch
from ltm_core.pose_estimation.points.control_points import PtzPoints
from ltm_core.pose_estimation.points.resection_io import read_point_rows, read_rows
from ltm_core.storage.config_io import read_text
from ltm_core.storage.disk_io import written_whole

READING_COLUMNS: dict[str, Sequence[str]] = {"pan": ("pan_deg", "pan"), "tilt": ("tilt_deg", "tilt"), "zoom": ("zoom",)}


def read_ptz_points(path: Path | str, frame: SiteFrame, first_pixel: float = 0.0) -> PtzPoints:
    """Return the control points as `read_control_points` reads them, with three further columns: pan_deg, tilt_deg and
    zoom of the image in which each is marked. One place may be marked in several images. Raises PoseError."""
    names, rows = read_point_rows(path, frame, first_pixel, READING_COLUMNS)
    return PtzPoints(names, rows[:, :3], rows[:, 3:5], rows[:, 5:8])


def read_readings(path: Path | str) -> dict[str, tuple[float, float, float]]:
    """Return the pan (deg), tilt (deg) and zoom by the image's name, of a CSV with the columns name, pan_deg, tilt_deg,
    zoom, as `ltm cameras snapshot` writes it. Raises PoseError naming file, line and column."""
    names, values, columns = read_rows(path, READING_COLUMNS, "name, pan_deg, tilt_deg, zoom")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice or not columns["name"] or not np.isfinite(values).all():
        fault = f"repeated names: {', '.join(twice)}" if twice else "a name is missing, or a number is not finite"
        raise PoseError(f"{path}: {fault}; readings need name, pan_deg, tilt_deg, zoom, one row per image")
    return {name: (pan, tilt, zoom) for name, (pan, tilt, zoom) in zip(names, values.tolist(), strict=True)}


def append_reading(path: Path, name: str, pan_deg: float, tilt_deg: float, zoom: float) -> None:
    """Append one line, after a header line in a new file."""
    new = not path.exists()
    with path.open("a", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(("name", "pan_deg", "tilt_deg", "zoom"))
        writer.writerow((name, f"{pan_deg:.6g}", f"{tilt_deg:.6g}", f"{zoom:.6g}"))


_LAYOUT = 1
_LARGEST = 64 << 10
_ROUNDING = 1e-6  # share of the largest eigenvalue of a covariance by which the smallest may be negative
_Three = tuple[float, float, float]
_Angle = Annotated[float, Field(ge=-7.0, le=7.0)]  # angle in radians


class _Memory(StrictModel):
    layout: int = _LAYOUT
    terms: str
    """Terms for which the state is valid (`mount_terms`)."""
    state: MountState
    reason: str = Field(max_length=2000)
    rotation: tuple[_Angle, _Angle, _Angle]
    angles: tuple[_Three, _Three, _Three] | None
    tilt_zero: _Angle
    tilt_covariance: tuple[float, float, float, float]


def memory_file(folder: Path, camera: str) -> Path:
    return folder / f"mount_{camera}.json"


def write_memory(path: Path, watch: MountWatch, terms: str) -> None:
    """Replace the previous file atomically. Raises StoreError."""
    c = watch.correction
    values = {"rotation": c.rotation, "angles": c.angles, "tilt_covariance": c.tilt_covariance}
    memory = _Memory(
        terms=terms,
        state=watch.state,
        reason=watch.reason[:2000],
        tilt_zero=c.tilt_zero,
        **{key: None if value is None else value.tolist() for key, value in values.items()},
    )
    try:
        path.parent.mkdir(exist_ok=True)
        with written_whole(path) as partial, partial.open("w", encoding="utf-8") as file:
            file.write(memory.model_dump_json(indent=1))
            file.flush()
            os.fsync(file.fileno())
    except (ConfigError, OSError) as error:
        raise StoreError(f"{path}: cannot save the state of the mount ({error})") from error


def recall_memory(path: Path, watch: MountWatch, terms: str) -> bool:
    """Restore the state of a mount; return False if none is kept for these terms. Raises StoreError for a bad file."""
    if not path.exists():
        return False
    try:
        memory = _Memory.model_validate_json(read_text(path, _LARGEST, StoreError))
    except ValidationError as error:
        raise StoreError(f"{path}: not a valid mount state ({error.error_count()} errors); remove it") from error
    if memory.layout != _LAYOUT or memory.terms != terms:
        return False
    angles = None if memory.angles is None else np.array(memory.angles)
    if angles is not None:  # no slip could be detected against sigmas that are not finite
        joint = np.zeros((4, 4))
        joint[:3, :3], joint[3], joint[:, 3] = angles, memory.tilt_covariance, memory.tilt_covariance
        values = np.linalg.eigvalsh((joint + joint.T) / 2)
        slack = _ROUNDING * values[-1]
        if not (values[0] >= -slack and np.abs(joint - joint.T).max() <= slack):
            raise StoreError(f"{path}: its angles and tilt_covariance are not a covariance; remove it")
    tilt = memory.tilt_zero, np.array(memory.tilt_covariance)
    watch.become(memory.state, PoseCorrection(np.array(memory.rotation), angles, *tilt), memory.reason)
    return True
