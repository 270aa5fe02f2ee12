from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp
from rasterio.transform import from_origin

from ltm_core.base.errors import RasterError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem, read_around
from ltm_core.raster.dem_stack import DemStack, open_terrain
from ltm_core.raster.heights_check import doubt_of_heights, doubt_of_relief, doubt_of_surface
from ltm_core.raster.raster_io import open_raster

ROWS, COLS = np.mgrid[0:40, 0:60]
GROUND = 900.0 + 200 * np.sin(ROWS / 9.0) * np.cos(COLS / 11.0) + 2.0 * COLS
"""Hills of 700 to 1,200 m, in cells of 30 m."""
PLACE = from_origin(400_000.0, 3_800_000.0, 30.0, 30.0)


def write(path: Path, *bands: np.ndarray, **options: Any) -> Path:
    after = {name: options.pop(name) for name in ("units", "descriptions", "colorinterp") if name in options}
    mask = options.pop("mask", None)
    form = {"driver": "GTiff", "crs": "EPSG:32611", "transform": PLACE, "dtype": bands[0].dtype} | options
    height, width = bands[0].shape
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(path, "w", width=width, height=height, count=len(bands), **form) as sink,
    ):
        sink.write(np.stack(bands).astype(form["dtype"]))
        for name, value in after.items():
            setattr(sink, name, value)
        if mask is not None:
            sink.write_mask(mask)
    return path


def holed(value: float, ground: np.ndarray = GROUND) -> np.ndarray:
    heights = ground.copy()
    heights[:10, :20] = value
    return heights.astype(np.float32)


@pytest.mark.parametrize(
    "value",
    [-9999, -32768, -32767, -99999, 65535, 32767, 9999, 1e20, -3.4028235e38, 3.4028235e38, -3047.7, -999.9, 0, -1e38],
)
def test_undeclared_nodata_is_unknown_and_said(tmp_path: Path, value: float) -> None:
    dem = Dem.open(write(tmp_path / "d.tif", holed(value)))
    assert np.isnan(dem.elevation[:10, :20]).all()
    np.testing.assert_allclose(dem.elevation[10:], GROUND[10:], rtol=1e-6)
    assert [doubt.code for doubt in dem.doubts] == ["nodata"]


@pytest.mark.parametrize("crs", ["EPSG:32611", "EPSG:26911", "EPSG:4326"])
def test_undeclared_nodata_of_a_coarser_raster_gets_into_no_height(tmp_path: Path, crs: str) -> None:
    """In its own grid and warped: a bilinear mean with -9999 would be any height."""
    place = PLACE if crs != "EPSG:4326" else from_origin(-118.09, 34.335, 0.0003, 0.0003)
    around = write(tmp_path / "c.tif", holed(-9999.0), crs=crs, transform=place)
    found, _, doubts = read_around(around, None, "EPSG:32611", (300_000.0, 3_700_000.0, 500_000.0, 3_900_000.0))
    assert np.isnan(found).any()
    assert np.nanmin(found) >= GROUND.min() - 1
    assert "nodata" in [doubt.code for doubt in doubts]


def test_nodata_counts_beside_a_mask_and_alpha(tmp_path: Path) -> None:
    mask = np.full(GROUND.shape, 255, np.uint8)
    mask[30:] = 0
    heights = holed(-500.0)  # possible ground, so that only the declaration speaks against it
    masked = Dem.open(write(tmp_path / "m.tif", heights, mask=mask, nodata=-500.0))
    alpha = Dem.open(write(tmp_path / "a.tif", heights, mask.astype(np.float32), nodata=-500.0, alpha="yes"))
    for dem in (masked, alpha):
        assert np.isnan(dem.elevation[:10, :20]).all()
        assert np.isnan(dem.elevation[30:]).all()
        assert np.isfinite(dem.elevation[10:30]).all()


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        *(("m", 1.0), ("Metre", 1.0), ("meters", 1.0), ("METERS", 1.0), ("m (NAVD88)", 1.0), ("unknown", 1.0)),
        *(("ft", 0.3048), ("Feet", 0.3048), ("foot", 0.3048), ("US survey foot", 1200 / 3937), ("ftUS", 1200 / 3937)),
        *(("[m]", 1.0), ("m a.s.l.", 1.0), ("feet (US)", 1200 / 3937)),
        *(("us-ft", 1200 / 3937), ("cm", 0.01), ("dm", 0.1), ("decimetres", 0.1), ("km", 1000.0), ("mm", 0.001)),
    ],
)
def test_stated_units_are_converted(tmp_path: Path, unit: str, size: float) -> None:
    dem = Dem.open(write(tmp_path / "d.tif", GROUND / size, units=(unit,)))
    np.testing.assert_allclose(dem.elevation, GROUND, rtol=1e-6)


