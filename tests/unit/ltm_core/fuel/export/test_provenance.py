import json
import zipfile
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio

from ltm_core.fuel.codes import FuelClimate, FuelSystem
from ltm_core.fuel.decision import layers_of_classes
from ltm_core.fuel.export.companion_files_io import style_path, write_item, write_kmz
from ltm_core.fuel.export.landscape import LANDSCAPE_UNITS, Landscape
from ltm_core.fuel.export.landscape_io import write_elmfire, write_landscape, write_layers
from ltm_core.fuel.export.provenance import (
    NOTHING_SEEN,
    WITHOUT_DATES,
    Provenance,
    landfire_version,
    landscape_units,
    software,
)
from ltm_core.fuel.life_form import NODATA, life_form_labels
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_fuel import provenance_of
from ltm_core.site.site import Site
from ltm_core.vision.labels import LabelSet

GRID = GridGeometry(531_783.25, 4_280_398.25, 30.0, 37, 29, "EPSG:32610")
MADE = Provenance(
    "ridge <1>", "2026-05-31T18:04:05+00:00", 1073, 0.25, 0.0125, "LC22_F40_230.tif", "LANDFIRE 2022, version 2.3.0",
    "dry", FuelSystem.FBFM40, "ltm 0.1.0", "7 cells with a code have no elevation and are nodata", labels="unmeasured",
)  # fmt: skip
EXPECTED = {
    "site": "ridge <1>",
    "as_of": "2026-05-31T18:04:05+00:00",
    "cells_with_code": "1073",
    "seen_share": "0.2500",
    "changed_share": "0.0125",
    "prior": "LC22_F40_230.tif",
    "prior_version": "LANDFIRE 2022, version 2.3.0",
    "fuel_region": "dry",
    "fuel_system": "fbfm40",
    "software": "ltm 0.1.0",
    "terrain": "7 cells with a code have no elevation and are nodata",
    "labels": "unmeasured",
    "TIFFTAG_SOFTWARE": "ltm 0.1.0",
    "TIFFTAG_DATETIME": "2026:05:31 18:04:05",
}


def landscape() -> Landscape:
    rng = np.random.default_rng(5)
    bands = [rng.integers(300, 400, GRID.shape), rng.integers(0, 40, GRID.shape), rng.integers(0, 360, GRID.shape)]
    bands += [rng.choice([91, 102, 145, 165, 20], GRID.shape), *(rng.choice([0, 5], GRID.shape) for _ in range(4))]
    return Landscape(np.array(bands, np.int16), GRID)


def has_tags(source: rasterio.DatasetReader) -> bool:
    tags = source.tags()
    return EXPECTED.items() <= tags.items() and "seen 25.0%, changed 1.2%" in tags["TIFFTAG_IMAGEDESCRIPTION"]


def palette_of(path: Path) -> dict[int, str]:
    root = ElementTree.parse(path).getroot()
    assert root.tag == "qgis"
    return {int(e.get("value", "")): str(e.get("label")) for e in root.iter("paletteEntry")}


def test_a_geotiff_landscape(tmp_path: Path) -> None:
    made = landscape()
    path = write_landscape(tmp_path / "a.tif", made, MADE.tags() | landscape_units())
    with rasterio.open(path) as source:
        assert has_tags(source)
        assert source.units == LANDSCAPE_UNITS
        assert source.tags()["unit_base_height"] == "m x 10"
        assert source.tags()["TIFFTAG_SOFTWARE"] == "ltm 0.1.0"
    assert palette_of(style_path(path)) == {20: "20 20", 91: "91 NB1", 102: "102 GR2", 145: "145 SH5", 165: "165 TU5"}
    renderer = ElementTree.parse(style_path(path)).getroot().find("pipe/rasterrenderer")
    assert renderer is not None
    assert (renderer.get("type"), renderer.get("band")) == ("paletted", "4")


