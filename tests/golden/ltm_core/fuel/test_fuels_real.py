"""Real fuel maps: two of the Tubbs Fire ground, one of Vermont as LANDFIRE gives it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.warp import Resampling, reproject

from ltm_core.fuel.class_map import snapped_grid
from ltm_core.fuel.codes import FuelClimate, FuelSystem, of_one_fuel_type
from ltm_core.fuel.decision import layers_of_classes
from ltm_core.fuel.export.export_grid import GridTransfer, make_landscape
from ltm_core.fuel.export.landscape import surface_codes
from ltm_core.fuel.export.landscape_io import write_landscape, write_lcp
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import FuelPrior, PriorConfig, load_prior
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem

EARLIER, LATER = "earlier_elmfire_lcc/fbfm40r5.tif", "later_gridfire_utm10/fbfm40.tif"


def raster(path: Path) -> tuple[np.ndarray, GridGeometry]:
    with rasterio.open(path) as source:
        t = source.transform
        return source.read(1), GridGeometry(t.c, t.f, t.a, source.width, source.height, source.crs.to_wkt())


def group(codes: np.ndarray) -> np.ndarray:
    """NB, GR, GS, SH, TU, TL, SB as 0 to 6."""
    return np.digitize(codes, [100, 120, 140, 160, 180, 200])


def test_the_tubbs_pair(shared_data: Path, tmp_path: Path) -> None:
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

    climate = FuelClimate.named("dry")
    for name, own in (("early", early_grid), ("later", grid)):
        names = {"early": EARLIER, "later": LATER}
        dem = Dem.open((folder / names[name]).parent / "dem.tif")
        prior = load_prior(PriorConfig(path=folder / names[name]), own)
        frame = SiteFrame(str(dem.geometry.crs))
        unseen = np.full(own.shape, 255, np.uint8)
        layers = layers_of_classes(unseen, prior, climate)
        made = make_landscape(layers, prior, dem.in_frame(frame), frame, own, climate, FuelSystem.FBFM40)
        np.testing.assert_array_equal(made.band("fuel"), prior.codes)
        for path in (write_lcp(tmp_path / f"{name}.lcp", made), write_landscape(tmp_path / f"{name}.tif", made)):
            with rasterio.open(path) as source:
                np.testing.assert_array_equal(source.read(), made.bands)
            back = load_prior(PriorConfig(path=path), own)
            np.testing.assert_array_equal(back.codes, prior.codes)


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
    ways = [region.crossed(prior.codes, FuelSystem.FBFM13, cover)]
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


@pytest.mark.parametrize(
    ("name", "region_name", "contradicting", "by_table", "by_export"),
    [
        ("fuels_vermont_landfire/LC22_F40_230.tif", "humid", 593, 0.976, 0.997),
        ("fuels_tubbs_pair/" + LATER, "dry", 47_498, 0.901, 0.925),
    ],
)
def test_agreement_with_landfires_own_fbfm13(
    shared_data: Path, name: str, region_name: str, contradicting: int, by_table: float, by_export: float
) -> None:
    """The dry region's table loses what LANDFIRE's two maps contradict each other in, most of it GR2, grass, that is
    brush in the other."""
    path, region = shared_data / name, FuelClimate.named(region_name)
    prior = load_prior(PriorConfig(path=path.parent, fbfm40=path, own_fbfm13="as_given"), raster(path)[1])
    assert prior.contradicting == contradicting
    assert prior.fbfm13 is not None
    both = (prior.codes != NODATA) & (prior.fbfm13 != NODATA)
    cover = None if prior.canopy is None else prior.canopy[0]
    table = region.crossed(prior.codes, FuelSystem.FBFM13, cover)
    assert (table == prior.fbfm13)[both].mean() > by_table
    assert (exported(prior, region, within_fuel_type(prior)) == prior.fbfm13)[both].mean() > by_export
