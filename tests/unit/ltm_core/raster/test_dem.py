from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from pyproj import CRS
from rasterio.transform import Affine, from_origin

from ltm_core.base.errors import RasterError
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem

UTM = "EPSG:32611"
HEIGHTS = np.arange(12, dtype=np.float64).reshape(3, 4) ** 2 + 1  # 3 rows, 4 columns, 1 to 122 m
NORTH_UP = from_origin(501_000.0, 2000.0, 5.0, 5.0)


def write(path: Path, array: np.ndarray, crs: str | None = UTM, transform: Any = NORTH_UP, **options: Any) -> Path:
    mask, scaling = options.pop("mask", None), options.pop("scaling", None)
    units = options.pop("units", None)
    height, width = array.shape
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(
            path,
            "w",
            driver="GTiff",
            width=width,
            height=height,
            count=1,
            dtype=array.dtype,
            crs=crs,
            transform=transform,
            **options,
        ) as sink,
    ):
        sink.write(array, 1)
        if mask is not None:
            sink.write_mask(mask)
        if scaling is not None:
            sink.scales, sink.offsets = ((v,) for v in scaling)
        if units is not None:
            sink.units = (units,)
    return path


@pytest.mark.parametrize("dtype", ["float32", "float64", "int16", "uint16", "int32", "uint8"])
def test_dtypes(tmp_path: Path, dtype: str) -> None:
    dem = Dem.open(write(tmp_path / "d.tif", HEIGHTS.astype(dtype)))
    assert dem.elevation.dtype == np.float32
    np.testing.assert_array_equal(dem.elevation, HEIGHTS)
    assert dem.geometry == GridGeometry(501_000.0, 2000.0, 5.0, 4, 3, UTM)


@pytest.mark.parametrize(
    ("dtype", "nodata"), [("float32", -9999.0), ("float64", float("nan")), ("int16", -32768), ("uint8", 255)]
)
def test_nodata(tmp_path: Path, dtype: str, nodata: float) -> None:
    heights = HEIGHTS.copy()
    heights[1, 2] = nodata
    dem = Dem.open(write(tmp_path / "d.tif", heights.astype(dtype), nodata=nodata))
    assert np.argwhere(np.isnan(dem.elevation)).tolist() == [[1, 2]]
    assert dem.elevation[2, 3] == 122.0


def test_scale_and_offset(tmp_path: Path) -> None:
    stored = HEIGHTS.astype(np.int16)
    stored[0, 0] = -1
    dem = Dem.open(write(tmp_path / "d.tif", stored, nodata=-1, scaling=(0.25, 500.0)))
    assert np.isnan(dem.elevation[0, 0])  # nodata is a stored value, not a scaled one
    np.testing.assert_allclose(dem.elevation.ravel()[1:], HEIGHTS.ravel()[1:] * 0.25 + 500)


def test_rows_stored_south_up_are_turned(tmp_path: Path) -> None:
    south_up = Affine(5.0, 0.0, 501_000.0, 0.0, 5.0, 1985.0)
    dem = Dem.open(write(tmp_path / "d.tif", HEIGHTS[::-1].copy(), transform=south_up))
    np.testing.assert_array_equal(dem.elevation, HEIGHTS)
    assert dem.geometry == GridGeometry(501_000.0, 2000.0, 5.0, 4, 3, UTM)


