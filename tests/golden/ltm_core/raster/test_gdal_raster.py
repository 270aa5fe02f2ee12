"""Our rasters against GDAL's own reading of them: placement, and bilinear sampling by its warper."""

from pathlib import Path

import numpy as np
import rasterio
from rasterio.enums import Resampling
from rasterio.warp import reproject
from scenes.rasters import rough_terrain

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem


def test_cells_lie_where_gdal_puts_them(tmp_path: Path) -> None:
    dem = Dem(rough_terrain(3, (37, 53)).elevation, GridGeometry(346_015.0, 3_783_045.0, 2.5, 53, 37, "EPSG:32611"))
    dem.save(tmp_path / "dem.tif")
    rng = np.random.default_rng(5)
    x, y = rng.uniform(346_016.5, 346_140.0, 300), rng.uniform(3_782_960.0, 3_783_043.0, 300)
    with rasterio.open(tmp_path / "dem.tif") as source:
        cells = np.array([source.index(*point) for point in zip(x, y, strict=True)])
        centres = np.array([source.xy(row, col) for row, col in cells])
        sampled = np.array([value[0] for value in source.sample(zip(x, y, strict=True))])
    row, col = dem.geometry.cell_of(x, y)
    np.testing.assert_array_equal(np.stack([row, col], axis=-1), cells)
    np.testing.assert_allclose(np.stack(dem.geometry.to_map(row, col), axis=-1), centres, atol=1e-6)
    np.testing.assert_array_equal(dem.elevation[row, col], sampled)


def test_bilinear_as_gdal_warps() -> None:
    dem = rough_terrain(4, (31, 47), resolution=4.0)
    source = GridGeometry(500_000.0, 4_000_000.0, 4.0, 47, 31, "EPSG:32611")
    fine = GridGeometry(500_010.0, 3_999_985.0, 1.0, 150, 80, "EPSG:32611")
    warped = np.full(fine.shape, np.nan)
    reproject(
        dem.elevation.astype(np.float64),
        warped,
        src_transform=source.transform(),
        src_crs=source.crs,
        dst_transform=fine.transform(),
        dst_crs=fine.crs,
        resampling=Resampling.bilinear,
        dst_nodata=np.nan,
    )
    row, col = np.mgrid[0 : fine.height, 0 : fine.width]
    ours = Dem(dem.elevation, source).elevation_at(*fine.to_map(row, col))
    assert np.isfinite(warped).all()
    np.testing.assert_allclose(ours, warped, atol=1e-3)
