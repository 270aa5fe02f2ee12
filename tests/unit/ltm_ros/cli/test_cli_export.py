import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
import yaml
from PIL import Image
from scenes.command_line import ltm

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.class_map import read_fuel_map
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.grid import classes_to_msg

LOCAL = GridGeometry(-25.0, 75.0, 30.0, 4, 3)  # in the map frame
CLASSES = np.array([[1, 2, 3, 255], [4, 255, 5, 6], [0, 1, 1, 2]], np.uint8)
IN_CRS = GridGeometry(345_975.0, 3_783_075.0, 30.0, 4, 3, "EPSG:32611")


@pytest.fixture
def site_file(tmp_path: Path) -> Path:
    site = {
        "name": "ridge",
        "crs": "EPSG:32611",
        "origin": [346_000.0, 3_783_000.0],
        "dem": {"path": "dem.tif"},
        "cameras": {"north": {}},
    }
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(site))
    return tmp_path / "site.yaml"


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    with BagWriter(tmp_path / "bag") as writer:
        for stamp, classes in ((10, np.full((3, 4), 255, np.uint8)), (20, CLASSES)):
            writer.write("/ridge/fuel_map", classes_to_msg(classes, LOCAL, stamp), stamp)
        writer.write("/other/fuel_map", classes_to_msg(CLASSES[::-1].copy(), LOCAL, 30), 30)
    return tmp_path / "bag"


def test_the_last_map_of_a_bag(bag: Path, site_file: Path, tmp_path: Path) -> None:
    output = ltm("export", bag, "--site", site_file, "--out", tmp_path / "out.tif")
    assert "4 x 3 cells of 30 m, EPSG:32611" in output
    classes, geometry = read_fuel_map(tmp_path / "out.tif")
    np.testing.assert_array_equal(classes, CLASSES)
    assert geometry == IN_CRS


def test_in_landfires_crs(bag: Path, site_file: Path, tmp_path: Path) -> None:
    assert "EPSG:5070" in ltm(
        "export", bag, "--site", site_file, "--out", tmp_path / "out.tif", "--crs", "EPSG:5070", "--overwrite"
    )
    classes, geometry = read_fuel_map(tmp_path / "out.tif")
    assert (geometry.crs, geometry.x_min % 30, geometry.y_max % 30) == ("EPSG:5070", 15.0, 15.0)
    assert set(np.unique(classes)) <= {0, 1, 2, 3, 4, 5, 6, 255}
    assert (classes != 255).sum() == pytest.approx((CLASSES != 255).sum(), abs=3)


def test_what_fire_models_read(bag: Path, site_file: Path, tmp_path: Path) -> None:
    around = LOCAL.translated(346_000.0 - 60, 3_783_000.0 + 60, "EPSG:32611")
    wide = GridGeometry(around.x_min, around.y_max, 30.0, 9, 8, "EPSG:32611")
    Dem(np.add.outer(-6.0 * np.arange(8.0), np.zeros(9)).astype(np.float32) + 500, wide).save(tmp_path / "dem.tif")
    ltm("export", bag, "--site", site_file, "--out", tmp_path / "map.lcp")
    with rasterio.open(tmp_path / "map.lcp") as source:
        bands = source.read()
    # Grass, shrubs and trees of the dry region; nothing is known of the unseen cells and of what no life form is.
    np.testing.assert_array_equal(bands[3], [[102, 145, 183, -9999], [99, -9999, 98, 91], [-9999, 102, 102, 145]])
    np.testing.assert_array_equal(bands[1], 11)  # atan(6 / 30)
    np.testing.assert_array_equal(bands[2], 180)  # it falls to the south
    np.testing.assert_array_equal(bands[4][0], [0, 0, 55, -9999])
    ltm("export", bag, "--site", site_file, "--out", tmp_path / "map.kmz")
    assert sorted(zipfile.ZipFile(tmp_path / "map.kmz").namelist()) == ["doc.kml", "legend.png", "map.png"]
    # Classes do not say how certain they are: beside life forms and fuel models, a picture shows no uncertainty.
    ltm("export", bag, "--site", site_file, "--out", tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.height < 0.6 * picture.width


def terrain(folder: Path) -> None:
    around = LOCAL.translated(346_000.0 - 60, 3_783_000.0 + 60, "EPSG:32611")
    wide = GridGeometry(around.x_min, around.y_max, 30.0, 9, 8, "EPSG:32611")
    Dem(np.full((8, 9), 500, np.float32), wide).save(folder / "dem.tif")


@pytest.mark.parametrize(
    ("name", "options", "bands"),
    [
        ("map.tif", (), 1),
        ("map.tif", ("--system", "fbfm13"), 8),
        ("map.tif", ("--format", "landscape"), 8),
        ("map.tiff", ("--format", "classes"), 1),
        ("map.lcp", ("--system", "fbfm13"), 8),
        ("map.bin", ("--format", "landscape"), 8),
        ("map.lcp", ("--format", "landscape"), "landscape"),
        ("map.tif", ("--format", "lcp"), "lcp"),
        ("map.png", ("--format", "kmz"), "kmz"),
        ("map.png", ("--system", "fbfm13"), "fbfm13"),
        ("map.tif", ("--format", "classes", "--system", "fbfm13"), "fbfm13"),
    ],
)
def test_the_requested_format_decides(
    bag: Path, site_file: Path, tmp_path: Path, name: str, options: tuple[str, ...], bands: int | str
) -> None:
    terrain(tmp_path)
    out = tmp_path / name
    if isinstance(bands, str):
        with pytest.raises(ConfigError, match=bands):
            ltm("export", bag, "--site", site_file, "--out", out, *options)
        assert not out.exists()
        return
    ltm("export", bag, "--site", site_file, "--out", out, *options)
    with rasterio.open(out) as source:
        assert source.count == bands
        assert source.dtypes[0] == ("uint8" if bands == 1 else "int16")
