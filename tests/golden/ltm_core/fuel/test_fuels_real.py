"""Real fuel maps: two of the Tubbs Fire ground, one of Vermont as LANDFIRE gives it."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.warp import Resampling, reproject

from ltm_core.base.errors import RasterError
from ltm_core.fuel.class_map import snapped_grid
from ltm_core.fuel.codes import FuelClimate, FuelSystem, code_color, of_one_fuel_type
from ltm_core.fuel.decision import layers_of_classes
from ltm_core.fuel.export.export_grid import GridTransfer
from ltm_core.fuel.export.landscape import surface_codes
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import FuelPrior, PriorConfig
from ltm_core.fuel.prior_io import load_prior, prior_heights
from ltm_core.geometry.grid import GridGeometry

EARLIER, LATER = "earlier_elmfire_lcc/fbfm40r5.tif", "later_gridfire_utm10/fbfm40.tif"


def raster(path: Path) -> tuple[np.ndarray, GridGeometry]:
    with rasterio.open(path) as source:
        t = source.transform
        return source.read(1), GridGeometry(t.c, t.f, t.a, source.width, source.height, source.crs.to_wkt())


def group(codes: np.ndarray) -> np.ndarray:
    """NB, GR, GS, SH, TU, TL, SB as 0 to 6."""
    return np.digitize(codes, [100, 120, 140, 160, 180, 200])


def test_the_tubbs_pair(shared_data: Path) -> None:
    folder = shared_data / "fuels_tubbs_pair"
    later, grid = raster(folder / LATER)
    early, early_grid = raster(folder / EARLIER)
    moved = load_prior(PriorConfig(path=folder / EARLIER), grid)
    both = (moved.codes != NODATA) & (later != NODATA)
    assert both.sum() == 92_040
    assert (moved.codes == later)[both].mean() == pytest.approx(0.229, abs=5e-4)
    # The confusion by fuel group is that of GDAL's own warp.
    theirs = np.full(grid.shape, NODATA, np.int16)
    reproject(
        early, theirs, src_transform=early_grid.transform(), src_crs=early_grid.crs, src_nodata=NODATA,
        dst_transform=grid.transform(), dst_crs=grid.crs, dst_nodata=NODATA, resampling=Resampling.nearest,
    )  # fmt: skip
    ours, golden = (
        np.bincount(7 * group(codes[both]) + group(later[both]), minlength=49) for codes in (moved.codes, theirs)
    )
    assert np.abs(ours - golden).sum() < 0.002 * both.sum()
    assert ours.reshape(7, 7)[0, 1:].sum() > 0


def test_codes_that_no_system_has(shared_data: Path) -> None:
    folder = shared_data / "fuels_tubbs_pair/earlier_elmfire_lcc"
    _, grid = raster(folder / "fbfm40b.tif")
    with pytest.raises(RasterError, match="256 \\(114001 cells\\)"):
        load_prior(PriorConfig(path=folder / "fbfm40b.tif"), grid)
    known = load_prior(PriorConfig(path=folder / "fbfm40b.tif", unknown_codes="nodata"), grid).codes != NODATA
    assert (~known).sum() == 114_001 + (raster(folder / "fbfm40b.tif")[0] == NODATA).sum()


def test_an_elmfire_folder(shared_data: Path) -> None:
    """Its codes come in two revisions, of which one is named; the rest is known by its names."""
    folder = shared_data / "fuels_tubbs_pair/earlier_elmfire_lcc"
    codes, grid = raster(folder / "fbfm40r5.tif")
    with pytest.raises(RasterError, match=r"fbfm40b.tif, fbfm40r5.tif"):
        load_prior(PriorConfig(path=folder), grid)
    config = PriorConfig(path=folder, fbfm40=folder / "fbfm40r5.tif")
    prior, heights = load_prior(config, grid), prior_heights(config, grid)
    np.testing.assert_array_equal(prior.codes, codes)
    assert prior.canopy is not None
    assert heights is not None
    np.testing.assert_array_equal(heights, raster(folder / "dem.tif")[0])


def test_a_landfire_download(shared_data: Path) -> None:
    folder = shared_data / "fuels_vermont_landfire"
    codes, grid = raster(folder / "LC22_F40_230.tif")
    prior = load_prior(PriorConfig(path=folder), grid)
    np.testing.assert_array_equal(prior.codes, np.where(codes == 32767, NODATA, codes))
    assert prior.canopy is not None
    np.testing.assert_array_equal(prior.canopy[2:], NODATA)  # the download has cover and height alone
    assert (grid.x_min % 30, grid.y_max % 30) == (15, 15)
    snapped = snapped_grid(
        GridGeometry(grid.x_min, grid.y_max, 30.0, grid.width, grid.height, "EPSG:5070"), "EPSG:5070"
    )
    np.testing.assert_array_equal(GridTransfer(grid, snapped).layer(codes, 0), codes)


GROUPS = {
    "grass": (range(101, 110), range(1, 4)),
    "shrub": (range(141, 150), range(4, 8)),
    "timber": (range(161, 190), range(8, 11)),
}
"""FBFM40 codes of a fuel type, and its FBFM13 codes."""


def exported(prior: FuelPrior, region: FuelClimate, own: np.ndarray | None) -> np.ndarray:
    """FBFM13 of a map that is exported unchanged, where the prior brings its `own`."""
    layers = layers_of_classes(np.full(prior.codes.shape, 255, np.uint8), prior, region)
    return surface_codes(layers, replace(prior, fbfm13=own), region, FuelSystem.FBFM13)


def within_fuel_type(prior: FuelPrior) -> np.ndarray:
    assert prior.fbfm13 is not None
    return np.where(of_one_fuel_type(prior.codes, prior.fbfm13), prior.fbfm13, NODATA).astype(np.int16)


@pytest.mark.parametrize("region_name", ["dry", "humid"])
@pytest.mark.parametrize(
    "name",
    [
        "fuels_vermont_landfire/LC22_F40_230.tif",
        "fuels_tubbs_pair/" + LATER,
        "fuels_tubbs_pair/" + EARLIER,
        "fuels_socal_santaana_gridfire/fbfm40.tif",
    ],
)
def test_a_life_form_stays_its_own_in_fbfm13(shared_data: Path, name: str, region_name: str) -> None:
    path, region = shared_data / name, FuelClimate.named(region_name)
    _, grid = raster(path)
    prior = load_prior(PriorConfig(path=path.parent, fbfm40=path, own_fbfm13="as_given"), grid)
    cover = None if prior.canopy is None else prior.canopy[0]
    ways = [region.as_crosswalk().to_fbfm13(prior.codes, cover)]
    if prior.fbfm13 is not None:
        ways.append(exported(prior, region, within_fuel_type(prior)))
        both = (prior.codes != NODATA) & (prior.fbfm13 != NODATA)
        assert both.sum() > 100_000
        same = exported(prior, region, prior.fbfm13) == prior.fbfm13
        assert same[both].all(), "LANDFIRE's own codes stay, bit for bit"
        assert (ways[1] != prior.fbfm13)[both].sum() == prior.contradicting > 500
    for codes in ways:
        for own, group_of_13 in GROUPS.values():
            cells = np.isin(prior.codes, list(own))
            assert np.isin(codes, list(group_of_13))[cells].sum() >= 0.99 * cells.sum()


def attribute_table(path: Path) -> list[dict[str, str]]:
    """The rows of a dBASE file."""
    data = path.read_bytes()
    count, header, length = struct.unpack("<IHH", data[4:12])
    fields, at = [], 32
    while data[at] != 13:
        fields.append((data[at : at + 11].split(b"\0")[0].decode(), data[at + 16]))
        at += 32
    rows = []
    for start in range(header, header + count * length, length):
        row, place = {}, start + 1
        for name, width in fields:
            row[name] = data[place : place + width].decode("latin1").strip()
            place += width
        rows.append(row)
    return rows


@pytest.mark.parametrize("product", ["F40", "F13"])
def test_fuel_models_have_landfires_colours(shared_data: Path, product: str) -> None:
    rows = attribute_table(shared_data / f"fuels_vermont_landfire/LC22_{product}_230.tif.vat.dbf")
    given = {int(row["VALUE"]): tuple(int(row[band]) for band in "RGB") for row in rows if int(row["VALUE"]) > 0}
    # Non-burnable codes stand in both systems, with other colours; ours are those of the newer one.
    burnable = {code: color for code, color in given.items() if product == "F40" or code < 90}
    assert len(burnable) > 6
    assert {code: code_color(code) for code in burnable} == burnable
