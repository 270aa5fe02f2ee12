import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rasterio.shutil

from ltm_core.base.errors import RasterError
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.export.landscape_io import write_lcp
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import PriorConfig, load_prior
from ltm_core.geometry.grid import GridGeometry

GRID = GridGeometry(300_015.0, 3_700_015.0, 30.0, 4, 1, "EPSG:32611")
CODES = np.array([[102, 145, 165, 183]])
BANDS = {"cover": 0, "height": 1, "base_height": 2, "bulk_density": 3}


def write(path: Path, values: Any, dtype: str, nodata: float | None = None, **tags: Any) -> Path:
    """`tags`: unit, description and scale of the band; mask (H, W)."""
    bands = np.atleast_3d(np.asarray(values, np.float64).T).T  # (bands, H, W)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(
        path, "w", driver="GTiff", width=GRID.width, height=GRID.height, count=len(bands), dtype=dtype, nodata=nodata,
        crs=GRID.crs, transform=GRID.transform(),
    ) as sink:  # fmt: skip
        with np.errstate(invalid="ignore"):
            sink.write(bands.astype(dtype))
        sink.units = (tags.get("unit", ""),) * len(bands)
        sink.scales = (tags.get("scale", 1.0),) * len(bands)
        if "description" in tags:
            sink.set_band_description(1, tags["description"])
        if "mask" in tags:
            sink.write_mask(np.array(tags["mask"], np.uint8))
    return path


def canopy(folder: Path, quantity: str, path: Path) -> list[int]:
    codes = write(folder / "mine.tif", CODES, "int16", -9999)
    prior = load_prior(PriorConfig(fbfm40=codes, **{quantity: path}), GRID)
    assert prior.canopy is not None
    return prior.canopy[BANDS[quantity], 0].tolist()


@pytest.mark.parametrize(
    ("quantity", "values", "dtype", "nodata", "tags", "expected"),
    [
        ("cover", [0, 45, 255, 75], "uint8", 255, {}, [0, 45, NODATA, 75]),
        ("cover", [0, 45, 255, 75], "uint8", None, {}, [0, 45, NODATA, 75]),
        ("cover", [0, 45, np.nan, 75], "float32", np.nan, {}, [0, 45, NODATA, 75]),
        ("cover", [0, 45, np.nan, 75], "float32", -9999, {}, [0, 45, NODATA, 75]),
        ("cover", [0, 45, -(2**31), 75], "int32", -(2**31), {}, [0, 45, NODATA, 75]),
        ("cover", [0, 45, -(2**31), 75], "int32", None, {}, [0, 45, NODATA, 75]),
        ("cover", [-1111, 45, -9999, 75], "int16", None, {}, [NODATA, 45, NODATA, 75]),
        ("cover", [32767, 45, -32768, 75], "int16", -32768, {}, [NODATA, 45, NODATA, 75]),
        ("cover", [65535, 45, 0, 75], "uint16", None, {}, [NODATA, 45, 0, 75]),
        ("cover", [-3.4e38, 45, 1e20, 75], "float64", None, {}, [NODATA, 45, NODATA, 75]),
        ("cover", [-1, 45, 0, 75], "int16", None, {}, [NODATA, 45, 0, 75]),
        ("cover", [0, 45, 0, 75], "uint8", 0, {}, [NODATA, 45, NODATA, 75]),
        ("cover", [9, 45, 0, 75], "uint8", None, {"mask": [[0, 255, 255, 255]]}, [NODATA, 45, 0, 75]),
        ("cover", [9, 45, 7, 75], "uint8", 7, {"mask": [[0, 255, 255, 255]]}, [NODATA, 45, NODATA, 75]),
        ("cover", [0, 0.45, 0.2, 0.75], "float32", None, {}, [0, 45, 20, 75]),
        ("cover", [0, 450, 200, 750], "uint16", None, {"scale": 0.1}, [0, 45, 20, 75]),
        ("cover", [0, 1, 1, 1], "uint8", None, {"unit": "%"}, [0, 1, 1, 1]),
        ("cover", [0, 1, 3, 4], "int16", -9999, {}, [0, 10, 65, 90]),
        ("cover", [11, 145, 220, 310], "int16", -9999, {}, [0, 45, 0, 0]),
        ("cover", [21, 104, 115, 122], "int16", -9999, {}, [0, 45, 0, 0]),
        ("height", [0, 15.5, 3.25, 31], "float32", None, {}, [0, 155, 32, 310]),
        ("height", [0, 155.4, 32, 310], "float32", None, {}, [0, 155, 32, 310]),
        ("height", [0, 15, 3, 31], "uint8", None, {"unit": "m"}, [0, 150, 30, 310]),
        ("height", [0, 50, 10, 100], "int16", None, {"unit": "feet"}, [0, 152, 30, 305]),
        ("height", [0, 155, 32, 310], "int16", None, {"unit": "Meters * 10"}, [0, 155, 32, 310]),
        ("height", [0, 15, 3, 31], "int16", None, {"description": "Stand Height (m)"}, [0, 150, 30, 310]),
        ("height", [0, 155, 32, 31], "int16", None, {"description": "CH (meters * 10)"}, [0, 155, 32, 31]),
        ("height", [0, 50, 30, 55], "int16", None, {}, [0, 50, 30, 55]),
        ("base_height", [0, 1.5, 0.3, 4], "float32", None, {}, [0, 15, 3, 40]),
        ("base_height", [0, 15, 3, 40], "int16", None, {}, [0, 15, 3, 40]),
        ("bulk_density", [0, 0.14, 0.05, 0.4], "float32", None, {}, [0, 14, 5, 40]),
        ("bulk_density", [0, 14, 5, 40], "float32", None, {}, [0, 14, 5, 40]),
        ("bulk_density", [0, 0.01, 0.02, 0.03], "float32", None, {"unit": "lb/ft^3"}, [0, 16, 32, 48]),
    ],
)  # fmt: skip
def test_canopy_in_landfires_units(
    tmp_path: Path,
    quantity: str,
    values: list[float],
    dtype: str,
    nodata: float | None,
    tags: dict[str, Any],
    expected: list[int],
) -> None:
    assert canopy(tmp_path, quantity, write(tmp_path / "band.tif", [values], dtype, nodata, **tags)) == expected


