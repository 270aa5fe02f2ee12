from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from scenes.fuel_frames import (
    BEGIN_NS,
    LABELS,
    NAME,
    camera_of,
    grid_of,
    message,
    stamp_of_frame,
    write_grass_site,
    write_site,
)
from scenes.outlets import Kept
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.codes import FuelClimate
from ltm_core.fuel.decision import FuelLayers, layers_of_classes
from ltm_core.fuel.life_form import LifeForm, life_form_labels
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.fuel_maps import (
    FuelCanvas,
    change_sheet,
)
from ltm_core.pictures.maps import MapCamera
from ltm_core.raster.dem import Dem
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.grid import classes_to_msg
from ltm_ros.cli.main import cli
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime.health import Health

PALETTE = life_form_labels(LABELS)
GRID = GridGeometry(100.0, 900.0, 30.0, 24, 16)
PINK = (230, 0, 140)


def flat() -> Dem:
    geometry = GridGeometry(100.0, 900.0, 10.0, 72, 48)
    return Dem(np.full(geometry.shape, 300.0, np.float32), geometry)


def layers(classes: np.ndarray) -> FuelLayers:
    return layers_of_classes(classes, None, FuelClimate.named("dry"))


def bare(canvas: FuelCanvas, picture: np.ndarray) -> np.ndarray:
    """The map of a picture that has axes and a legend about it."""
    margin = picture.shape[1] - canvas.view.width
    return picture[: canvas.view.height, margin:]


def test_cells_lie_on_their_place_and_changed_ones_are_outlined() -> None:
    canvas = FuelCanvas(GRID, flat(), [MapCamera("north", None, (400.0, 500.0))], GRID.bounds, width=720)
    classes = np.full(GRID.shape, 255, np.uint8)
    classes[3:9, 10:20] = LifeForm.TREE
    classes[5:7, 12:15] = LifeForm.BURNED
    changed = classes == LifeForm.BURNED
    drawn = bare(canvas, canvas.classes(classes, PALETTE, changed))
    centre = (np.indices(GRID.shape) * 30 + 15).reshape(2, -1)
    colors = drawn[centre[0], centre[1]].reshape(*GRID.shape, 3).astype(int)
    grey = np.ptp(colors, axis=-1) < 4
    near_camera = np.zeros(GRID.shape, bool)
    near_camera[12:15, 8:14] = True
    np.testing.assert_array_equal((grey | near_camera)[classes == 255], True)
    assert (colors[classes == LifeForm.TREE][:, 1] > colors[classes == LifeForm.TREE][:, 0] + 20).all()
    assert (colors[changed].sum(axis=-1) < colors[classes == LifeForm.TREE].sum(axis=-1).min()).all()
    pink = np.argwhere((drawn == PINK).all(axis=-1))
    assert pink.min(axis=0).tolist() == [150, 360]
    assert pink.max(axis=0).tolist() == [209, 449]


