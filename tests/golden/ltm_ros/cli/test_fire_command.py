"""`ltm fire` by Pyretechnics: of two landscape files, and of a store."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
from scenes.fuel_frames import camera_of, grid_of, message, stamp_of_frame, write_grass_site
from scenes.outlets import Kept
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError
from ltm_core.fire.pyretechnics import interpreter
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.export.landscape_io import write_landscape
from ltm_core.geometry.grid import GridGeometry
from ltm_core.site.site_io import load_site
from ltm_ros.cli.main import cli
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime.health import Health

jinja2 = pytest.importorskip("jinja2", reason="needs the extra `report`")
GRID = GridGeometry(500_000.0, 4_000_000.0, 30.0, 71, 51, "EPSG:32611")


def available() -> bool:
    try:
        return interpreter().is_file()
    except ConfigError:
        return False


pytestmark = pytest.mark.skipif(not available(), reason="no Python that has pyretechnics: `make fire` makes one")


def fire(*arguments: object) -> str:
    result = CliRunner().invoke(cli, ["fire", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_of_two_files(tmp_path: Path) -> None:
    bands = np.zeros((8, *GRID.shape), np.int16)
    bands[2], bands[3] = -1, 102
    was = write_landscape(tmp_path / "was.tif", Landscape(bands.copy(), GRID))
    bands[3, 15:36, 40:44] = 99
    now = write_landscape(tmp_path / "now.tif", Landscape(bands, GRID))
    out = tmp_path / "out"
    told = fire(
        now, "--before", was, "--ignition", "500900,3999235", "--wind", "5,270", "--moisture", "D2L2", "--hours", 2,
        "--out", out,
    )  # fmt: skip
    assert "This is no forecast" in told
    assert sorted(p.name for p in out.iterdir()) == ["fire.json", "fire.kmz", "fire.png", "fire.tif", "index.html"]
    with rasterio.open(out / "fire.tif") as source:
        before, after, changed = source.read(1), source.read(2), source.read(7)
        tags = source.tags()
    np.testing.assert_array_equal(changed == 1, bands[3] == 99)
    assert not np.isfinite(after[changed == 1]).any()
    assert np.isfinite(before[25, 45])
    assert tags["wind"].startswith("5 m/s")
    assert "no forecast" in tags["note"]
    assert tags["fire_model"].startswith("Pyretechnics 20")
    figures = json.loads((out / "fire.json").read_text())
    areas = figures["areas_ha"]
    assert [row["hours"] for row in areas] == [1.0, 2.0]
    assert areas[1]["after"] < areas[1]["before"] == np.isfinite(before).sum() * 0.09
    page = (out / "index.html").read_text()
    assert "This is no forecast" in page
    assert f"{areas[1]['after']:.0f}" in page
    assert "http" not in page
    assert "no forecast" in zipfile.ZipFile(out / "fire.kmz").read("doc.kml").decode()


def test_of_a_store(tmp_path: Path) -> None:
    site = write_grass_site(tmp_path)
    node = FuelMapHandler(FuelMapConfig(site=str(site), folder=str(tmp_path / "kept")), Kept(), Health())
    node.start()
    for number in range(40):
        node.on_votes(camera_of(number), message(number, grid_of(site), stamp_of_frame(number)))
        node.idle()
    node.finish()
    assert node.persistence.map.layers().changed.sum() > 100
    out = tmp_path / "out"
    fire(
        tmp_path / "kept/fuel_map.ltm", "--site", site, "--ignition", "481365,4149865", "--wind", "4,200",
        "--moisture", "6,7,8,60,90", "--hours", 2, "--out", out,
    )  # fmt: skip
    with rasterio.open(out / "fire.tif") as source:
        assert np.nanmax(source.read(2)) <= 2.0
        assert source.tags()["map_site"] == load_site(site).name
        assert source.tags()["map_as_of"].startswith("2023-11-14")
