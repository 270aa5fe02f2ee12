"""Our landscapes as GDAL reads them, slope and aspect as gdaldem derives them."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rasterio
from scipy import ndimage

from ltm_core.fuel.export.landscape import FLAT, Landscape, slope_and_aspect, terrain_bands
from ltm_core.fuel.export.landscape_io import write_cog, write_lcp
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry

GRID = GridGeometry(531_783.25, 4_280_398.25, 30.0, 37, 29, "EPSG:32610")


def landscape() -> Landscape:
    rng = np.random.default_rng(5)
    height = ndimage.gaussian_filter(rng.standard_normal((31, 39)), 3) * 900 + 400
    height[5:9, 5:9] = 300.0
    surface = rng.choice([91, 102, 145, 165, 188], GRID.shape)
    rest = [surface, *(rng.choice(v, GRID.shape) for v in ([0, 45], [0, 110], [0, 15], [0, 12]))]
    bands = np.concatenate([terrain_bands(height, 30.0), np.array(rest, np.int16)])
    bands[:, 3, 4] = NODATA
    return Landscape(bands.astype(np.int16), GRID)


def test_an_lcp(tmp_path: Path) -> None:
    made = landscape()
    with rasterio.open(write_lcp(tmp_path / "a.lcp", made, "of cameras")) as source:
        assert (source.driver, source.count) == ("LCP", 8)
        np.testing.assert_array_equal(source.read(), made.bands)
        assert tuple(source.bounds) == GRID.bounds
        assert source.crs.to_epsg() == 32610
        tags = [source.tags(k) for k in range(1, 9)]
        units = [value for tag in tags for key, value in tag.items() if key.endswith("_UNIT_NAME")]
        heights = ["Meters x 10", "Meters x 10"]
        assert units == ["Meters", "Degrees", "Azimuth degrees", "Percent", *heights, "kg/m^3 x 100"]
        assert tags[3]["FUEL_MODEL_VALUES"] == "91,102,145,165,188"
        assert source.tags()["DESCRIPTION"] == "of cameras"
        assert source.tags()["LATITUDE"] == "38"


def test_a_cog(tmp_path: Path) -> None:
    layer = np.arange(700 * 600, dtype=np.int32).reshape(700, 600)
    geometry = GridGeometry(0.0, 21_000.0, 30.0, 600, 700, "EPSG:5070")
    write_cog(tmp_path / "a.tif", layer, geometry, None, {}, "layer")
    with rasterio.open(tmp_path / "a.tif") as source:
        assert source.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert source.overviews(1)
        np.testing.assert_array_equal(source.read(1), layer)


@pytest.mark.skipif(shutil.which("gdaldem") is None, reason="gdaldem is not installed")
def test_slope_and_aspect_against_gdaldem(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    height = (ndimage.gaussian_filter(rng.standard_normal((41, 53)), 3) * 900).astype(np.float32)
    height[10:15, 20:26] = 7.0
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=53, height=41, count=1, dtype="float32", crs="EPSG:32610",
        transform=rasterio.transform.from_origin(5e5, 4e6, 30, 30),
    ) as sink:  # fmt: skip
        sink.write(height, 1)
    slope, aspect = slope_and_aspect(height, 30.0)
    for kind, ours in (("slope", slope), ("aspect", aspect)):
        subprocess.run(["gdaldem", kind, "-q", tmp_path / "dem.tif", tmp_path / f"{kind}.tif"], check=True)
        with rasterio.open(tmp_path / f"{kind}.tif") as source:
            theirs = source.read(1)[1:-1, 1:-1]
        if kind == "aspect":
            np.testing.assert_array_equal(ours == FLAT, theirs == -9999)
            theirs = np.where(theirs == -9999, FLAT, theirs)
            ours = np.where(np.abs(ours - theirs) > 180, 360 - ours, ours)
        np.testing.assert_allclose(ours, theirs, atol=2e-3)


def test_slope_beside_unknown_heights() -> None:
    plane = np.add.outer(-2.0 * np.arange(8.0), 3.0 * np.arange(9.0))  # rises to the north and east
    plane[4, 4] = np.nan
    slope, aspect = slope_and_aspect(plane, 1.0)
    unknown = np.zeros((6, 7), bool)
    unknown[3, 3] = True
    np.testing.assert_array_equal(np.isnan(slope), unknown)
    np.testing.assert_allclose(slope[~unknown], np.degrees(np.arctan(np.hypot(2, 3))))
    np.testing.assert_allclose(aspect[~unknown], 180 + np.degrees(np.arctan2(3, 2)))  # downhill: south and west
    plane = np.add.outer(-2.0 * np.arange(8.0), 3.0 * np.arange(9.0))
    plane[0] = plane[:, -1] = np.nan  # where the DEM ends, the slope goes on
    assert (terrain_bands(plane, 1.0) != NODATA).all()
    assert set(np.unique(terrain_bands(plane, 1.0)[1])) == {74}
