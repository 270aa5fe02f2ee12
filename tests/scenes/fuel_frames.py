"""A site without pictures, and frames of votes on it that a number makes: the same number, the same frame."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_lab.resources import lab_config
from ltm_msgs_py.pointcloud import votes_to_msg

NAME = "kept"
CAMERAS = ("north", "east", "south")
BEGIN_NS = 1_700_000_000_000_000_000
PERIOD_NS = 60 * 10**9
LABELS = LabelSet.load()


def write_site(folder: Path, **changes: Any) -> Path:
    """A hill of 2.1 x 2.7 km in `folder`; path of the site file."""
    rows, cols = np.mgrid[:70, :90]
    elevation = (300 + 80 * np.exp(-((rows - 30) ** 2 + (cols - 50) ** 2) / 400)).astype(np.float32)
    Dem(elevation, GridGeometry(480_015.0, 4_150_915.0, 30.0, 90, 70, "EPSG:26911")).save(folder / "dem.tif")
    site = {
        "name": NAME,
        "crs": "EPSG:26911",
        "origin": [480_015.0, 4_148_815.0],
        "dem": {"path": "dem.tif"},
        "possible_ground": {"highest": 0.0},
        "cameras": {camera: {} for camera in CAMERAS},
        "nodes": {"fuel_map": {"max_behind": 1e9}},  # frames of years ago are sent to graphs that live today
    }
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(site | changes), encoding="utf-8")
    return path


def grid_of(site_path: Path) -> GridGeometry:
    site = load_site(site_path)
    return site.fuel_geometry(site.open_dem())


def camera_of(number: int) -> str:
    return CAMERAS[number % len(CAMERAS)]


def stamp_of_frame(number: int) -> int:
    return BEGIN_NS + number * PERIOD_NS + number


def votes(number: int, grid: GridGeometry, stamp_ns: int | None = None) -> CellVotes:
    """Some hundred cells of a camera, in patches of covers that change over the years of a test."""
    rng = np.random.default_rng(number)
    height, width = 24, 31
    row, col = rng.integers(0, grid.height - height), rng.integers(0, grid.width - width)
    seen = np.flatnonzero(rng.random(height * width) < 0.5)
    rows, cols = (row + seen // width).astype(np.int32), (col + seen % width).astype(np.int32)
    counts = np.zeros((len(seen), len(LABELS)), np.uint32)
    cover = 1 + (rows // 9 + cols // 13 + number // 200) % 6
    counts[np.arange(len(seen)), cover] = rng.integers(1, 60, len(seen))

    def column(low: float, high: float) -> Any:
        return rng.uniform(low, high, len(seen)).astype(np.float32)

    visibility = CellVisibility(column(0.1, 0.9), column(1, 40), column(0, 60), column(0, 30), column(0, 6.2))
    stamp = stamp_of_frame(number) if stamp_ns is None else stamp_ns
    return CellVotes(grid, rows, cols, counts, column(300, 380), stamp, camera_of(number), column(0.3, 1), visibility)


def message(number: int, grid: GridGeometry, stamp_ns: int | None = None) -> Any:
    return votes_to_msg(votes(number, grid, stamp_ns), LABELS.names)


def write_grass_site(folder: Path) -> Path:
    """The site of `write_site` with a prior of grass (102) everywhere, and errors whose correlation is known."""
    plain = write_site(folder)
    grid = load_site(plain).in_crs(grid_of(plain))
    write_geotiff(folder / "prior.tif", np.full(grid.shape, 102, np.int16), grid, -9999)
    errors = yaml.safe_load(lab_config("assumed_labels.yaml").read_text())
    errors["correlation"] = {"cell": 0.28, "stand": 0.1, "view": 0.11, "network": 0.05}
    (folder / "errors.yaml").write_text(yaml.safe_dump(errors))
    return write_site(folder, fuel={"prior": "prior.tif"}, expert={"fuel": {"label_errors": "errors.yaml"}})