OTHER = (COLS % 7).astype(np.float64)


@pytest.mark.parametrize(
    ("bands", "descriptions"),
    [
        ((OTHER, GROUND, OTHER), ("density", "elevation", "uncertainty")),
        ((GROUND, OTHER), ("Elevation", "Elevation_Std")),
        ((OTHER, GROUND), ("hillshade", None)),
        ((OTHER, OTHER, GROUND), ("slope_deg", "aspect", "DTM_1m")),
        ((GROUND,), ("Band 1",)),
        ((GROUND,), ("Canopy surface (DSM)",)),
    ],
)
def test_the_band_that_says_elevation(tmp_path: Path, bands: Any, descriptions: Any) -> None:
    dem = Dem.open(write(tmp_path / "d.tif", *bands, descriptions=descriptions))
    np.testing.assert_allclose(dem.elevation, GROUND, rtol=1e-6)
    assert dem.doubts == ()


def hillshade(cell: float) -> np.ndarray:
    rough = GROUND + np.random.default_rng(5).normal(0, 4, GROUND.shape)
    south, east = np.gradient(rough, cell)
    return np.clip(128 + 200 * (east - south), 1, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("bands", "options"),
    [
        ((hillshade(30.0),), {}),
        ((hillshade(30.0),), {"colorinterp": [ColorInterp.palette]}),
        ((GROUND.astype(np.uint8), GROUND.astype(np.uint8), GROUND.astype(np.uint8)), {}),  # terrain-RGB, an ortho
        ((GROUND,), {"descriptions": ("Hillshade",)}),
        ((GROUND,), {"descriptions": ("canopy_height",)}),
        ((GROUND,), {"descriptions": ("Height above ground",)}),
        *(((GROUND,), {"units": (unit,)}) for unit in ("percent", "m/s", "m*10", "degree")),
        ((GROUND,), {"crs": "EPSG:32611+5715"}),  # depths
        ((GROUND,), {"crs": "EPSG:32611+6360", "units": ("m",)}),  # of which only one can be right
        ((GROUND.astype(np.complex64),), {}),
        ((GROUND / 0.3048 * 4,), {}),  # 11,000 to 15,700: no ground in metres
        ((holed(-20_000.0, GROUND - 40.0 * np.clip(COLS - 20, 0, None) ** 2),), {}),
    ],
)
def test_what_is_no_elevation(tmp_path: Path, bands: Any, options: dict[str, Any]) -> None:
    with pytest.raises(RasterError, match=r"d\.tif"):
        Dem.open(write(tmp_path / "d.tif", *bands, **options))


def test_nodata_that_was_interpolated_is_an_error(tmp_path: Path) -> None:
    heights = holed(-9999.0)
    heights[:, 1:] = (heights[:, 1:] + heights[:, :-1]) / 2
    with pytest.raises(RasterError, match="undeclared nodata"):
        Dem.open(write(tmp_path / "d.tif", heights))


@pytest.mark.parametrize(
    ("heights", "codes"),
    [
        (GROUND - GROUND.min() - 430.0, []),
        (np.clip(GROUND - 1_000.0, 0, None), []),  # an island, with the sea at 0
        (GROUND - GROUND.min(), []),
        (GROUND + 7_500.0, []),
        (GROUND - 2_500.0, ["sea"]),
    ],
)
def test_heights_that_exist(tmp_path: Path, heights: np.ndarray, codes: list[str]) -> None:
    dem = Dem.open(write(tmp_path / "d.tif", heights.astype(np.float32)))
    np.testing.assert_allclose(dem.elevation, heights, rtol=1e-5, atol=1e-3)
    assert [doubt.code for doubt in dem.doubts] == codes


