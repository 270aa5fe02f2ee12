"""Heights between vertical datums, against PROJ pipelines that are written out here.

The grids are made here under their real names, with undulations of known form; EGM96's real one is used if this machine
has it.
"""

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from pyproj import CRS, Transformer
from pyproj.datadir import get_user_data_dir
from rasterio.transform import from_origin
from scenes.site_services import geotiff

from ltm_core.base.errors import ConfigError
from ltm_core.geometry.grid import GridGeometry
from ltm_ros.site_setup.rasters import resample, tiles_of
from ltm_ros.site_setup.vertical import (
    EGM96,
    EGM2008,
    ELLIPSOIDAL,
    NAVD88,
    Datum,
    MissingGridError,
    correction,
    datum_of,
    named_datum,
    site_datum,
)

DATUMS = {"NAVD88": NAVD88, "EGM2008": EGM2008, "EGM96": EGM96, "ellipsoid": ELLIPSOIDAL}
GRIDS = {"NAVD88": "us_noaa_g2018u0.tif", "EGM2008": "us_nga_egm08_25.tif", "EGM96": "us_nga_egm96_15.tif"}
ITRF2014_OF_NAD83 = (
    "+step +proj=cart +ellps=GRS80 +step {} +proj=helmert +x=1.0053 +y=-1.90921 +z=-0.54157 +rx=0.02678138 "
    "+ry=-0.00042027 +rz=0.01093206 +s=0.00036891 +convention=coordinate_frame +step +inv +proj=cart +ellps=GRS80"
)
"""Values at epoch 2010 of NOAA's HTDP 3.2.9, as EPSG:8970 has them."""


