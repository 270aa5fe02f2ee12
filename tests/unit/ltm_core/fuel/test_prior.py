from pathlib import Path

import numpy as np
import pytest
import rasterio

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Int16Array
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import PriorConfig, load_prior, prior_heights
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import write_geotiff

GRID = GridGeometry(300_015.0, 3_700_015.0, 30.0, 4, 3, "EPSG:32611")
CODES = np.array([[101, 102, 122, 91], [142, 145, 98, 183], [102, 102, 186, 99]], np.int16)


def write(path: Path, values: Int16Array = CODES) -> Path:
    path.parent.mkdir(exist_ok=True)
    write_geotiff(path, values, GRID, nodata=NODATA)
    return path


@pytest.mark.parametrize(
    "name",
    [
        "fbfm40.tif",
        "fbfm40b.tif",
        "fbfm40r5.tif",
        "LC22_F40_230.tif",
        "US_200FBFM40.tif",
        "LF2020_FBFM40_200_CONUS.tif",
    ],
)
def test_a_folder_of_bands_by_their_names(tmp_path: Path, name: str) -> None:
    write(tmp_path / "fuels" / name)
    write(tmp_path / "fuels/cc.tif", np.full(CODES.shape, 35, np.int16))
    prior = load_prior(PriorConfig(path=tmp_path / "fuels"), GRID)
    np.testing.assert_array_equal(prior.codes, CODES)
    assert prior.canopy is not None
    assert (prior.canopy[0] == 35).all()


def test_two_revisions_are_named_and_one_may_be_chosen(tmp_path: Path) -> None:
    """As ELMFIRE's validation cases hold them."""
    write(tmp_path / "fuels/fbfm40b.tif", CODES[::-1].copy())
    chosen = write(tmp_path / "fuels/fbfm40r5.tif")
    write(tmp_path / "fuels/cc.tif", np.full(CODES.shape, 35, np.int16))
    with pytest.raises(
        RasterError, match=r"fbfm40b.tif, fbfm40r5.tif could all be fbfm40; name one: `fuel: .*path: fuels"
    ):
        load_prior(PriorConfig(path=tmp_path / "fuels"), GRID)
    prior = load_prior(PriorConfig(path=tmp_path / "fuels", fbfm40=chosen), GRID)
    np.testing.assert_array_equal(prior.codes, CODES)
    assert prior.canopy is not None
    with pytest.raises(RasterError, match="not a folder"):
        load_prior(PriorConfig(path=chosen, cover=chosen), GRID)


@pytest.mark.parametrize("name", ["slp.tif", "fbfm40 copy of mine.png", "chm.tif", "fbfm1340.tif"])
def test_a_folder_without_codes_says_what_it_has(tmp_path: Path, name: str) -> None:
    write(tmp_path / "fuels" / name)
    with pytest.raises(RasterError, match=r"no fuel codes in it .* name it: `fuel: .*fbfm40: FILE"):
        load_prior(PriorConfig(path=tmp_path / "fuels"), GRID)


@pytest.mark.parametrize("system", ["fbfm40", "fbfm13"])
def test_unknown_codes_are_refused_or_taken_for_unknown(tmp_path: Path, system: str) -> None:
    codes = CODES.copy() if system == "fbfm40" else np.where(CODES > 100, CODES % 13 + 1, CODES).astype(np.int16)
    codes[0, 1], codes[2, 0] = 256, 256
    path = write(tmp_path / f"{system}.tif", codes)
    with pytest.raises(RasterError, match=rf"{system} does not define: 256 \(2 cells\).*unknown_codes: nodata"):
        load_prior(PriorConfig(path=path), GRID)
    prior = load_prior(PriorConfig(path=path, unknown_codes="nodata"), GRID)
    assert prior.system == system
    np.testing.assert_array_equal(prior.codes, np.where(codes == 256, NODATA, codes))


def test_elevations_beside_the_codes(tmp_path: Path) -> None:
    heights = np.arange(12, dtype=np.int16).reshape(3, 4) + 700
    heights[1, 2] = NODATA
    write(tmp_path / "fuels/fbfm40.tif")
    assert prior_heights(PriorConfig(path=tmp_path / "fuels"), GRID) is None
    write(tmp_path / "fuels/dem.tif", heights)
    bands = np.stack([heights, *[np.zeros_like(CODES)] * 2, CODES, *[np.zeros_like(CODES)] * 4])
    write(tmp_path / "landscape.tif", bands)
    for place in ("fuels", "landscape.tif"):
        found = prior_heights(PriorConfig(path=tmp_path / place), GRID)
        assert found is not None
        np.testing.assert_array_equal(found, np.where(heights == NODATA, np.nan, heights))
    with rasterio.open(tmp_path / "landscape.tif") as source:
        assert source.count == 8
    assert prior_heights(PriorConfig(path=tmp_path / "fuels/fbfm40.tif"), GRID) is None


def test_a_fbfm13_beside_the_codes_is_kept_within_the_fuel_type_or_as_given(tmp_path: Path) -> None:
    """Of GR1, GR2, GS2 and NB1 in the first row, and so on: 5 and 8 are neither grass nor, in the last, brush."""
    own = np.array([[1, 5, 2, 91], [5, 4, 98, 8], [8, 3, 9, 99]], np.int16)
    write(tmp_path / "fbfm40.tif")
    write(tmp_path / "fbfm13.tif", own)
    given = load_prior(PriorConfig(path=tmp_path, own_fbfm13="as_given"), GRID)
    kept = load_prior(PriorConfig(path=tmp_path), GRID)
    assert given.contradicting == kept.contradicting == 2
    assert given.fbfm13 is not None
    assert kept.fbfm13 is not None
    np.testing.assert_array_equal(given.fbfm13, own)
    own[0, 1] = own[2, 0] = NODATA
    np.testing.assert_array_equal(kept.fbfm13, own)