def test_a_stack_whose_coarser_raster_is_in_feet(tmp_path: Path) -> None:
    fine = write(tmp_path / "fine.tif", GROUND[8:30, 10:50], transform=from_origin(400_300, 3_799_760, 30, 30))
    for factor in (1 / 0.3048, 10.0, 100.0):
        write(tmp_path / "coarse.tif", (GROUND * factor).clip(None, 8_900))
        with pytest.raises(RasterError, match=r"coarse\.tif"):
            DemStack.open(fine, None, (tmp_path / "coarse.tif", None))
    shifted = open_terrain([(fine, None), (write(tmp_path / "coarse.tif", GROUND + 80.0), None)])
    assert [doubt.code for doubt in shifted.doubts] == ["shift"]
    right = open_terrain([(fine, None), (write(tmp_path / "coarse.tif", GROUND + 3.0), None)])
    assert right.doubts == ()


@pytest.mark.parametrize(
    ("slope", "code"), [(0.45, None), (0.45 / 0.3048, "steep"), (0.45 * 10, "unit"), (0.45 * 100, "unit")]
)
def test_mountains_in_another_unit_are_too_steep(slope: float, code: str | None) -> None:
    zigzag = np.abs((np.arange(60) % 20) - 10.0)[None, :] * 30.0 * slope + np.arange(40)[:, None]
    doubt = doubt_of_relief(zigzag.astype(np.float32), 30.0, False, "d.tif")
    assert (doubt and doubt.code) == code
    assert doubt is None or doubt.wrong == (code == "unit")


@pytest.mark.parametrize(
    ("factor", "shift", "code"),
    [
        (1.0, 0.0, None),
        (1.0, 35.0, None),
        (1.0, 90.0, "shift"),
        (1 / 0.3048, 0.0, "unit"),
        (0.3048, 0.0, "other_unit"),
        (10.0, 0.0, "unit"),
        (0.01, 0.0, "shift"),  # 4 to 19: too low for a ratio
    ],
)
def test_two_rasters_of_one_ground(factor: float, shift: float, code: str | None) -> None:
    others = np.linspace(400.0, 1_900.0, 120).reshape(8, 15)
    others[0, :3] = np.nan
    doubt = doubt_of_heights(others * factor + shift, others, "one", "other")
    assert (doubt and doubt.code) == code


@pytest.mark.parametrize(
    ("tops", "wrong"),
    [
        (GROUND + OTHER * 4, None),
        (OTHER * 4, True),  # a canopy height model
        (GROUND - 33.0, True),  # above the ellipsoid
        (GROUND + 80.0, False),
    ],
)
def test_surfaces(tops: np.ndarray, wrong: bool | None) -> None:
    doubt = doubt_of_surface(tops, GROUND, "tops.tif")
    assert (doubt and doubt.wrong) == wrong


def test_a_mosaic_names_the_file_that_it_lacks(tmp_path: Path) -> None:
    write(tmp_path / "east.tif", GROUND)
    source = (
        "<SimpleSource><SourceFilename relativeToVRT='1'>{}</SourceFilename><SourceBand>1</SourceBand></SimpleSource>"
    )
    (tmp_path / "d.vrt").write_text(
        "<VRTDataset rasterXSize='60' rasterYSize='40'><SRS>EPSG:32611</SRS><GeoTransform>400000,30,0,3800000,0,-30"
        "</GeoTransform><VRTRasterBand dataType='Float32' band='1'>"
        + "".join(source.format(name) for name in ("west.tif", "east.tif"))
        + "</VRTRasterBand></VRTDataset>"
    )
    with pytest.raises(RasterError, match=r"west\.tif"), open_raster(tmp_path / "d.vrt"):
        pass
    assert GridGeometry(400_000.0, 3_800_000.0, 30.0, 60, 40, "EPSG:32611") == Dem.open(tmp_path / "east.tif").geometry


def test_bands_without_names_are_doubted(tmp_path: Path) -> None:
    dem = Dem.open(write(tmp_path / "d.tif", GROUND, OTHER))
    np.testing.assert_allclose(dem.elevation, GROUND, rtol=1e-6)
    assert [doubt.code for doubt in dem.doubts] == ["band"]