def test_the_panels_of_a_change_sheet_differ_in_changed_cells_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Codes of grass with shrubs stand for both: their life form may flip without a change of fuel."""
    prior = FuelPrior(np.full(GRID.shape, 122, np.int16), GRID)
    prior.codes[12:] = 98
    classes = np.full(GRID.shape, 255, np.uint8)
    before = layers_of_classes(classes, prior, FuelClimate.named("dry"))
    classes[2:10, 3:20] = LifeForm.SHRUB
    classes[4, 4:9] = LifeForm.TREE
    after = layers_of_classes(classes, prior, FuelClimate.named("dry"))
    drawn: list[tuple[np.ndarray, np.ndarray]] = []
    whole = FuelCanvas.classes

    def spied(canvas: FuelCanvas, forms: np.ndarray, palette: Any, outlined: np.ndarray) -> Any:
        drawn.append((forms, outlined))
        return whole(canvas, forms, palette, outlined)

    monkeypatch.setattr(FuelCanvas, "classes", spied)
    change_sheet(FuelCanvas(GRID, flat(), [], GRID.bounds, width=300), before, after, PALETTE, ("then", "now"))
    (then, outlined), (now, _) = drawn
    assert (before.life_form != after.life_form).sum() == 8 * 17
    assert outlined.sum() == after.changed.sum() == 5
    np.testing.assert_array_equal(then != now, outlined)


def export(*arguments: Any) -> str:
    result = CliRunner().invoke(cli, ["export", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, FuelMapHandler]:
    """Site file and store of a map whose covers change over the years, and its node, which has ended."""
    folder = tmp_path_factory.mktemp("kept")
    site = write_grass_site(folder)
    node = FuelMapHandler(FuelMapConfig(site=str(site), folder=str(folder / "kept")), Kept(), Health())
    node.start()
    for number in range(60):
        stamp = stamp_of_frame(number) + (number // 30) * 400 * 86400 * 10**9
        node.on_votes(camera_of(number), message(number + 200 * (number // 30), grid_of(site), stamp))
        node.idle()
    node.finish()
    return site, folder / "kept" / "fuel_map.ltm", node


def test_a_store_is_drawn_and_told_as_of_any_date(kept: tuple[Path, Path, FuelMapHandler], tmp_path: Path) -> None:
    site, store, node = kept
    now = node.persistence.map.layers()
    for name, arguments in {
        "now.tif": (),
        "first.tif": ("--as-of", "2023-11-15"),
        "before.tif": ("--as-of", "2023-11-13"),
    }.items():
        export(store, "--site", site, "--out", tmp_path / name, *arguments)
    found = {}
    for name in ("now", "first", "before"):
        with rasterio.open(tmp_path / f"{name}.tif") as source:
            found[name] = source.read(1)
    assert (found["before"] == LifeForm.GRASS).all(), "the prior"
    assert (found["first"] != found["before"]).sum() > 20
    assert (found["now"] != found["first"]).sum() > 20
    np.testing.assert_array_equal(found["now"], now.life_form)
    export(store, "--site", site, "--out", tmp_path / "then.lcp", "--as-of", "2023-11-15")
    with rasterio.open(tmp_path / "then.lcp") as source:
        heights, fuel = source.read(1), source.read(4)
    assert (heights[1:] != -9999).all()
    assert (fuel[heights == -9999] == -9999).all(), "a cell without a height has no code"
    np.testing.assert_array_equal(fuel == 102, (found["first"] == LifeForm.GRASS) & (heights != -9999))
    for kind in ("png", "change"):
        export(store, "--site", site, "--out", tmp_path / f"{kind}.png", "--format", kind)
        assert cv2.imread(str(tmp_path / f"{kind}.png")).shape[1] > 1500
    since = tmp_path / "since.png"
    export(
        store, "--site", site, "--out", since, "--format", "change", "--since", "2023-11-15", "--as-of", "2025-12-31"
    )
    assert since.read_bytes() != (tmp_path / "change.png").read_bytes()


def test_a_bag_has_coverage_but_no_history(tmp_path: Path) -> None:
    site = write_site(tmp_path)
    grid = grid_of(site)
    with BagWriter(tmp_path / "bag") as writer:
        for number in range(4):
            writer.write(f"/{NAME}/{camera_of(number)}/fuel/votes", message(number, grid), stamp_of_frame(number))
        writer.write(f"/{NAME}/fuel_map", classes_to_msg(np.ones(grid.shape, np.uint8), grid, BEGIN_NS), BEGIN_NS)
    with pytest.raises(ConfigError, match="needs a store"):
        export(tmp_path / "bag", "--site", site, "--out", tmp_path / "c.lcp", "--as-of", "2024-01-01")
    with pytest.raises(ConfigError, match="give --format change"):
        export(tmp_path / "bag", "--site", site, "--out", tmp_path / "c.lcp", "--since", "2024-01-01")
