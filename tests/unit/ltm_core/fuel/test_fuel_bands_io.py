import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio

from ltm_core.base.errors import RasterError
from ltm_core.fire.effect import read_landscape
from ltm_core.fuel.codes import FuelSystem
from ltm_core.fuel.fuel_bands_io import meaning
from ltm_core.fuel.prior import PriorConfig, load_prior, prior_heights
from ltm_core.geometry.grid import GridGeometry

GRID = GridGeometry(300_015.0, 3_700_015.0, 30.0, 4, 1, "EPSG:32611")
VALUES = {
    "elevation": [700, 710, 720, 730],
    "slope": [10, 20, 0, 5],
    "aspect": [90, 180, -1, 270],
    "fbfm13": [1, 5, 10, 8],
    "fbfm40": [102, 145, 165, 183],
    "cover": [0, 15, 45, 75],
    "height": [0, 90, 155, 310],
    "base_height": [0, 12, 18, 38],
    "bulk_density": [0, 4, 11, 19],
    "other": [0, 0, 0, 0],
}
LANDSCAPE = ("elevation", "slope", "aspect", "fbfm40", "cover", "height", "base_height", "bulk_density")


def write(
    path: Path, quantities: tuple[str, ...], names: tuple[str, ...] = (), dtype: str = "int16", **tags: str
) -> Path:
    with rasterio.open(
        path, "w", driver="GTiff", width=4, height=1, count=len(quantities), dtype=dtype, nodata=-9999, crs=GRID.crs,
        transform=GRID.transform(),
    ) as sink:  # fmt: skip
        sink.write(np.array([[VALUES[name]] for name in quantities]).astype(dtype))
        if names:
            sink.descriptions = names
        sink.update_tags(**tags)
    return path


@pytest.mark.parametrize(
    ("name", "quantity"),
    [
        ("fbfm40", "fbfm40"), ("LC22_F40_230", "fbfm40"), ("US_200FBFM40", "fbfm40"), ("fbfm40_2023-08-13", "fbfm40"),
        ("FuelModel_40", "fbfm40"), ("ScottBurgan40", "fbfm40"), ("F13", "fbfm13"), ("Anderson 13", "fbfm13"),
        ("cc_utm_13", "cover"), ("cc_40m", "cover"), ("LC22_CC_230", "cover"), ("Canopy Cover (%)", "cover"),
        ("CanopyBaseHeight", "base_height"), ("canopy_base_height", "base_height"), ("US_140CBH", "base_height"),
        ("CanopyHeight", "height"), ("Stand Height", "height"), ("CBD", "bulk_density"),
        ("Canopy Bulk Density (kg/m^3 * 100)", "bulk_density"), ("US_DEM2010", "elevation"), ("SlpD", "slope"),
        ("LC20_SlpP_220", "slope"), ("US_ASP2020", "aspect"), ("fuel", "codes"), ("Fuel Model", "codes"),
        ("200CC_20", "cover"), ("ELEV2020", "elevation"), ("200F40_20", "fbfm40"), ("SLPP2020", "slope"),
        ("240CBD", "bulk_density"), ("Fuel models", "codes"), ("Coarse woody debris", "other"),
        ("LC22_EVT_230", "vegetation"), ("220FVC_20", "vegetation"),
        ("Layer_1", None), ("band 40", None), ("13", None), ("road_density", None),
        ("base_map", None), ("fuel_moisture", None), ("cc_ch", None),
        ("fuel_map_ch", None),
    ],
)  # fmt: skip
def test_names(name: str, quantity: str | None) -> None:
    found = meaning(name)
    assert (found and found[0]) == quantity


