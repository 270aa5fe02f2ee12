import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from rasterio.transform import Affine, from_origin

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.fuel.class_map import read_fuel_map, snapped_grid, write_fuel_map
from ltm_core.fuel.export.export_grid import GridTransfer
from ltm_core.geometry.grid import GridGeometry
from ltm_core.vision.labels import LabelSet

LABELS = LabelSet.load()
GRID = GridGeometry(345_975.0, 3_783_075.0, 30.0, 5, 3, "EPSG:32611")
CLASSES = np.array([[1, 2, 3, 4, 255], [255, 5, 6, 1, 2], [3, 3, 255, 2, 1]], np.uint8)


def test_as_rasterio_reads_it(tmp_path: Path) -> None:
    assert write_fuel_map(tmp_path / "fuel.tif", CLASSES, GRID, LABELS) == tmp_path / "fuel.tif"
    with rasterio.open(tmp_path / "fuel.tif") as source:
        np.testing.assert_array_equal(source.read(1), CLASSES)
        assert tuple(source.bounds) == GRID.bounds
        assert (source.nodata, source.crs.to_epsg(), source.dtypes) == (255, 32611, ("uint8",))
        assert [source.colormap(1)[i][:3] for i in range(len(LABELS))] == list(LABELS.colors)
        assert json.loads(source.tags()["classes"]) == list(LABELS.names)
    assert [p.name for p in tmp_path.iterdir()] == ["fuel.tif"]


def test_a_map_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    path = write_fuel_map(tmp_path / "fuel.tif", CLASSES, GRID, LABELS)
    before = path.read_bytes()
    with pytest.raises(RasterError, match="does not fit"):
        write_fuel_map(path, CLASSES[:2], GRID, LABELS)
    assert path.read_bytes() == before


def test_no_place_to_write(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="export_path"):
        write_fuel_map("", CLASSES, GRID, LABELS)
    with pytest.raises(ConfigError, match=r"absent does not exist; create it first"):
        write_fuel_map(tmp_path / "absent/fuel.tif", CLASSES, GRID, LABELS)
    (tmp_path / "folder.tif").mkdir()
    with pytest.raises(ConfigError, match=r"folder\.tif: cannot be written"):
        write_fuel_map(tmp_path / "folder.tif", CLASSES, GRID, LABELS)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.tif"]


def test_another_nodata_value_is_unseen(tmp_path: Path) -> None:
    stored = np.where(CLASSES == 255, 99, CLASSES).astype(np.uint8)
    write(tmp_path / "f.tif", stored, nodata=99)
    np.testing.assert_array_equal(read_fuel_map(tmp_path / "f.tif")[0], CLASSES)


def write(path: Path, array: np.ndarray, **options: Any) -> None:
    height, width = array.shape
    profile = {"crs": GRID.crs, "transform": GRID.transform()} | options
    with rasterio.open(
        path, "w", driver="GTiff", width=width, height=height, count=1, dtype=array.dtype, **profile
    ) as sink:
        sink.write(array, 1)


@pytest.mark.parametrize(
    ("dtype", "options", "message"),
    [
        ("int16", {}, "uint8 with a CRS, this is int16"),
        ("uint8", {"crs": None}, "uint8 with a CRS"),
        ("uint8", {"transform": from_origin(0, 90, 30, 10)}, "square cells"),
        ("uint8", {"transform": Affine(30, 0, 0, 0, 30, 0)}, "north-up"),
        ("uint8", {"transform": Affine(29, 5, 0, 5, -29, 0)}, "north-up"),
    ],
)
def test_other_rasters_are_refused(tmp_path: Path, dtype: str, options: dict[str, Any], message: str) -> None:
    write(tmp_path / "f.tif", CLASSES.astype(dtype), **options)
    with pytest.raises(RasterError, match=message):
        read_fuel_map(tmp_path / "f.tif")


def test_on_landfires_grid() -> None:
    rng = np.random.default_rng(2)
    classes = rng.integers(1, 7, (40, 60)).astype(np.uint8)
    classes[:10, :15] = 255
    source = GridGeometry(345_975.0, 3_784_245.0, 30.0, 60, 40, "EPSG:32611")
    target = snapped_grid(source, "EPSG:5070")
    result = GridTransfer(source, target).layer(classes, 255)
    assert (target.x_min % 30, target.y_max % 30, target.resolution, target.crs) == (15.0, 15.0, 30.0, "EPSG:5070")
    # Each cell's centre, taken back: the class of the cell that it falls into.
    rows, cols = np.indices(target.shape)
    x, y = Transformer.from_crs("EPSG:5070", "EPSG:32611", always_xy=True).transform(*target.to_map(rows, cols))
    row, col = source.cell_of(x, y)
    inside = source.contains(row, col)
    expected = np.full(target.shape, 255, np.uint8)
    expected[inside] = classes[row[inside], col[inside]]
    np.testing.assert_array_equal(result, expected)
    assert inside.sum() == pytest.approx(classes.size, rel=0.02)
    assert set(np.unique(result)) == {1, 2, 3, 4, 5, 6, 255}


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:2229", "nonsense"])
def test_no_grid_of_metres(crs: str) -> None:
    with pytest.raises(ConfigError, match=crs):
        snapped_grid(GRID, crs)
