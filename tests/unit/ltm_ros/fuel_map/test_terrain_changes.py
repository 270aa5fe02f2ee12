from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point32, PolygonStamped
from scenes.fuel_frames import BEGIN_NS, grid_of, message, write_site
from scenes.outlets import Kept

from ltm_core.base.errors import ConfigError, MessageError
from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.rules import GROWTH, FusionRules
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_surface import terrain_grid
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface.change import Changed, ChangeKind
from ltm_msgs_py.cells import changed_to_msg
from ltm_msgs_py.grid import classes_to_msg, msg_to_classes
from ltm_msgs_py.pointcloud import msg_to_columns
from ltm_msgs_py.stamp import ns_to_time
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_MAP, FUEL_MAP_CELLS, FUEL_MAP_UPDATE, TERRAIN_CHANGE, TERRAIN_UPDATE

CELL = 10.0
DAY = 86400 * 10**9
TREES = 183


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A wood, with a terrain of 10 m cells."""
    plain = write_site(tmp_path)
    grid = load_site(plain).in_crs(grid_of(plain))
    write_geotiff(tmp_path / "prior.tif", np.full(grid.shape, TREES, np.int16), grid, -9999)
    return write_site(tmp_path, fuel={"prior": "prior.tif"}, terrain={"resolution": CELL})


class Node:
    def __init__(self, site: Path, folder: Path | None = None, now: int = 0) -> None:
        self.outlet, self.health = Kept(FUEL_MAP_CELLS), Health()
        self.outlet.now = now
        kept = "" if folder is None else str(folder)
        config = FuelMapConfig(site=str(site), folder=kept, allow_burn=True)
        self.handler = FuelMapHandler(config, self.outlet, self.health)
        self.handler.start()
        self.fuel = grid_of(site)
        self.terrain = terrain_grid(load_site(site).open_dem().geometry, CELL)
        self.listens = dict(self.handler.subscriptions)

    @property
    def life_form(self) -> np.ndarray:
        return self.handler.persistence.map.layers().life_form

    def hear(self, kinds: np.ndarray, stamp: int = BEGIN_NS) -> None:
        self.listens[TERRAIN_CHANGE](classes_to_msg(kinds, self.terrain, stamp))

    def hear_shift(self, rows: np.ndarray, cols: np.ndarray, kind: int, shift: float, stamp: int = BEGIN_NS) -> None:
        self.listens[TERRAIN_UPDATE](update(self.terrain, rows, cols, kind, shift, stamp))

    def kill(self) -> None:
        """As SIGKILL: what is not in the store is gone."""
        self.handler.persistence.store.close()


def update(
    terrain: GridGeometry, rows: np.ndarray, cols: np.ndarray, kind: int, shift: float, stamp: int = BEGIN_NS
) -> Any:
    count = len(rows)
    kinds = np.full(count, kind, np.uint8)
    changed = Changed(rows.astype(np.int32), cols.astype(np.int32), kinds * 0, kinds, np.full(count, shift, np.float32))
    return changed_to_msg(changed, np.full(count, 300.0, np.float32), terrain, stamp)


def felled(node: Node) -> tuple[np.ndarray, np.ndarray]:
    """Kinds of change with two by three fuel cells felled, seen all around; and the mask of these fuel cells."""
    kinds = np.full(node.terrain.shape, 255, np.uint8)
    kinds[20:160, 30:200] = ChangeKind.NONE
    x, y = node.fuel.to_map(np.array([20, 22]), np.array([31, 34]))
    row, col = node.terrain.cell_of(x - 10, y + 10)
    kinds[row[0] : row[1], col[0] : col[1]] = ChangeKind.REMOVED
    mask = np.zeros(node.fuel.shape, bool)
    mask[20:22, 31:34] = True
    return kinds, mask


def test_a_felled_wood_appears_in_the_map_once(site: Path, tmp_path: Path) -> None:
    node = Node(site, tmp_path / "kept")
    kinds, mask = felled(node)
    node.hear_shift(*np.nonzero(kinds == ChangeKind.REMOVED), ChangeKind.REMOVED, -14.0)
    node.hear(kinds)
    expected = np.where(mask, LifeForm.GRASS, LifeForm.TREE)
    np.testing.assert_array_equal(node.life_form, expected)
    assert node.outlet.stamps(FUEL_MAP_UPDATE) == [BEGIN_NS]
    state = node.handler.persistence.map.tile_state((0, 0))
    node.hear(kinds)
    node.hear(kinds, BEGIN_NS + DAY)
    assert node.outlet.stamps(FUEL_MAP_UPDATE) == [BEGIN_NS], "the same again is told to nobody"
    for name, values in node.handler.persistence.map.tile_state((0, 0)).items():
        np.testing.assert_array_equal(values, state[name])
    node.handler.tick(5.0)
    np.testing.assert_array_equal(msg_to_classes(node.outlet.on(FUEL_MAP)[-1])[0], expected)
    cells = msg_to_columns(node.outlet.on(FUEL_MAP_CELLS)[-1])
    assert cells["changed"].sum() == mask.sum()
    assert set(cells["prior"].tolist()) == {TREES}
    touches = node.handler.persistence.store.touches((0, 0))
    assert [(t.source, t.frames, t.first_ns) for t in touches] == [("terrain", 1, BEGIN_NS)]


def test_kills_neither_lose_nor_repeat_what_was_told(site: Path, tmp_path: Path) -> None:
    node = Node(site, tmp_path / "kept")
    kinds, mask = felled(node)
    node.handler.on_votes("north", message(0, node.fuel))
    node.hear(kinds)
    expected, state = node.life_form, node.handler.persistence.map.tile_state((0, 1))
    node.kill()
    again = Node(site, tmp_path / "kept")
    np.testing.assert_array_equal(again.life_form, expected)
    again.hear(kinds)
    for name, values in again.handler.persistence.map.tile_state((0, 1)).items():
        np.testing.assert_array_equal(values, state[name], err_msg=name)
    assert again.outlet.on(FUEL_MAP_UPDATE) == []
    kinds[kinds == ChangeKind.REMOVED] = ChangeKind.NONE
    again.hear(kinds, BEGIN_NS + DAY)
    assert (again.life_form[mask] == LifeForm.TREE).all(), "what is taken back in one, is taken back in the other"
    again.kill()
    config = load_site(site)
    with TileStore.open_read_only(tmp_path / "kept" / "fuel_map.ltm", "fuel") as store:
        nothing = np.zeros(config.fuel_geometry(config.open_dem()).shape, np.int32)
        np.testing.assert_array_equal(store.as_of("surface", nothing, BEGIN_NS), np.where(mask, 1102, 0))
        np.testing.assert_array_equal(store.as_of("surface", nothing, 2**62), nothing)


def test_hostile_and_misplaced_changes_move_nothing(site: Path) -> None:
    node = Node(site, now=BEGIN_NS)
    kinds, _ = felled(node)
    t = node.terrain

    def sent(classes: np.ndarray = kinds, grid: GridGeometry = t, stamp: int = BEGIN_NS, **header: Any) -> Any:
        made = classes_to_msg(classes, grid, stamp)
        for name, value in header.items():
            setattr(made.header, name, value)
        return made

    forged = sent()
    forged.info.width = 2**31
    five = kinds.copy()
    five[3, 4] = 5
    cases = {
        "expected 'map'": sent(frame_id="odom"),
        f"this site has {t.width * t.height} cells": forged,
        "is outside the grid": sent(grid=t.translated(5000.0, 0.0)),
        "is not aligned with": sent(grid=t.translated(3.0, 0.0)),
        "kind 5": sent(five),
    }
    for complaint, bad in cases.items():
        with pytest.raises(MessageError, match=complaint):
            node.listens[TERRAIN_CHANGE](bad)
    node.listens[TERRAIN_CHANGE](sent(stamp=BEGIN_NS + 601 * 10**9))
    assert node.health.dropped == {"future": 1}
    assert (node.life_form == LifeForm.TREE).all()
    assert node.outlet.on(FUEL_MAP_UPDATE) == []

    cells = tuple(part[:5] for part in np.nonzero(kinds == ChangeKind.REMOVED))
    far = update(t, *cells, ChangeKind.GROWN, 4.0)
    far.data[0:4] = array("B", np.float32(9e5).tobytes())
    beyond = update(t, cells[0] + t.height, cells[1], ChangeKind.GROWN, 4.0)
    for complaint, bad in {
        "not a change on": far,
        f"not a change on .* of .{t.height}, {t.width}. cells": beyond,
        "shift nan": update(t, *cells, ChangeKind.GROWN, float("nan")),
        "change is 9": update(t, *cells, 9, 4.0),
    }.items():
        with pytest.raises(MessageError, match=complaint):
            node.listens[TERRAIN_UPDATE](bad)
    node.hear(kinds)
    unharmed = Node(site)
    unharmed.hear(kinds)
    told = node.handler.persistence.map.surface_changes
    assert told.any()
    np.testing.assert_array_equal(
        told, unharmed.handler.persistence.map.surface_changes, err_msg="a bad shift was taken"
    )
    shown = node.life_form
    node.hear(np.full(t.shape, 0, np.uint8), BEGIN_NS - DAY)
    assert node.health.dropped == {"future": 1, "too_old": 1}
    np.testing.assert_array_equal(node.life_form, shown)


def region(grid: GridGeometry, rows: tuple[int, int], cols: tuple[int, int], stamp: int) -> PolygonStamped:
    drawn = PolygonStamped()
    drawn.header.frame_id, drawn.header.stamp = "map", ns_to_time(stamp)
    corners = [grid.to_map(r - 0.5, c - 0.5) for r, c in zip(np.repeat(rows, 2), (*cols, *cols[::-1]), strict=True)]
    drawn.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in corners]
    return drawn


@pytest.fixture
def kept(site: Path, tmp_path: Path) -> Callable[..., Node]:
    return lambda now=0: Node(site, tmp_path / "kept", now)


def test_a_burned_region_is_burned_until_it_grows_over(kept: Callable[..., Node]) -> None:
    node = kept(now=BEGIN_NS)
    with pytest.raises(ConfigError, match="fuel_map/region"):
        node.handler.burn()
    node.handler.on_region(region(node.fuel, (5, 12), (40, 60), BEGIN_NS - DAY))
    assert node.handler.burn() == f"140 cells burned at stamp {BEGIN_NS - DAY} ns"
    mask = np.zeros(node.fuel.shape, bool)
    mask[5:12, 40:60] = True
    np.testing.assert_array_equal(node.life_form, np.where(mask, LifeForm.BURNED, LifeForm.TREE))
    (tile,) = node.outlet.on(FUEL_MAP_UPDATE)
    shown = np.array(tile.data).reshape(tile.info.height, tile.info.width)
    about = FusionRules().support_cells + 1 + GROWTH  # with the cells whose changes it may have a say in
    assert shown.shape == (5 + 7 + about, 20 + 2 * about)
    np.testing.assert_array_equal(shown == LifeForm.BURNED, mask[: 12 + about, 40 - about : 60 + about][::-1])
    node.kill()
    again = kept(now=BEGIN_NS)
    np.testing.assert_array_equal(again.life_form == LifeForm.BURNED, mask)
    touches = again.handler.persistence.store.touches((0, 1))
    assert [(t.source, t.first_ns) for t in touches] == [("fuel_map/burn", BEGIN_NS - DAY)]
    again.handler.on_votes("north", message(0, again.fuel, BEGIN_NS + 200 * DAY))  # not yet, by this node's clock
    assert again.health.dropped == {"future": 1}
    again.outlet.now = BEGIN_NS + 200 * DAY
    again.handler.on_votes("north", message(0, again.fuel, BEGIN_NS + 200 * DAY))
    again.handler.idle()
    grown = again.handler.persistence.map.layers()
    assert not (grown.life_form[mask] == LifeForm.BURNED).any()
    assert set(grown.code[mask].tolist()) == {101}
