from pathlib import Path

import pytest
import rasterio.shutil
from rasterio.transform import from_origin

from ltm_core.base.errors import RasterError
from ltm_core.fuel.class_map import read_fuel_map
from ltm_core.raster.dem import Dem, read_around


def sparse(path: Path, side: int, dtype: str) -> Path:
    """A GeoTIFF of some kilobytes that states `side` x `side` cells."""
    options = {"tiled": True, "blockxsize": 4096, "blockysize": 4096, "sparse_ok": True, "compress": "deflate"}
    with rasterio.open(
        path, "w", driver="GTiff", width=side, height=side, count=1, dtype=dtype, crs="EPSG:26911",
        transform=from_origin(480_000.0, 4_150_000.0, 1.0, 1.0), **options,
    ):  # fmt: skip
        pass
    return path


def test_a_raster_that_its_file_cannot_hold_is_not_read(tmp_path: Path) -> None:
    file = sparse(tmp_path / "dem.tif", 30_000, "float32")
    assert file.stat().st_size < 100_000
    with pytest.raises(RasterError, match=r"dem\.tif: states 30000 x 30000 cells in a file of \d+ bytes"):
        Dem.open(file)
    with pytest.raises(RasterError, match=r"map\.tif: states 30000 x 30000 cells"):
        read_fuel_map(sparse(tmp_path / "map.tif", 30_000, "uint8"))


def test_a_raster_of_thousands_of_bands_is_not_read(tmp_path: Path) -> None:
    """To read one of bands that lie cell by cell, all are."""
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=9, height=6, count=101, dtype="float32", crs="EPSG:26911",
        transform=from_origin(480_000.0, 4_150_000.0, 5.0, 5.0), interleave="pixel",
    ):  # fmt: skip
        pass
    with pytest.raises(RasterError, match=r"dem\.tif: has 101 bands, at most 100"):
        Dem.open(tmp_path / "dem.tif")


def test_a_grid_of_text_that_ends_early_is_told_by_its_first_missing_row(tmp_path: Path) -> None:
    """GDAL alone takes twice as long for each row that is missing before the one that is asked for."""
    file = tmp_path / "dem.asc"
    head = "ncols 5\nnrows 14\nxllcorner 480000\nyllcorner 4150000\ncellsize 60\n"
    rows = [" ".join(f"{800 + 7 * row + column}.5" for column in range(5)) for row in range(14)]
    file.write_text(head + "\n".join(rows))
    southwest = (480_030.0, 4_150_030.0, 480_200.0, 4_150_150.0)
    assert read_around(file, "EPSG:26911", "EPSG:26911", southwest)[0][-1, 0] == 891.5
    file.write_text(head + "\n".join(rows[:3]) + "\n")
    with pytest.raises(RasterError, match=r"dem\.asc: row 4 of 14 is missing or not numeric"):
        read_around(file, "EPSG:26911", "EPSG:26911", southwest)
    file.write_text(head.replace("ncols 5", "ncols 5000000") + rows[0])
    with pytest.raises(RasterError, match=r"states rows of 5000000 numbers in a file of \d+ bytes"):
        Dem.open(file)


@pytest.mark.parametrize("text", ['<GDAL_WMS><Service name="TMS"/></GDAL_WMS>', ' {"type": "FeatureCollection"}'])
def test_a_text_that_names_other_hosts_is_no_raster(tmp_path: Path, text: str) -> None:
    (tmp_path / "dem.tif").write_text(text)
    with pytest.raises(RasterError, match=r"dem\.tif: not a raster but a text"):
        Dem.open(tmp_path / "dem.tif")
