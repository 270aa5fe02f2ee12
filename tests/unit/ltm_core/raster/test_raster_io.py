from pathlib import Path

import numpy as np
import pytest
import rasterio

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import write_geotiff

GRID = GridGeometry(-75.0, 345.0, 30.0, 5, 3, "EPSG:5070")


def test_bands_and_place(tmp_path: Path) -> None:
    bands = np.arange(30, dtype=np.float32).reshape(2, 3, 5)
    write_geotiff(tmp_path / "b.tif", bands, GRID, nodata=-1.0, tags={"made": "by a test"})
    with rasterio.open(tmp_path / "b.tif") as source:
        np.testing.assert_array_equal(source.read(), bands)
        assert tuple(source.bounds) == GRID.bounds
        assert source.crs.to_epsg() == 5070
        assert source.nodata == -1.0
        assert source.tags()["made"] == "by a test"


def test_bytes_depend_on_the_arguments_alone(tmp_path: Path) -> None:
    array = np.random.default_rng(1).integers(0, 9, (3, 5)).astype(np.int32)
    for name in ("a.tif", "b.tif"):
        write_geotiff(tmp_path / name, array, GRID, tags={"z": "1", "a": "2"})
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_refused(tmp_path: Path) -> None:
    with pytest.raises(RasterError, match=r"n\.tif: a GeoTIFF needs a CRS"):
        write_geotiff(tmp_path / "n.tif", np.zeros((3, 5)), GRID.translated(0, 0))
    with pytest.raises(RasterError, match=r"\(5, 3\) does not fit a raster of \(3, 5\)"):
        write_geotiff(tmp_path / "n.tif", np.zeros((5, 3)), GRID)
    assert not (tmp_path / "n.tif").exists()