def test_a_raster_without_crs_needs_one(tmp_path: Path) -> None:
    path = write(tmp_path / "d.tif", HEIGHTS, crs=None)
    with pytest.raises(RasterError, match=r"no CRS; .*--crs"):
        Dem.open(path)
    assert Dem.open(path, "EPSG:32633").geometry.crs == "EPSG:32633"
    with pytest.raises(RasterError, match="unknown CRS 'UTM eleven'"):
        Dem.open(path, "UTM eleven")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"crs": "EPSG:4326", "transform": from_origin(-118.0, 34.0, 0.001, 0.001)}, "projected in metres"),
        ({"crs": "EPSG:2229"}, "projected in metres"),  # US survey feet
        ({"crs": "EPSG:2053"}, "south and west"),
        ({"crs": "EPSG:5513"}, "south and west"),
        ({"crs": CRS("EPSG:32611").to_3d().to_wkt()}, "above the ellipsoid.*EPSG:32611"),
        ({"crs": "EPSG:3857", "transform": from_origin(-13_160_000, 4_030_000, 5, 5)}, "20.*EPSG:32611"),
        ({"crs": "EPSG:32602", "transform": from_origin(5_700_000, 4_700_000, 5, 5)}, "EPSG:326"),
        ({"crs": "ESRI:54009", "transform": from_origin(-10_700_000, 4_100_000, 5, 5)}, "EPSG:32611"),
        ({"crs": "EPSG:5070", "transform": from_origin(-2_000_000, 1_500_000, 5, 5)}, "0.7.*EPSG:32611"),
        ({"units": "degree"}, "degree"),
        ({"crs": "EPSG:32611+6360", "units": "m"}, "0.3048"),
        ({"transform": Affine(4.9, -0.9, 1000.0, -0.9, -4.9, 2000.0)}, "rotated"),
        ({"transform": from_origin(1000.0, 2000.0, 5.0, 6.0)}, r"square, got 5.0 x -6.0 m"),
        ({"transform": Affine(-5.0, 0.0, 1000.0, 0.0, -5.0, 2000.0)}, "square"),
    ],
)
def test_refused(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    path = write(tmp_path / "refused.tif", HEIGHTS, **options)
    with pytest.raises(RasterError, match=message) as raised:
        Dem.open(path)
    assert "refused.tif" in str(raised.value)


DEM = Dem(HEIGHTS.astype(np.float32), GridGeometry(0.0, 30.0, 10.0, 4, 3))


def test_bilinear_between_cell_centres() -> None:
    assert float(DEM.elevation_at(5.0, 25.0)) == HEIGHTS[0, 0]
    assert float(DEM.elevation_at(35.0, 5.0)) == HEIGHTS[2, 3]  # the last centre, on the border of the surface
    assert float(DEM.elevation_at(15.0, 15.0)) == HEIGHTS[1, 1]
    # A quarter of the way east and 0.4 of the way south from cell (0, 1).
    north, south = 0.75 * 2 + 0.25 * 5, 0.75 * 26 + 0.25 * 37
    assert float(DEM.elevation_at(17.5, 21.0)) == pytest.approx(0.6 * north + 0.4 * south)


def test_no_height_beside_nodata() -> None:
    heights = DEM.elevation.copy()
    heights[1, 2] = np.nan
    dem = Dem(heights, DEM.geometry)
    x, y = np.meshgrid([10.0, 20.0, 30.0], [20.0, 10.0])  # the middles of the surface's six patches
    assert np.isnan(dem.elevation_at(x, y)).tolist() == [[False, True, True], [False, True, True]]


def test_in_frame() -> None:
    dem = Dem(HEIGHTS.astype(np.float32), GridGeometry(501_000.0, 2000.0, 5.0, 4, 3, UTM))
    local = dem.in_frame(SiteFrame(UTM, 500_900.0, 1900.0))
    assert local.geometry == GridGeometry(100.0, 100.0, 5.0, 4, 3)
    assert float(local.elevation_at(107.5, 92.5)) == float(dem.elevation_at(501_007.5, 1992.5)) == HEIGHTS[1, 1]
    with pytest.raises(RasterError, match=r"EPSG:32611, the site in EPSG:32633.*gdalwarp"):
        dem.in_frame(SiteFrame("EPSG:32633"))
    with pytest.raises(RasterError, match="DEM is in None"):
        local.in_frame(SiteFrame(UTM))


def test_saved_and_opened(tmp_path: Path) -> None:
    heights = HEIGHTS.astype(np.float32)
    heights[0, 1] = np.nan
    dem = Dem(heights, GridGeometry(501_000.0, 2000.0, 5.0, 4, 3, UTM))
    dem.save(tmp_path / "saved.tif")
    opened = Dem.open(tmp_path / "saved.tif")
    np.testing.assert_array_equal(opened.elevation, heights)
    assert opened.geometry == dem.geometry
    with pytest.raises(RasterError, match="needs a CRS"):
        DEM.save(tmp_path / "local.tif")


@pytest.mark.parametrize("shape", [(4, 3), (3, 4, 1), (1, 4)])
def test_shape_and_geometry(shape: tuple[int, ...]) -> None:
    geometry = GridGeometry(0.0, 0.0, 1.0, 4, 1 if shape == (1, 4) else 3)
    with pytest.raises(RasterError, match=r"shape|2 x 2"):
        Dem(np.zeros(shape, np.float32), geometry)
