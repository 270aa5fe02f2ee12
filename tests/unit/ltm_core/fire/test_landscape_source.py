"""Landscapes that a fire can be run on, and what is told of those that it cannot."""

import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.fire.effect import read_landscape, require_same_grid
from ltm_core.fuel.class_map import snapped_grid
from ltm_core.fuel.codes import FuelSystem
from ltm_core.fuel.export.landscape import LANDSCAPE_BANDS, LANDSCAPE_UNITS, Landscape
from ltm_core.fuel.export.landscape_io import write_landscape, write_lcp, write_raster
from ltm_core.geometry.grid import GridGeometry

GRID = GridGeometry(345_975.0, 3_783_195.0, 30.0, 9, 7, "EPSG:32611")


def landscape(codes: tuple[int, ...] = (91, 102, 145), geometry: GridGeometry = GRID) -> Landscape:
    rng = np.random.default_rng(2)
    bands = rng.integers(0, 50, (8, *geometry.shape))
    bands[3] = rng.choice(codes, geometry.shape)
    return Landscape(bands.astype(np.int16), geometry)


@pytest.mark.parametrize("name", ["a.lcp", "a.tif"])
def test_what_we_write_comes_back(tmp_path: Path, name: str) -> None:
    made = landscape()
    (write_lcp if name.endswith("lcp") else write_landscape)(tmp_path / name, made)
    found = read_landscape(tmp_path / name)
    np.testing.assert_array_equal(found.bands, made.bands)
    assert found.system is FuelSystem.FBFM40
    require_same_grid(made, found, ("made", "found"))
    write_landscape(tmp_path / "13.tif", landscape((2, 9, 98)))
    assert read_landscape(tmp_path / "13.tif").system is FuelSystem.FBFM13
    write_landscape(tmp_path / "own.tif", landscape((2, 9, 20, 256)))  # an analyst's model, and a mark of ELMFIRE's
    assert read_landscape(tmp_path / "own.tif").system is FuelSystem.FBFM13


def test_landfires_nodata(tmp_path: Path) -> None:
    bands = landscape().bands.copy()
    bands[:, 2, 3] = 32767
    write_raster(tmp_path / "a.tif", bands, GRID, None, LANDSCAPE_BANDS, LANDSCAPE_UNITS)
    assert (read_landscape(tmp_path / "a.tif").bands[:, 2, 3] == -9999).all()


def test_others_are_refused_with_the_remedy(tmp_path: Path) -> None:
    write_raster(tmp_path / "one.tif", landscape().bands[0], GRID, -9999)
    with pytest.raises(RasterError, match=r"no elevation, .*ltm export --format landscape"):
        read_landscape(tmp_path / "one.tif")
    degrees = GridGeometry(-118.0, 34.0, 0.0003, 9, 7, "EPSG:4326")
    write_raster(tmp_path / "degrees.tif", landscape(geometry=degrees).bands, degrees, -9999)
    with pytest.raises(RasterError, match=r"EPSG:4326; a fire needs a projected CRS.*ltm export --crs"):
        read_landscape(tmp_path / "degrees.tif")
    path = write_lcp(tmp_path / "a.lcp", landscape())
    path.with_suffix(".prj").unlink()
    with pytest.raises(RasterError, match=r"CRS is missing; .*\.prj"):
        read_landscape(path)
    path = write_lcp(tmp_path / "cartesian.lcp", landscape())
    content = bytearray(path.read_bytes())
    struct.pack_into("<h", content, 4228, 1)
    path.write_bytes(content)
    with pytest.raises(RasterError, match="counterclockwise"):
        read_landscape(path)
    with rasterio.open(
        tmp_path / "wide.tif", "w", driver="GTiff", width=9, height=7, count=8, dtype="int16", crs="EPSG:32611",
        transform=rasterio.transform.from_origin(0, 0, 30, 20),
    ) as sink:  # fmt: skip
        sink.write(landscape().bands)
    with pytest.raises(RasterError, match="square cells"):
        read_landscape(tmp_path / "wide.tif")


@pytest.mark.parametrize(
    ("crs", "x", "y", "message"),
    [("EPSG:3857", -13_160_000, 4_030_000, "EPSG:32611"), ("EPSG:2053", 50_000, 3_000_000, "south and west")],
)
def test_areas_and_slopes_need_a_true_scale(tmp_path: Path, crs: str, x: float, y: float, message: str) -> None:
    grid = GridGeometry(x, y, 30.0, 9, 7, crs)
    write_raster(tmp_path / "land.tif", landscape(geometry=grid).bands, grid, -9999)
    with pytest.raises(RasterError, match=rf"land\.tif: .*{message}"):
        read_landscape(tmp_path / "land.tif")
    with pytest.raises(ConfigError, match=message):
        snapped_grid(GRID, crs)
    assert snapped_grid(GRID, "EPSG:5070").crs == "EPSG:5070"


@pytest.mark.parametrize("band", ["elevation", "fuel"])
def test_a_landscape_with_gaps_says_what_is_missing(tmp_path: Path, band: str) -> None:
    gaps = landscape()
    gaps.bands[LANDSCAPE_BANDS.index(band), :5] = -9999
    with pytest.raises(RasterError, match=f"{band} is unknown in 71%") as raised:
        write_landscape(tmp_path / "land.tif", gaps)
    assert ("prior fuel map" in str(raised.value)) is (band == "fuel")


def test_two_of_different_grids() -> None:
    other = GridGeometry(345_975.0, 3_783_195.0, 30.0, 9, 7, "EPSG:32610")
    with pytest.raises(ConfigError, match=r"was.tif is in .*zone 11N, now.tif in .*zone 10N.*ltm export --crs"):
        require_same_grid(landscape(), landscape(geometry=other), ("was.tif", "now.tif"))
    moved = GridGeometry(346_005.0, 3_783_195.0, 30.0, 9, 7, "EPSG:32611")
    with pytest.raises(ConfigError, match="so that they have one grid"):
        require_same_grid(landscape(), landscape(geometry=moved), ("was.tif", "now.tif"))
