import json
import re
import shlex
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest
import rasterio
from PIL import Image
from scenes.fuel_frames import camera_of, grid_of, message, stamp_of_frame, write_grass_site
from scenes.outlets import Kept
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError
from ltm_core.fire.pyretechnics import interpreter
from ltm_core.site.site_io import load_site
from ltm_ros.cli.main import cli
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime.health import Health

PAGE = Path(__file__).parents[2] / "docs/maps.md"
SINCE = "2023-11-14T22:20:00"
"""Between two frames of the store; the guide's own date is after all of them."""


def guide() -> list[list[str]]:
    """Return the words of each command."""
    text = PAGE.read_text(encoding="utf-8").partition("## Guide: from the map to QGIS")[2].partition("\n## ")[0]
    assert len(text.split()) <= 600
    blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    return [words for block in blocks for line in block.splitlines() if (words := shlex.split(line, comments=True))]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a site file and its store, as the current one."""
    folder = tmp_path_factory.mktemp("guide")
    site = write_grass_site(folder)
    node = FuelMapHandler(FuelMapConfig(site=str(site), folder=str(folder / "map")), Kept(), Health())
    node.start()
    for number in range(40):
        node.on_votes(camera_of(number), message(number, grid_of(site), stamp_of_frame(number)))
        node.idle()
    node.finish()
    with chdir(folder):
        yield folder


def does(words: list[str]) -> str:
    result = CliRunner().invoke(cli, words[1:], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_the_guide_has_six_commands() -> None:
    assert [words[:2] for words in guide()] == [*[["ltm", "export"]] * 4, ["make", "fire"], ["ltm", "fire"]]


def test_the_maps_open_as_the_guide_says(folder: Path) -> None:
    drawn, changed, layers, landscape, *_ = guide()
    changed[changed.index("--since") + 1] = SINCE
    said = [does(words) for words in (drawn, changed, layers, landscape)]
    for picture in ("map.png", "change.png"):
        with Image.open(folder / picture) as image:
            assert np.asarray(image.convert("L")).std() > 10
    rasters = sorted((folder / "layers").glob("*.tif"))
    assert len(rasters) > 5
    for raster in rasters:
        assert raster.with_suffix(".qml").is_file()
        with rasterio.open(raster) as source:
            assert source.crs.to_epsg() == 26911
    with rasterio.open(folder / "landscape.tif") as source:
        assert source.count == 8
        assert (source.read(4) != 102).any(), "the map differs from its prior"
    assert "fbfm40" in said[3].lower()


def test_the_fire_burns_on_both_maps(folder: Path) -> None:
    *_, fire = guide()
    try:
        interpreter()
    except ConfigError as error:
        pytest.skip(str(error))
    # In the middle of the small site, whose prior is grass.
    site = load_site(folder / "site.yaml")
    x, y = site.origin
    fire[fire.index("--ignition") + 1] = f"{x + 300:.0f},{y + 300:.0f}"
    assert "This is no forecast" in does(fire)
    figures = json.loads((folder / "out/fire/fire.json").read_text())
    assert figures["areas_ha"][-1]["before"] > 1
    assert "This is no forecast" in (folder / "out/fire/index.html").read_text()