def undulation(name: str, lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    base = {"NAVD88": -32.0, "EGM2008": -33.0, "EGM96": -33.4}[name]
    return np.asarray(base + 2.0 * np.sin(lon / 1.7 + len(name)) + 1.5 * np.cos(lat / 1.3) * np.sin(lon * lat / 900))


def write_grid(path: Path, name: str) -> None:
    step = 1 / 60
    width, height = 481, 361
    west, north = -122.0, 38.0
    lon, lat = west + step * np.arange(width), north - step * np.arange(height)
    about = {
        "TYPE": "VERTICAL_OFFSET_GEOGRAPHIC_TO_VERTICAL", "AREA_OR_POINT": "Point",
        "area_of_use": "test", "target_crs_epsg_code": DATUMS[name].code.removeprefix("EPSG:"),
    }  # fmt: skip
    with rasterio.open(
        path, "w", driver="GTiff", width=width, height=height, count=1, dtype="float32",
        crs="EPSG:4979" if name != "NAVD88" else "EPSG:6319", tiled=True, compress="deflate",
        transform=from_origin(west - step / 2, north + step / 2, step, step),
    ) as sink:  # fmt: skip
        sink.write(undulation(name, *np.meshgrid(lon, lat)).astype(np.float32), 1)
        sink.set_band_description(1, "geoid_undulation")
        sink.set_band_unit(1, "metre")
        sink.update_tags(**about)


@pytest.fixture(scope="module")
def grids(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("proj")
    for name, file in GRIDS.items():
        write_grid(folder / file, name)
    before = pyproj.datadir.get_data_dir()
    pyproj.datadir.append_data_dir(str(folder))
    yield folder
    pyproj.datadir.set_data_dir(before)


@pytest.fixture
def without_grids() -> Iterator[None]:
    before = pyproj.datadir.get_data_dir()
    pyproj.datadir.set_data_dir(before.split(os.pathsep)[0])
    yield
    pyproj.datadir.set_data_dir(before)


def independent(given: str, wanted: str, folder: Path) -> Transformer:
    """The pipeline of PROJ steps that takes heights above one datum to those above another, by hand."""
    steps = ["+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad"]
    if given != "ellipsoid":
        steps.append(f"+step +proj=vgridshift +grids={folder / GRIDS[given]} +multiplier=1")
    if given == "NAVD88":
        steps.append(ITRF2014_OF_NAD83.format("+inv"))
    if wanted == "NAVD88":
        steps.append(ITRF2014_OF_NAD83.format(""))
    if wanted != "ellipsoid":
        steps.append(f"+step +inv +proj=vgridshift +grids={folder / GRIDS[wanted]} +multiplier=1")
    steps.append("+step +proj=unitconvert +xy_in=rad +xy_out=deg")
    return Transformer.from_pipeline(" ".join(steps))


@pytest.mark.parametrize(("given", "wanted"), list(itertools.permutations(DATUMS, 2)))
def test_heights_agree_with_a_pipeline_of_proj(given: str, wanted: str, grids: Path) -> None:
    rng = np.random.default_rng(5)
    lon, lat, z = rng.uniform(-121, -115, 200), rng.uniform(33, 37, 200), rng.uniform(0, 3000, 200)
    found = z + correction(DATUMS[given], DATUMS[wanted], lon, lat)
    there = independent(given, wanted, grids).transform(lon, lat, z)[2]
    np.testing.assert_allclose(found, there, atol=0.05)
    assert np.abs(found - z).min() > 0.01  # there is something to convert


@pytest.mark.parametrize("crs", ["EPSG:4326+5773", "EPSG:4326+3855", "EPSG:4269+5703", "EPSG:4269+6360", "EPSG:4979"])
@pytest.mark.parametrize("wanted", [NAVD88, EGM2008])
def test_a_raster_comes_into_the_datum_of_the_site(crs: str, wanted: Datum, grids: Path, tmp_path: Path) -> None:
    unit = 1200 / 3937 if crs.endswith("6360") else 1.0
    heights = (np.full((90, 120), 500.0) / unit).astype(np.float32)
    (tmp_path / "a.tif").write_bytes(geotiff(heights, crs, -118.07, 34.24, 1 / 3600))
    grid = GridGeometry(401_800.0, 3_788_000.0, 50.0, 30, 20, "EPSG:32611")
    tiles = tiles_of([tmp_path / "a.tif"])
    made, _ = resample(tiles, grid, wanted)
    rng = np.random.default_rng(7)
    row, col = rng.integers(0, 20, 200), rng.integers(0, 30, 200)
    lon, lat = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True).transform(*grid.to_map(row, col))
    names = {datum.code: name for name, datum in DATUMS.items()}
    given = names[tiles[0].datum.code if tiles[0].datum else ""]
    there = np.full(200, 500.0)
    if given != names[wanted.code]:
        there = independent(given, names[wanted.code], grids).transform(lon, lat, there)[2]
    np.testing.assert_allclose(made[row, col], there, atol=0.05)


@pytest.mark.skipif(
    any((Path(get_user_data_dir()) / grid).exists() for grid in GRIDS.values()),
    reason="this machine has grids",
)
def test_a_missing_grid_states_its_name_and_the_size_of_the_error(without_grids: None) -> None:
    with pytest.raises(MissingGridError, match=r"pyproj sync --file us_noaa_g2018u0.tif") as orthometric:
        correction(NAVD88, EGM2008, np.array([-118.0]), np.array([34.0]))
    with pytest.raises(MissingGridError) as ellipsoidal:
        correction(ELLIPSOIDAL, EGM2008, np.array([-118.0]), np.array([34.0]))
    assert (orthometric.value.metres, ellipsoidal.value.metres) == (1, 30)


def test_a_place_beyond_the_grid_is_an_error(grids: Path) -> None:
    with pytest.raises(MissingGridError):
        correction(NAVD88, EGM2008, np.array([-149.5]), np.array([61.2]))


@pytest.mark.parametrize(
    ("crs", "code"),
    [
        ("EPSG:32611", None),
        ("EPSG:4326", None),
        ("EPSG:4979", "EPSG:4979"),
        ("EPSG:4269+5703", "EPSG:5703"),
        ("EPSG:2229+6360", "EPSG:5703"),
        ("EPSG:25833+5941", "EPSG:5941"),
        ("EPSG:6319", "EPSG:6319"),
    ],
)
def test_the_datum_that_a_crs_states(crs: str, code: str | None) -> None:
    found = datum_of(CRS(crs))
    assert (None if found is None else found.code) == code


def test_the_datum_of_a_site_is_a_level_surface(grids: Path) -> None:
    assert site_datum(NAVD88, -118, 34) == NAVD88
    assert site_datum(ELLIPSOIDAL, -118, 34) == EGM2008
    assert site_datum(None, -118, 34) is None


def test_a_name_that_is_no_datum_is_an_error() -> None:
    assert named_datum("NAVD88") == NAVD88
    assert named_datum("EPSG:3855") == EGM2008
    with pytest.raises(ConfigError, match="32611"):
        named_datum("EPSG:32611")