def test_somebodys_own_style_stays(tmp_path: Path) -> None:
    style_path(tmp_path / "a.tif").write_text("<qgis/>")
    for _ in range(2):
        write_landscape(tmp_path / "a.tif", landscape())
        write_landscape(tmp_path / "b.tif", landscape())
    assert style_path(tmp_path / "a.tif").read_text() == "<qgis/>"
    assert palette_of(style_path(tmp_path / "b.tif"))


def test_every_file_of_an_elmfire_folder(tmp_path: Path) -> None:
    folder = write_elmfire(tmp_path / "inputs", landscape(), MADE.tags())
    rasters = sorted(folder.glob("*.tif"))
    assert len(rasters) == 10
    units = {}
    for path in rasters:
        with rasterio.open(path) as source:
            assert has_tags(source), path
            units[path.stem] = source.units[0]
    assert units == {
        "dem": "m", "slp": "degrees", "asp": "degrees", "fbfm40": "code", "cc": "percent", "ch": "m x 10",
        "cbh": "m x 10", "cbd": "kg/m3 x 100", "adj": "1", "phi": "1",
    }  # fmt: skip
    assert palette_of(folder / "fbfm40.qml")[102] == "102 GR2"


def test_every_cloud_optimized_layer(tmp_path: Path) -> None:
    classes = np.random.default_rng(3).choice([1, 2, 3, 255], GRID.shape).astype(np.uint8)
    layers = layers_of_classes(classes, None, FuelClimate.named("dry"))
    palette = life_form_labels(LabelSet.load())
    write_layers(tmp_path / "layers", layers, GRID, MADE.tags(), palette)
    for path in (tmp_path / "layers").glob("*.tif"):
        with rasterio.open(path) as source:
            assert has_tags(source), path
            assert source.tags()["unit"]
            assert source.descriptions == (path.stem,)
            assert source.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert style_path(path).is_file()
    assert palette_of(tmp_path / "layers/life_form.qml")[3] == "tree"
    root = ElementTree.parse(tmp_path / "layers/p_max.qml").getroot()
    assert root.findtext("pipe/rasterrenderer/contrastEnhancement/maxValue") == "1"


def test_a_kmz_tells_it_where_one_clicks(tmp_path: Path) -> None:
    picture = np.zeros((58, 74, 3), np.uint8)
    write_kmz(tmp_path / "a.kmz", picture, GRID, "a & b", picture[:4, :9], MADE)
    document = ElementTree.fromstring(zipfile.ZipFile(tmp_path / "a.kmz").read("doc.kml"))
    kml = "{http://www.opengis.net/kml/2.2}"
    told = {d.get("name"): d.findtext(f"{kml}value") for d in document.iter(f"{kml}Data")}
    assert {key: value for key, value in EXPECTED.items() if "TIFFTAG" not in key}.items() <= told.items()
    assert document.findtext(f"{kml}Document/{kml}TimeStamp/{kml}when") == "2026-05-31T18:04:05Z"
    assert document.findtext(f"{kml}Document/{kml}name") == "a & b"


@pytest.mark.parametrize("as_of", [MADE.as_of, NOTHING_SEEN, WITHOUT_DATES])
def test_a_stac_item(tmp_path: Path, as_of: str) -> None:
    """By the rules of the item specification (STAC 1.0.0); pystac's schemas agree."""
    made = Provenance(**{**vars(MADE), "as_of": as_of})
    path = write_item(tmp_path / "a.tif", [tmp_path / "a.tif"], GRID, made)
    assert path.name == "a.tif.stac.json"
    item = json.loads(path.read_text())
    assert (item["type"], item["stac_version"]) == ("Feature", "1.0.0")
    west, south, east, north = item["bbox"]
    assert -122.7 < west < east < -122.5
    assert 38.6 < south < north < 38.7
    ring = item["geometry"]["coordinates"][0]
    assert ring[0] == ring[-1]
    assert len(ring) == 5
    properties = item["properties"]
    if as_of == MADE.as_of:
        assert properties["datetime"] == "2026-05-31T18:04:05Z"
    else:
        assert properties["datetime"] is None
        assert datetime.fromisoformat(properties["start_datetime"]) <= datetime.fromisoformat(
            properties["end_datetime"]
        )
    assert properties["ltm:changed_share"] == "0.0125"
    assert properties["proj:shape"] == [29, 37]
    assert properties["proj:transform"] == [30.0, 0.0, GRID.x_min, 0.0, -30.0, GRID.y_max]
    assert item["assets"]["a.tif"]["href"] == "./a.tif"
    assert item["links"] == []
    assert item["id"]


