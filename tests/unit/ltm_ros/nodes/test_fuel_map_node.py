import json
import os
import subprocess
import sys
from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped
from scenes.fuel_frames import (
    BEGIN_NS,
    CAMERAS,
    LABELS,
    message,
    write_site,
)
from scenes.fuel_map_node import Node, state

from ltm_core.base.errors import ConfigError, MessageError
from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.votes import CellVotes
from ltm_core.storage import tile_store_file
from ltm_msgs_py.pointcloud import votes_to_msg
from ltm_ros.runtime.topics import FUEL_MAP_ANSWER


@pytest.fixture
def site(tmp_path: Path) -> Path:
    return write_site(tmp_path)


@pytest.fixture
def kept(site: Path, tmp_path: Path) -> Callable[..., Node]:
    """Makes a node that keeps its map in a folder; the same one each time."""
    return lambda **config: Node(site, folder=str(tmp_path / "kept"), **config)


def test_clocks_that_jump(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tile_store_file, "KEPT_FRAMES", 10)
    now, day = BEGIN_NS + 10**15, 86_400 * 10**9
    node = Node(site, now=now)

    def send(stamp: int, number: int = 0) -> dict[str, int]:
        node.handler.on_votes("north", message(number, node.map.geometry, stamp))
        node.handler.idle()
        return node.health.dropped

    assert send(now + 9 * 10**9) == {}
    assert send(now + 11 * 10**9) == {"future": 1}
    assert "11 s ahead" in node.health.last_error
    assert send(now - 6 * day) == {"future": 1}, "a radio link may have been away for days"
    assert send(now - 8 * day) == {"future": 1, "past": 1}
    assert f"{8 * 86400} s behind" in node.health.last_error
    # A camera that lost its clock says 1970.
    assert send(7) == {"future": 1, "past": 1, "unset_clock": 1}
    assert node.gauge("frames") == "2"
    for number in range(30):
        send(now - day + number)
    assert send(now - 6 * day + 1)["too_old"] == 1


def test_empty_votes_push_out_no_frame(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The attack: more votes that say nothing than a store remembers, each stamped as far ahead as may be."""
    monkeypatch.setattr(tile_store_file, "KEPT_FRAMES", 10)
    now = BEGIN_NS + 10**15
    node = Node(site, now=now)
    grid = node.map.geometry
    for number in range(50):
        none, counts = np.zeros(0, np.int32), np.zeros((0, len(LABELS)), np.uint32)
        nothing = CellVotes(grid, none, none, counts, none.astype(np.float32), now + 9 * 10**9 + number, "north")
        node.handler.on_votes("north", votes_to_msg(nothing, LABELS.names))
        node.handler.idle()
    assert node.gauge("noted.empty_votes") == "50"
    node.handler.on_votes("north", message(0, grid, now))
    node.handler.idle()
    assert node.health.dropped == {}
    assert node.gauge("frames") == "1"


def test_burning_is_off_unless_the_site_allows_it(site: Path) -> None:
    with pytest.raises(ConfigError, match="allow_burn: true"):
        Node(site).handler.burn()


def test_hostile_votes_leave_the_map_alone(site: Path) -> None:
    node = Node(site)
    node.feed(0)
    before = {name: values.copy() for name, values in state(node.map).items()}
    outside = message(1, node.map.geometry)
    outside.data[4:8] = array("B", np.float32(1e6).tobytes())
    huge = message(1, node.map.geometry)
    huge.height = 2**31
    for bad in (outside, huge):
        with pytest.raises(MessageError):
            node.handler.on_votes("east", bad)
    for name, values in before.items():
        np.testing.assert_array_equal(state(node.map)[name], values)
    node.feed(1)
    assert node.gauge("frames") == "2", "a frame that was refused may come again, whole"


def point(x: float, y: float, frame: str = "map") -> PointStamped:
    asked = PointStamped()
    asked.header.frame_id, asked.point.x, asked.point.y = frame, x, y
    return asked


def test_query_of_a_point(kept: Callable[..., Node]) -> None:
    node = kept()
    node.feed(*range(40))
    layers = node.map.layers()
    row, col = np.argwhere(layers.seen_by > 1)[0]
    x, y = (float(v) for v in node.map.geometry.to_map(row, col))
    node.handler.on_query(point(x + 11.0, y - 14.0))
    (answer,) = node.outlet.on(FUEL_MAP_ANSWER)
    found = json.loads(answer.data)
    assert (found["row"], found["col"]) == (row, col)
    assert found["fuel"]["code"] == layers.code[row, col]
    assert found["life_form"] == LifeForm(layers.life_form[row, col]).name.lower()
    assert found["p_max"] == pytest.approx(layers.p_max[row, col], abs=1e-4)
    assert found["evidence"] == pytest.approx(layers.evidence[row, col], abs=1e-3)
    assert found["seen_by"] == layers.seen_by[row, col]
    assert found["prior"] is None
    assert {touch["camera"] for touch in found["tile"]} <= set(CAMERAS)
    assert sum(touch["frames"] for touch in found["tile"]) > 1
    for asked, complaint in ((point(x, y, "odom"), "odom"), (point(1e7, y), "outside"), (point(np.nan, y), "finite")):
        with pytest.raises(MessageError, match=complaint):
            node.handler.on_query(asked)


def test_regions_that_are_none(kept: Callable[..., Node]) -> None:
    node = kept(allow_burn=True)
    region = PolygonStamped()
    region.header.frame_id = "odom"
    with pytest.raises(MessageError, match="odom"):
        node.handler.on_region(region)
    region.header.frame_id, region.polygon.points = "map", [Point32(), Point32()]
    with pytest.raises(MessageError, match="2 corners"):
        node.handler.on_region(region)


def test_export_writes_landscapes_into_the_folder(kept: Callable[..., Node], site: Path, tmp_path: Path) -> None:
    import rasterio

    with pytest.raises(ConfigError, match="parameter folder"):
        Node(site).handler.export()
    node = kept()
    node.feed(*range(80))
    assert node.handler.export().startswith("landscape.lcp and landscape.tif written")
    for name in ("landscape.lcp", "landscape.tif"):
        with rasterio.open(tmp_path / "kept" / name) as found:
            assert found.count == 8
            known = found.read(1) != -9999
            assert known[1:].all()  # the grid's first row lies beyond the terrain
            np.testing.assert_array_equal(found.read(4), np.where(known, node.map.layers().code, -9999))
            if name.endswith("tif"):
                assert found.tags()["unit_height"] == "m x 10"
        item = json.loads((tmp_path / "kept" / f"{name}.stac.json").read_text())
        assert name in item["assets"]


def test_nothing_is_compiled_after_the_start(tmp_path: Path) -> None:
    """Nor for a frame of one cell, whose arrays have both orders of axes. In a process of its own: in this one other
    tests have compiled."""
    code = Path(__file__).with_name("votes_after_start.py")
    paths = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run([sys.executable, code, tmp_path], env=paths, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    before, after = json.loads(run.stdout)
    assert before["ltm_core.fuel.evidence_kernel.with_neighbours"] == 1
    assert after == before