ORDERS = {
    "WindNinja's": ("fbfm40", "cover", "height", "bulk_density", "base_height"),
    "both systems": (*LANDSCAPE[:3], "fbfm13", *LANDSCAPE[3:]),
    "FlamMap's": LANDSCAPE,
    "FlamMap's with ground fuel": (*LANDSCAPE, "other", "other"),
    "alphabetic": tuple(sorted(LANDSCAPE)),
}
NAMED = {
    "elevation": "US_DEM2020", "slope": "SlpD", "aspect": "Asp", "fbfm13": "F13", "fbfm40": "LC22_F40_230",
    "cover": "CC", "height": "CH", "base_height": "CBH", "bulk_density": "CBD", "other": "",
}  # fmt: skip


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("where", ["descriptions", "tag", "nowhere"])
def test_bands_of_a_landscape(tmp_path: Path, order: str, where: str) -> None:
    quantities = ORDERS[order]
    names = tuple(NAMED[name] for name in quantities)
    path = tmp_path / "a.tif"
    if where == "nowhere" and not order.startswith("FlamMap"):
        write(path, quantities, tuple(f"Layer_{k}" for k in range(len(quantities))))
        with pytest.raises(RasterError, match=str(len(quantities)) if len(quantities) == 9 else r"band \d"):
            load_prior(PriorConfig(path=path), GRID)
        return
    if where == "tag":
        write(path, quantities, BANDS=";".join(name or "duff" for name in names))
    else:
        write(path, quantities, names if where == "descriptions" else ())
    prior = load_prior(PriorConfig(path=path), GRID)
    assert prior.system is FuelSystem.FBFM40
    assert prior.codes[0].tolist() == VALUES["fbfm40"]
    assert (None if prior.fbfm13 is None else "fbfm13") == ("fbfm13" if "fbfm13" in quantities else None)
    assert prior.canopy is not None
    assert prior.canopy[:, 0].tolist() == [VALUES[n] for n in ("cover", "height", "base_height", "bulk_density")]
    heights = prior_heights(PriorConfig(path=path), GRID)
    if "elevation" in quantities:
        assert heights is not None
        assert heights[0].tolist() == VALUES["elevation"]
        assert read_landscape(path).bands[:, 0].tolist() == [VALUES[name] for name in LANDSCAPE]
    else:
        assert heights is None
        with pytest.raises(RasterError, match="elevation, slope, aspect"):
            read_landscape(path)


@pytest.mark.parametrize("cover", ["cc_utm_13.tif", "CanopyCover.tif", "cc_40m.tif", "US_140CC.tif"])
def test_a_folder_of_names_that_hold_other_numbers(tmp_path: Path, cover: str) -> None:
    for name, quantity in (
        ("fbfm40_2023-08-13.tif", "fbfm40"), (cover, "cover"), ("CanopyHeight.tif", "height"),
        ("CanopyBaseHeight.tif", "base_height"), ("canopy-bulk-density.tif", "bulk_density"), ("adj.tif", "other"),
        ("shrubs.tif", "cover"),
    ):  # fmt: skip
        write(tmp_path / name, (quantity,))
    prior = load_prior(PriorConfig(path=tmp_path), GRID)
    assert prior.codes[0].tolist() == VALUES["fbfm40"]
    assert prior.fbfm13 is None
    assert prior.canopy is not None
    assert prior.canopy[:, 0].tolist() == [VALUES[n] for n in LANDSCAPE[4:]]
    assert len(prior.remarks) == 1
    assert "shrubs.tif" in prior.remarks[0]
    assert "adj.tif" not in prior.remarks[0]


@pytest.mark.parametrize("table", ["vat.dbf", "aux.xml"])
def test_an_attribute_table_goes_before_the_name(tmp_path: Path, table: str) -> None:
    path = write(tmp_path / "f13.tif", ("fbfm40",))
    write(tmp_path / "ch.tif", ("cover",))
    for raster, column in ((path, "FBFM40"), (tmp_path / "ch.tif", "CC_PERCENT")):
        beside = raster.with_name(f"{raster.name}.{table}")
        if table == "aux.xml":
            names = "".join(f"<FieldDefn><Name>{name}</Name></FieldDefn>" for name in ("Value", column))
            rat = f"<GDALRasterAttributeTable>{names}</GDALRasterAttributeTable>"
            beside.write_text(f'<PAMDataset><PAMRasterBand band="1">{rat}</PAMRasterBand></PAMDataset>')
        else:
            fields = b"".join(struct.pack("<11sc4xB15x", name.encode(), b"N", 10) for name in ("VALUE", column))
            beside.write_bytes(struct.pack("<4BIHH20x", 3, 124, 4, 23, 0, 65 + 32, 21) + fields + b"\r")
    prior = load_prior(PriorConfig(path=tmp_path), GRID)
    assert prior.codes[0].tolist() == VALUES["fbfm40"]
    assert prior.canopy is not None
    assert prior.canopy[0, 0].tolist() == VALUES["cover"]


@pytest.mark.parametrize(
    ("name", "given"),
    [("LC22_CC_230.tif", "path"), ("LC22_EVT_230.tif", "fbfm40"), ("fbfm13.tif", "fbfm40"), ("ch.tif", "cover")],
)
def test_a_file_that_holds_something_else_by_its_name(tmp_path: Path, name: str, given: str) -> None:
    files = {"fbfm40": write(tmp_path / "mine.tif", ("fbfm40",))} if given == "cover" else {}
    files |= {given: write(tmp_path / name, ("cover",))}
    with pytest.raises(RasterError, match=name):
        load_prior(PriorConfig(**files), GRID)


def test_percent_slopes_become_degrees_for_a_fire(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", LANDSCAPE, ("Elev", "SlpP", "Asp", "F40", "CC", "CH", "CBH", "CBD"))
    assert read_landscape(path).bands[1, 0].tolist() == [6, 11, 0, 3]