@pytest.mark.parametrize(
    ("quantity", "values", "name", "found"),
    [
        ("cover", [91, 102, 165, 202], "band.tif", "102"),  # fuel codes
        ("cover", [0, 450, 200, 750], "band.tif", "750"),
        ("cover", [0, 1, 1, 1], "band.tif", "0 and 1"),
        ("cover", [7011, 7080, 7292, 7011], "LC22_EVT_230.tif", "7292"),
        ("height", [0, 15, 3, 31], "band.tif", "31"),  # m or m x 10
        ("height", [110, 204, 305, 11], "LC22_EVH_230.tif", "EVH"),
        ("height", [0, 1500, 2400, 1], "band.tif", "1500"),
        ("bulk_density", [120, 700, 650, 480], "elevation.tif", "elevation"),
        ("base_height", [0, 15, 30, 40], "LC22_CBD_230.tif", "bulk_density"),
    ],
)
def test_implausible_canopy_is_rejected(
    tmp_path: Path, quantity: str, values: list[float], name: str, found: str
) -> None:
    with pytest.raises(RasterError, match=found):
        canopy(tmp_path, quantity, write(tmp_path / name, [values], "int16", -9999))


def test_crown_bases_above_the_tops_are_rejected(tmp_path: Path) -> None:
    """As with base heights in m x 10 beside heights in metres that are written as m x 10."""
    tops, bases = ([[0, 20, 35, 30]], [[0, 40, 90, 60]])
    files = {
        "height": write(tmp_path / "a.tif", tops, "int16"),
        "base_height": write(tmp_path / "b.tif", bases, "int16"),
    }
    with pytest.raises(RasterError, match="3 of 3 cells"):
        load_prior(PriorConfig(fbfm40=write(tmp_path / "c.tif", CODES, "int16"), **files), GRID)


