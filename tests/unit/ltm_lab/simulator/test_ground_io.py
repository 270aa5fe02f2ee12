"""Real ground under a simulated site."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator.ground_io import read_codes, read_elevation


def test_real_ground_is_resampled_into_the_site(tmp_path: Path) -> None:
    import rasterio
    from rasterio.transform import from_origin

    x, y = np.meshgrid(500_000 + 30 * (np.arange(40) + 0.5), 3_700_900 - 30 * (np.arange(30) + 0.5))
    plane = (0.1 * (x - 500_000) - 0.2 * (y - 3_700_000) + 700).astype(np.float32)
    profile = {
        "driver": "GTiff",
        "width": 40,
        "height": 30,
        "count": 1,
        "transform": from_origin(500_000, 3_700_900, 30, 30),
    }
    for name, array, crs in (
        ("dem", plane, "EPSG:32611"),
        ("codes", (plane > 700).astype(np.int16) + 101, "EPSG:32611"),
        ("bare", plane, None),
    ):
        with rasterio.open(tmp_path / f"{name}.tif", "w", dtype=array.dtype, crs=crs, **profile) as sink:
            sink.write(array, 1)
    grid = GridGeometry(500_100.0, 3_700_700.0, 8.0, 50, 60, "EPSG:32611")
    gx, gy = grid.to_map(*np.mgrid[0:60, 0:50])
    want = 0.1 * (gx - 500_000) - 0.2 * (gy - 3_700_000) + 700
    np.testing.assert_allclose(read_elevation(tmp_path / "dem.tif", grid), want, atol=0.01)
    assert set(np.unique(read_codes(tmp_path / "codes.tif", grid))) <= {101, 102}
    with pytest.raises(RasterError, match=r"has no CRS.*a_srs"):
        read_elevation(tmp_path / "bare.tif", grid)
    with pytest.raises(RasterError, match=r"no elevation in .*origin"):
        read_elevation(tmp_path / "dem.tif", grid.translated(3000.0, 0.0, "EPSG:32611"))
    with pytest.raises(RasterError, match="not a raster that GDAL can read"):
        read_elevation(tmp_path / "none.tif", grid)