def test_of_a_map(tmp_path: Path) -> None:
    site = Site.model_validate(
        {"name": "ridge", "crs": "EPSG:32610", "origin": [531_783.0, 4_280_398.0], "dem": {"path": "d.tif"},
         "cameras": {"north": {}}, "fuel": {"prior": {"path": "p/LC22_F40_230.tif"}, "climate": "humid"}}
    )  # fmt: skip
    codes = np.full(GRID.shape, 102, np.int16)
    codes[0] = NODATA
    prior = FuelPrior(codes, GRID)
    classes = np.full(GRID.shape, 255, np.uint8)
    classes[3:5, 5:12] = 3
    classes[7, 5:12] = 1
    layers = layers_of_classes(classes, prior, FuelClimate.named("humid"))
    undated = provenance_of(site, layers, FuelSystem.FBFM13)
    assert (undated.as_of, undated.seen, undated.moment()) == (WITHOUT_DATES, None, None)
    stamps = np.where(layers.evidence > 0, np.int64(1_780_000_000_123_456_789), 0)
    layers = replace(layers, last_seen=stamps)
    made = provenance_of(site, layers, FuelSystem.FBFM13)
    cells = 28 * 37
    assert (made.site, made.cells, made.climate, made.system) == ("ridge", cells, "humid", FuelSystem.FBFM13)
    assert made.seen == pytest.approx(21 / cells)
    assert made.changed == pytest.approx(14 / cells)
    assert made.as_of == "2026-05-28T20:26:40+00:00"
    assert made.prior == "LC22_F40_230.tif"
    assert made.prior_version.startswith("LANDFIRE 2022, version 2.3.0, sha256 ")
    other = provenance_of(
        site, layers_of_classes(classes, FuelPrior(codes + 1, GRID), FuelClimate.named("dry")), made.system
    )
    assert other.prior_version != made.prior_version
    then = provenance_of(site, layers, FuelSystem.FBFM40, moment_ns=1_780_000_000_123_456_789)
    assert (then.as_of, then.seen) == ("2026-05-28T20:26:40+00:00", None)
    assert then.tags()["seen_share"] == "unknown"
    nothing = provenance_of(
        site, layers_of_classes(np.full(GRID.shape, 255, np.uint8), prior, FuelClimate.named("dry")), FuelSystem.FBFM40
    )
    beside = FuelPrior(codes, GRID, fbfm13=np.ones(GRID.shape, np.int16))
    kept = provenance_of(site, layers, FuelSystem.FBFM13, prior=beside).tags()
    assert kept["own_fbfm13"] == "within_fuel_type", "the numbers depend on it"
    for other_prior, system in ((prior, FuelSystem.FBFM13), (beside, FuelSystem.FBFM40)):
        assert "own_fbfm13" not in provenance_of(site, layers, system, prior=other_prior).tags()
    assert nothing.as_of == NOTHING_SEEN
    assert "TIFFTAG_DATETIME" not in nothing.tags()
    assert software() in nothing.line()


@pytest.mark.parametrize(
    ("name", "released"),
    [("LC22_F40_230.tif", "LANDFIRE 2022, version 2.3.0"), ("LC20_Elev_220.tif", "LANDFIRE 2020, version 2.2.0"),
     ("prior.tif", ""), ("LC22_F40_2300.tif", "")],
)  # fmt: skip
def test_landfires_version_by_its_name(name: str, released: str) -> None:
    assert landfire_version(name) == released
