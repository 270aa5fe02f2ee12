"""Read and write the files of `ltm pose`: control points, initial guess, fitted pose file and report."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ltm_core.base.errors import ConfigError, PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, scale_problem
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import sigma_keys
from ltm_core.pose_estimation.points.control_points import ControlPoints
from ltm_core.pose_estimation.points.resection import Resection
from ltm_core.raster.dem import Dem
from ltm_core.storage.config_io import LARGEST_TABLE, read_text
from ltm_core.tracing.trace_io import GuessConfig, near_frame, write_pose_file

_COLUMNS: dict[str, Sequence[str]] = {
    "x": ("lon", "longitude", "x", "x_e", "e", "east", "easting", "map_x", "world_x"),
    "y": ("lat", "latitude", "y", "y_n", "n", "north", "northing", "map_y", "world_y"),
    "z": ("z", "h", "height", "elevation", "elev", "altitude", "alt", "map_z", "world_z"),
    "u": ("u", "col", "column", "px", "pixel_x", "x_pixel", "x_px", "image_x", "x_image", "im_x"),
    "v": ("v", "row", "line", "py", "pixel_y", "y_pixel", "y_px", "image_y", "y_image", "im_y"),
}


@dataclass(frozen=True)
class ResectionSetup:
    """Initial guess in a map frame; `dem` only if one was given."""

    frame: SiteFrame
    camera: Camera
    position: Float64Array
    angles_deg: tuple[float, float, float] | None
    """Azimuth from grid north, pitch and roll in degrees; None: unknown."""
    dem: Dem | None


def set_up_resection(guess: GuessConfig, dem: Dem | None, crs: str | None) -> ResectionSetup:
    """Place the guess in the DEM's CRS, or without a DEM in `crs`, which is then that of its position too. Raises
    ConfigError if a DEM or a CRS is missing, and as `set_up_picture`."""
    pose = guess.pose
    if dem is not None:
        frame, local = near_frame(guess, dem)
        position = pose.position(local, frame)
    else:
        crs = crs or pose.crs
        local = None
        if crs is None:
            raise ConfigError("the control points have no CRS: give --crs EPSG:... or --dem")
        if pose.z is None:
            raise ConfigError("a height above the ground needs a DEM: give z, or --dem")
        x, y = pose.xy(SiteFrame(crs)) or (0.0, 0.0)
        frame = SiteFrame(crs, round(x / 1000) * 1000.0, round(y / 1000) * 1000.0)
        problem = scale_problem(crs, GridGeometry(frame.x_origin - 500, frame.y_origin + 500, 1000.0, 1, 1))
        if problem is not None and pose.xy(frame) is not None:
            raise ConfigError(f"the camera's position: {problem}")
        position = (x - frame.x_origin, y - frame.y_origin, pose.z)
    azimuth = pose.grid_azimuth_deg(frame, position, None)
    angles = None if azimuth is None else (azimuth, pose.pitch_deg or 0.0, pose.roll_deg or 0.0)
    return ResectionSetup(frame, guess.calibration.camera(), np.array(position), angles, local)


def read_control_points(path: Path | str, frame: SiteFrame, first_pixel: float = 0.0) -> ControlPoints:
    """Read a CSV (commas, semicolons or tabs) with a header row: a name, map coordinates, pixel.

    Columns (any case, `_COLUMNS`): id; x, y in the frame's CRS, or lon, lat in degrees; z; u (column) and v (row).
    `first_pixel`: the number of the first pixel's centre in the file: 0 here and in OpenCV, 1 in Matlab, 0.5 where
    pixels are counted by their corners. Raises PoseError naming file, line and column."""
    names, values = read_point_rows(path, frame, first_pixel)
    return ControlPoints(names, values[:, :3], values[:, 3:5])


def read_point_rows(
    path: Path | str, frame: SiteFrame, first_pixel: float = 0.0, further: Mapping[str, Sequence[str]] = {}
) -> tuple[tuple[str, ...], Float64Array]:
    """Return names (N,) and rows (N, 5 + F) of a CSV as above: map x, y, z, pixel u, v, then the columns `further`,
    each by its possible names. Raises PoseError as `read_control_points` does."""
    names, values, columns = read_rows(path, {**_COLUMNS, **further}, "id, x, y, z, u, v or id, lon, lat, z, u, v")
    x, y = values[:, 0], values[:, 1]
    degrees = [columns["x"].lower().startswith("lon"), columns["y"].lower().startswith("lat")]
    if degrees[0] != degrees[1]:
        raise PoseError(f"{path}: columns {columns['x']} and {columns['y']}; give lon and lat, or x and y")
    if degrees[0]:
        x, y = frame.from_lonlat(x, y)
    else:
        x, y = x - frame.x_origin, y - frame.y_origin
    return names, np.column_stack([x, y, values[:, 2], values[:, 3:5] - first_pixel, values[:, 5:]])


def read_rows(
    path: Path | str, wanted: Mapping[str, Sequence[str]], needed: str
) -> tuple[tuple[str, ...], Float64Array, dict[str, str]]:
    """Return the names (N,) of the rows of a CSV as above, the numbers (N, K) of the columns `wanted`, each by its
    possible names, and the column of each. A row without a name has the number of its line. `needed`: the columns, for
    the PoseError, which names file, line and column."""
    path, rows = Path(path), []
    lines = io.StringIO(read_text(path, LARGEST_TABLE, PoseError, "utf-8-sig"), newline="")
    try:
        header = lines.getvalue().partition("\n")[0]
        reader = csv.DictReader(lines, delimiter=max(",;\t", key=header.count))
        given = {(name or "").strip().lower(): name for name in reader.fieldnames or []}
        every = {"name": ("id", "name", "point", "label", "gcp"), **wanted}
        columns = {key: next((given[name] for name in names if name in given), "") for key, names in every.items()}
        if absent := [key for key in wanted if not columns[key]]:
            found = ", ".join(given.values()) or "an empty header"
            raise PoseError(f"{path}: no column {', '.join(map(repr, absent))} in {found}; the file needs {needed}")
        for row in reader:
            name = (row.get(columns["name"]) or "").strip() or str(reader.line_num)
            place = f"{path}, line {reader.line_num}", name
            rows.append((name, [_number(row[columns[key]], columns[key], *place) for key in wanted]))
    except csv.Error as error:
        raise PoseError(f"{path}: not a CSV file ({error})") from error
    if not rows:
        raise PoseError(f"{path}: contains no row below its header")
    return tuple(name for name, _ in rows), np.array([numbers for _, numbers in rows]), columns


def _number(text: str | None, column: str, place: str, name: str) -> float:
    try:
        return float(text)  # type: ignore[arg-type] # of a short row, None: an error as well
    except (TypeError, ValueError):
        raise PoseError(f"{place}: {column} is {text!r}, not a number (point {name})") from None


def write_pose(path: Path | str, result: Resection, guess: GuessConfig, frame: SiteFrame) -> None:
    """Write a pose file for `ltm trace`, with the method in its comments."""
    notes = [
        f"Resection from {len(result.used)} control points: median residual {result.median_px:.2f} px.",
        "Standard deviations: " + ", ".join(f"{name} {value:.3g}" for name, value in result.sigmas.items()),
        *(f"{name} was fixed: {reason}" for name, reason in result.held.items()),
    ]
    if result.outliers:
        notes.append(f"Left out as outliers: {', '.join(result.outliers)}")
    sigmas = sigma_keys(result.pose, result.pose_covariance)
    rays = guess.curvature, guess.refraction
    write_pose_file(path, result.camera, result.pose, sigmas, rays, frame, notes)


def held_notes(result: Resection) -> list[str]:
    """Return a line for each parameter that should be fitted but is fixed, with the remedy."""
    notes = [f"{name} is fixed: {reason}" for name, reason in result.held.items()]
    if result.bending is not None:
        term, trend = result.bending
        notes.append(
            f"the residuals bend with the radius: the lens has a {term} of about {trend.k:.2g} +- {trend.sigma:.1g}; "
            "--free lens fits it"
        )
    return notes


def write_report(path: Path | str, result: Resection) -> None:
    """Write residuals, sigmas and the pose's covariance as JSON."""
    marks = zip(result.points.names, result.points.pixels, result.residuals, result.used, strict=True)
    points = [
        {"name": name, "u": u, "v": v, "du_px": _finite(du), "dv_px": _finite(dv), "used": bool(used)}
        for name, (u, v), (du, dv), used in marks
    ]
    content = {
        "median_residual_px": _finite(result.median_px),
        "sigma_px": result.sigma_px,
        "fitted": ["angles", *result.fitted],
        "held": result.held,
        "bending": {"term": result.bending[0], **asdict(result.bending[1])} if result.bending else None,
        "sigmas": result.sigmas,
        "pose_covariance": result.pose_covariance.tolist(),
        "points": points,
    }
    Path(path).write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
