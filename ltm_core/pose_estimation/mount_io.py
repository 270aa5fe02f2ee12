"""Reads landmarks and pictures of a pan-tilt-zoom head's presets, with what its encoders said."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path

from ltm_core.errors import PoseError
from ltm_core.geodesy import SiteFrame
from ltm_core.pose_estimation.control_points import HeadPoints
from ltm_core.pose_estimation.resection_io import read_point_rows
from ltm_core.text_io import LARGEST_TABLE, read_text

READING_COLUMNS: dict[str, Sequence[str]] = {
    "pan": ("pan_deg", "pan"),
    "tilt": ("tilt_deg", "tilt"),
    "zoom": ("zoom",),
}


def read_head_points(path: Path | str, frame: SiteFrame, first_pixel: float = 0.0) -> HeadPoints:
    """Control points as `read_control_points` reads them, with three further columns: pan_deg, tilt_deg and zoom of the
    picture in which each is marked. One place may be marked in several pictures. Raises PoseError."""
    names, rows = read_point_rows(path, frame, first_pixel, READING_COLUMNS)
    return HeadPoints(names, rows[:, :3], rows[:, 3:5], rows[:, 5:8])


def read_readings(path: Path | str) -> dict[str, tuple[float, float, float]]:
    """Pan (deg), tilt (deg) and zoom by the picture's name, of a CSV with the columns name, pan_deg, tilt_deg, zoom, as
    `ltm cameras snapshot` writes it. Raises PoseError naming file, line and column."""
    path = Path(path)
    reader = csv.DictReader(io.StringIO(read_text(path, LARGEST_TABLE, PoseError, "utf-8-sig"), newline=""))
    found: dict[str, tuple[float, float, float]] = {}
    try:
        given = {(name or "").strip().lower(): name for name in reader.fieldnames or []}
        columns = {"name": given.get("name")}
        columns |= {key: next((given[n] for n in names if n in given), None) for key, names in READING_COLUMNS.items()}
        lacking = [key for key, column in columns.items() if column is None]
        if lacking:
            raise PoseError(f"{path}: no column {', '.join(lacking)}; readings need name, pan_deg, tilt_deg, zoom")
        for row in reader:
            name = (row[columns["name"] or ""] or "").strip()
            place = f"{path}, line {reader.line_num}"
            if not name or name in found:
                raise PoseError(f"{place}: {'the name ' + name + ' stands twice' if name else 'no name'}")
            pan, tilt, zoom = (_number(row[columns[key] or ""], key, place) for key in READING_COLUMNS)
            found[name] = pan, tilt, zoom
    except csv.Error as error:
        raise PoseError(f"{path}: not a CSV file ({error})") from error
    if not found:
        raise PoseError(f"{path}: holds no reading")
    return found


def append_reading(path: Path, name: str, pan_deg: float, tilt_deg: float, zoom: float) -> None:
    """One line more, below a head line that is written first."""
    new = not path.exists()
    with path.open("a", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(("name", "pan_deg", "tilt_deg", "zoom"))
        writer.writerow((name, f"{pan_deg:.6g}", f"{tilt_deg:.6g}", f"{zoom:.6g}"))


def _number(text: str | None, column: str, place: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise PoseError(f"{place}: {column} is {text!r}, not a number")
    return value
