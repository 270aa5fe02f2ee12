"""Reads a real site with later surveys: a USGS remote camera over a sandbar in Grand Canyon (sandbar_seg, rm22).

One fixed camera whose photos are registered to one view, and topographic surveys of the bar at 1 m on the same dates.
The control points carry no height: they lie at the bar's edge, and take that of the nearest survey node of their date.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pose_estimation.points.control_points import ControlPoints
from ltm_core.pose_estimation.points.resection import Resection, resect
from ltm_core.raster.dem import Dem
from ltm_core.storage.image_io import read_rgb

FRAME = SiteFrame("EPSG:26949", 227_000.0, 622_000.0)
SURVEYS = ("111006", "121004", "130922", "140925", "150924")
PHOTOS = {
    "130922": "RC0220Ra_20130922_1353_reg.jpg",
    "140925": "RC0220Ra_20140925_1342.JPG_reg.jpg",
    "150924": "RC0220Ra_20150924_1141.JPG_reg.jpg",
}
POSITION = (515.424, 474.549, 914.0)
"""As the source states it; its height is that of the hard points beside it and a tripod."""
STATED = Camera(3888, 2592, 22 / 22.2 * 3888, 22 / 22.2 * 3888, 1943.5, 1295.5)
"""22 mm on a sensor of 22.2 mm."""
CLICK_SIGMA = 20.0
"""Pixels: the points were clicked on a photo and an orthophoto of other days."""
_NEAR = 5.0
"""Metres from a control point to the survey node that lends its height."""


@dataclass(frozen=True, eq=False)
class Canyon:
    """Surveys by date, on one grid in the map frame; photos by date, (H, W, 3) read when asked; the fitted camera."""

    folder: Path
    surveys: dict[str, Dem]
    resection: Resection

    def photo(self, date: str, step: int) -> UInt8Array:
        """Every step-th pixel of a date's photo."""
        return np.ascontiguousarray(read_rgb(self.folder / PHOTOS[date])[::step, ::step])


def read_canyon(folder: Path | str) -> Canyon:
    """Raises ConfigError where files are missing, RasterError and PoseError as their readers do."""
    folder = Path(folder)
    missing = [name for name in (*PHOTOS.values(), "gcps.csv") if not (folder / name).is_file()]
    if missing:
        raise ConfigError(f"{folder}: lacks {', '.join(missing)}; it must be the folder of the site rm22")
    read = {date: Dem.open(folder / f"22_{date}_GRID.tif", "EPSG:26949").in_frame(FRAME) for date in SURVEYS}
    grid = _common(list(read.values()))
    surveys = {date: Dem(_on(dem, grid), grid) for date, dem in read.items()}
    points = _control_points(folder / "gcps.csv", read)
    return Canyon(folder, surveys, resect(points, STATED, POSITION, free=(), sigma_px=CLICK_SIGMA, position_sigma=2.0))


def _common(dems: list[Dem]) -> GridGeometry:
    bounds = np.array([dem.geometry.bounds for dem in dems])
    (x_min, y_min), (x_max, y_max) = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    return GridGeometry(float(x_min), float(y_max), 1.0, round(x_max - x_min), round(y_max - y_min), FRAME.crs)


def _on(dem: Dem, grid: GridGeometry) -> Float32Array:
    """The nodes of all surveys coincide: a copy into the larger grid."""
    heights = np.full(grid.shape, np.nan, np.float32)
    row, col = round(grid.y_max - dem.geometry.y_max), round(dem.geometry.x_min - grid.x_min)
    heights[row : row + dem.geometry.height, col : col + dem.geometry.width] = dem.elevation
    return heights


def _control_points(path: Path, surveys: dict[str, Dem]) -> ControlPoints:
    """Those within reach of their date's survey, each place and pixel once."""
    names: list[str] = []
    places: list[tuple[float, float, float]] = []
    pixels: list[tuple[float, float]] = []
    with path.open(newline="", encoding="utf-8") as file:
        for number, row in enumerate(csv.DictReader(file)):
            dem = surveys[row["survey_grid"][3:9]]
            x, y = float(row["e"]) - FRAME.x_origin, float(row["n"]) - FRAME.y_origin
            rows, cols = np.nonzero(np.isfinite(dem.elevation))
            node_x, node_y = dem.geometry.to_map(rows, cols)
            away = np.hypot(node_x - x, node_y - y)
            nearest = int(np.argmin(away))
            pixel = float(row["u"]), float(row["v"])
            if away[nearest] <= _NEAR and pixel not in pixels and (x, y) not in [place[:2] for place in places]:
                names.append(f"gcp{number}")
                places.append((x, y, float(dem.elevation[rows[nearest], cols[nearest]])))
                pixels.append(pixel)
    return ControlPoints(tuple(names), np.array(places), np.array(pixels))
