import json
from pathlib import Path

import numpy as np
import pytest
from scenes.fuel_frames import BEGIN_NS, CAMERAS, LABELS, grid_of, write_site
from scenes.fuel_map_node import Node, assert_same_state

from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.site.site_io import load_site
from ltm_msgs_py.pointcloud import votes_to_msg
from ltm_ros.fuel_map.self_measurement import MEASURED_AT
from ltm_ros.fuel_map.source import FuelSource
from ltm_ros.runtime.topics import FUEL_MAP_INFO

HOUR_NS = 3600 * 10**9
MODEL = "mosaic_r4_ade20k31"  # never measured
SWAPPED = {LifeForm.GRASS: 1, LifeForm.SHRUB: 3, LifeForm.TREE: 2}  # calls trees shrubs, and shrubs trees


def truth_of(grid: GridGeometry) -> np.ndarray:
    """Return three stripes of grass, shrub and trees; the prior map has them."""
    return 1 + (np.indices(grid.shape)[0] * 3 // grid.height)


def changed_truth(grid: GridGeometry) -> np.ndarray:
    truth = truth_of(grid)
    middle = grid.height // 2
    truth[middle - 4 : middle + 4, 20:28] = LifeForm.TREE
    return truth


@pytest.fixture
def site(tmp_path: Path) -> Path:
    plain = write_site(tmp_path)
    grid = load_site(plain).in_crs(grid_of(plain))
    codes = np.array([0, 102, 145, 165], np.int16)[truth_of(grid)]
    write_geotiff(tmp_path / "prior.tif", codes, grid, -9999)
    return write_site(tmp_path, fuel={"prior": "prior.tif"}, model=MODEL)


def frame(number: int, grid: GridGeometry) -> CellVotes:
    """Return the votes of a camera that sees all cells from one of two directions, hours apart, and errs in 12 %."""
    rng = np.random.default_rng(number)
    rows, cols = (index.ravel().astype(np.int32) for index in np.indices(grid.shape))
    shown = np.array([0, *(SWAPPED[form] for form in list(LifeForm)[:3])])[changed_truth(grid)[rows, cols]]
    shown = np.where(rng.random(len(rows)) < 0.12, rng.integers(1, 5, len(rows)), shown)
    counts = np.ones((len(rows), len(LABELS)), np.uint32)
    counts[:, 0] = 0
    counts[np.arange(len(rows)), shown] = 30
    bearing = np.pi / 2 * (number // 3 % 2)
    seen = CellVisibility(*(np.full(len(rows), value, np.float32) for value in (0.3, 5.0, 3.0, 3.0, bearing)))
    z, sure = np.zeros(len(rows), np.float32), np.full(len(rows), 0.8, np.float32)
    return CellVotes(grid, rows, cols, counts, z, BEGIN_NS + number * HOUR_NS, CAMERAS[number % 3], sure, seen)


def feed(node: Node, numbers: range, live: bool) -> None:
    for number in numbers:
        votes = frame(number, node.map.geometry)
        node.handler.on_votes(votes.source, votes_to_msg(votes, LABELS.names))
        if live:
            node.handler.tick(0.5)
        node.handler.idle()


def test_a_map_measures_unmeasured_labels_and_finds_what_has_changed(site: Path, tmp_path: Path) -> None:
    live, offline = (Node(site, folder=str(tmp_path / name)) for name in ("live", "offline"))
    few = MEASURED_AT[0] - 1
    feed(offline, range(few), live=False)
    assert offline.gauge("labels") == "unmeasured"
    assert not offline.map.layers().changed.any()
    feed(offline, range(few, few + 3), live=False)
    state = offline.gauge("labels")
    assert state.startswith("measured on site kept, live (2023-11-15, 12 views")
    assert json.loads(offline.outlet.on(FUEL_MAP_INFO)[-1].data)["labels_measured"] == state
    grid = offline.map.geometry
    new, layers = changed_truth(grid) != truth_of(grid), offline.map.layers()
    assert (layers.life_form[new] == LifeForm.TREE).mean() > 0.85
    assert layers.changed[~new].mean() < 0.01

    # Live, the measurement runs beside the votes, and the result is the same.
    feed(live, range(few + 3), live=True)
    for node in (live, offline):
        node.handler.finish()
    assert_same_state(live.map, offline.map)

    # What was measured is kept with the map, and exports state it.
    again = Node(site, folder=str(tmp_path / "live"))
    assert again.gauge("labels") == state
    assert_same_state(again.map, offline.map)
    with FuelSource.open(tmp_path / "live" / "fuel_map.ltm", load_site(site)) as source:
        np.testing.assert_array_equal(source.layers.code, layers.code)
        assert source.provenance(source.layers, None).tags()["labels"] == state


def test_frames_of_one_view_in_one_hour_count_once(site: Path, tmp_path: Path) -> None:
    node = Node(site, folder=str(tmp_path / "kept"))
    votes = frame(0, node.map.geometry)
    for second in range(2 * MEASURED_AT[0]):
        again = CellVotes(**{**vars(votes), "stamp_ns": votes.stamp_ns + second * 10**9})
        node.handler.on_votes(again.source, votes_to_msg(again, LABELS.names))
        node.handler.idle()
    assert node.gauge("labels") == "unmeasured"
