"""The true canopy of a simulated date by fuel cell, worked out by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from ltm_core.base.errors import RecordingError
from ltm_lab.evaluation.fuel.canopy_truth_io import read_canopy_truth

EAST, NORTH = 380_000.0, 3_806_300.0


def write(path: Path, values: np.ndarray, cell: float, west: float, north: float) -> None:
    height, width = values.shape
    with rasterio.open(
        path, "w", "GTiff", width, height, 1, "EPSG:32611", from_origin(west, north, cell, cell), values.dtype
    ) as file:
        file.write(values, 1)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A site of 100 x 80 m whose corner lies 10 m east and 20 m south of that of its grid of 30 m cells."""
    place = tmp_path / "truth" / "after"
    place.mkdir(parents=True)
    index = {"scenario": "x", "crs": "EPSG:32611", "origin": [EAST, NORTH], "curvature": False, "frames": []}
    (tmp_path / "frames.json").write_text(json.dumps(index))
    canopy, classes = np.zeros((80, 100), np.float32), np.full((80, 100), 3, np.uint8)
    # Cell (1, 1) is rows 10 to 39 and columns 20 to 49 of the site.
    canopy[10:25, 20:50] = 8.0
    canopy[25:40, 20:30] = 12.0
    canopy[25:40, 30:40] = 1.5
    canopy[25:40, 40:50], classes[25:40, 40:50] = 9.0, 2
    write(place / "canopy.tif", canopy, 1.0, EAST + 10, NORTH - 20)
    write(place / "class.tif", classes, 1.0, EAST + 10, NORTH - 20)
    forms = np.full((4, 4), 1, np.uint8)
    forms[1, 1] = 3
    write(place / "life_form.tif", forms, 30.0, EAST, NORTH)
    return tmp_path


def test_trees_of_two_metres_and_more_count(folder: Path) -> None:
    found = read_canopy_truth(folder, "after")
    assert (found.grid.x_min, found.grid.y_max, found.grid.resolution) == (0.0, 0.0, 30.0)
    assert np.argwhere(found.trees).tolist() == [[1, 1]]
    assert found.cover[1, 1] == pytest.approx(100 * 600 / 900)
    assert found.height[1, 1] == pytest.approx((450 * 8.0 + 150 * 12.0) / 600)
    whole = np.isfinite(found.cover)
    assert np.argwhere(whole).tolist() == [[1, 1], [1, 2], [2, 1], [2, 2]]


def test_what_is_missing_is_named(folder: Path) -> None:
    (folder / "truth" / "after" / "class.tif").unlink()
    with pytest.raises(RecordingError, match=r"class\.tif: no raster of a simulated site's truth"):
        read_canopy_truth(folder, "after")