@pytest.mark.parametrize(
    ("values", "dtype", "found"),
    [
        ([7011, 7080, 7292, 7011], "int16", "7011"),  # LANDFIRE's EVT
        ([15, 25, 45, 75], "int16", "15"),  # LANDFIRE's cover
        ([101.5, 102, 165, 183], "float32", "fractions"),  # averaged codes
        ([0, 450, 200, 750], "int16", "450"),
    ],
)
@pytest.mark.parametrize("others", ["refuse", "nodata", "built", "keep"])
def test_other_quantities_are_no_codes_whatever_the_remedy(
    tmp_path: Path, values: list[float], dtype: str, found: str, others: Any
) -> None:
    path = write(tmp_path / "mine.tif", [values], dtype)
    with pytest.raises(RasterError, match=found):
        load_prior(PriorConfig(path=path, unknown_codes=others), GRID)


@pytest.mark.parametrize(
    ("values", "dtype", "nodata", "expected"),
    [
        ([91, 99, 9999, 102], "int16", 9999, [91, 99, NODATA, 102]),
        ([91, 98, -9999, 102], "int32", None, [91, 98, NODATA, 102]),
        ([1, 8, 32767, 93], "int16", None, [1, 8, NODATA, 93]),
        ([91, 102, 255, 145], "uint8", None, [91, 102, NODATA, 145]),
        ([0, 102, 165, 145], "uint8", 0, [NODATA, 102, 165, 145]),
        ([20, 21, 89, 14], "uint8", None, [20, 21, 89, 14]),
    ],
)
def test_codes(tmp_path: Path, values: list[int], dtype: str, nodata: float | None, expected: list[int]) -> None:
    path = write(tmp_path / "mine.tif", [values], dtype, nodata)
    assert load_prior(PriorConfig(path=path), GRID).codes[0].tolist() == expected


@pytest.mark.parametrize(
    ("offset", "unit", "band", "values", "expected"),
    [
        (4232, 0, 4, [0, 1, 3, 4], [0, 10, 65, 90]),  # cover in classes
        (4232, 1, 4, [1, 1, 3, 4], [1, 1, 3, 4]),
        (4232, 0, 4, [0, 15, 45, 75], [0, 15, 45, 75]),  # % in spite of the header
        (4234, 1, 5, [0, 15, 3, 31], [0, 150, 30, 310]),  # height in m
        (4234, 2, 5, [0, 50, 10, 100], [0, 152, 30, 305]),
        (4236, 4, 6, [0, 50, 10, 100], [0, 15, 3, 30]),  # base height in ft x 10
        (4238, 4, 7, [0, 5, 10, 20], [0, 8, 16, 32]),  # density in lb/ft3 x 1000
    ],
)
def test_units_of_lcp_headers(
    tmp_path: Path, offset: int, unit: int, band: int, values: list[int], expected: list[int]
) -> None:
    bands = np.zeros((8, 1, 4), np.int16)
    bands[3], bands[band] = CODES, values
    path = write_lcp(tmp_path / "a.lcp", Landscape(bands, GRID))
    content = bytearray(path.read_bytes())
    struct.pack_into("<h", content, offset, unit)
    path.write_bytes(content)
    rasterio.shutil.copy(path, tmp_path / "converted.tif", driver="GTiff")
    for file in (path, tmp_path / "converted.tif"):
        prior = load_prior(PriorConfig(path=file), GRID)
        assert prior.canopy is not None
        assert prior.canopy[band - 4, 0].tolist() == expected


def test_codes_of_an_lcp_that_need_a_conversion_file_are_rejected(tmp_path: Path) -> None:
    bands = np.zeros((8, 1, 4), np.int16)
    bands[3] = CODES
    path = write_lcp(tmp_path / "a.lcp", Landscape(bands, GRID))
    content = bytearray(path.read_bytes())
    struct.pack_into("<h", content, 4230, 2)
    path.write_bytes(content)
    with pytest.raises(RasterError, match="FUEL_MODEL_OPTION"):
        load_prior(PriorConfig(path=path), GRID)
