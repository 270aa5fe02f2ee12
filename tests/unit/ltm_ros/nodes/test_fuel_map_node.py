"""The fuel map's node without its transport: each frame once, in the store before it is told, and what people ask."""

from __future__ import annotations

import contextlib
import json
import sqlite3
from array import array
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped
from scenes.fuel_frames import (
    BEGIN_NS,
    CAMERAS,
    LABELS,
    NAME,
    camera_of,
    grid_of,
    message,
    stamp_of_frame,
    votes,
    write_site,
)
from scenes.outlets import Kept
from scenes.small_disk import SmallDisk

from ltm_core.errors import ConfigError, LtmError, MessageError, StoreError
from ltm_core.fuel.evidence import EVIDENCE_FIELDS, EvidenceMap
from ltm_core.fuel.fuel_map_io import read_fuel_map
from ltm_core.fuel.life_form import LifeForm, life_form_labels
from ltm_core.fuel.site_map import site_evidence_map
from ltm_core.fuel.stored_map import STORE_FILE, open_stored_map, votes_of, votes_to_bytes
from ltm_core.fuel.votes import CellVotes
from ltm_core.grid import GridGeometry
from ltm_core.raster.tile_store import FrameRecord, TileStore
from ltm_core.site_io import load_site
from ltm_msgs_py.grid import msg_to_classes
from ltm_msgs_py.label_info import label_set_to_msg
from ltm_msgs_py.votes import votes_to_msg
from ltm_ros.fuel_map import persistence
from ltm_ros.nodes.fuel_map import FuelMap, FuelMapConfig
from ltm_ros.runtime import retry
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_MAP, FUEL_MAP_ANSWER, FUEL_MAP_UPDATE, FUEL_VOTES


class Node:
    """A handler, its outlet and its health."""

    def __init__(self, site: Path, now: int = 0, **config: Any) -> None:
        self.outlet, self.health = Kept(), Health()
        self.outlet.now = now
        self.handler = FuelMap(FuelMapConfig(site=str(site), **config), self.outlet, self.health)
        self.handler.start()

    def feed(self, *numbers: int, idle: bool = True) -> None:
        for number in numbers:
            self.handler.on_votes(camera_of(number), message(number, self.map.geometry))
        if idle:
            self.handler.idle()

    @property
    def map(self) -> EvidenceMap:
        return self.handler.persistence.map

    def gauge(self, name: str) -> str:
        return self.health.summary()[name]


def state(evidence: EvidenceMap) -> dict[str, np.ndarray]:
    keys = [(row, col) for row in range(evidence.tiles[0]) for col in range(evidence.tiles[1])]
    tiles = [evidence.tile_state(key) for key in keys]
    return {name: np.stack([tile[name] for tile in tiles]) for name in EVIDENCE_FIELDS}


def assert_same_state(found: EvidenceMap, expected: EvidenceMap) -> None:
    for name, values in state(expected).items():
        np.testing.assert_array_equal(state(found)[name], values, err_msg=name)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    return write_site(tmp_path)


@pytest.fixture
def kept(site: Path, tmp_path: Path) -> Callable[..., Node]:
    """Makes a node that keeps its map in a folder; the same one each time."""
    return lambda **config: Node(site, folder=str(tmp_path / "kept"), **config)


def test_what_was_counted_is_there_after_a_stop(kept: Callable[..., Node], site: Path) -> None:
    first = kept()
    first.feed(*range(7))
    first.handler.finish()
    second = kept()
    assert_same_state(second.map, first.map)
    assert second.gauge("received") == "0"
    (shown,) = second.outlet.on(FUEL_MAP)
    np.testing.assert_array_equal(msg_to_classes(shown)[0], first.map.layers().life_form)
    second.feed(*range(9))
    assert second.health.dropped == {"duplicate": 7}
    assert second.gauge("frames") == "9"
    whole = Node(site)
    whole.feed(*range(9))
    assert_same_state(second.map, whole.map)
    second.handler.finish()
    layers = second.map.layers()
    assert second.gauge("cells.seen") == str((layers.evidence > 0).sum()) != "0"
    assert second.gauge("cells.changed") == str(layers.changed.sum())


@pytest.mark.parametrize("logged", [1, 4, 1000])
def test_what_was_acknowledged_is_there_without_a_stop(
    kept: Callable[..., Node], monkeypatch: pytest.MonkeyPatch, logged: int
) -> None:
    """The first node is let go of as a killed one is; tiles are written after every, some, or no frames."""
    monkeypatch.setattr(persistence, "LOGGED_FRAMES", logged)
    first = kept()
    for number in range(11):
        first.feed(number)
    assert first.outlet.stamps(FUEL_MAP_UPDATE) == [stamp_of_frame(n) for n in range(11)]
    expected = {name: values.copy() for name, values in state(first.map).items()}
    first.feed(11, 12, idle=False)  # counted in memory, told to nobody
    first.handler.persistence.store.close()
    second = kept()
    for name, values in expected.items():
        np.testing.assert_array_equal(state(second.map)[name], values)
    second.feed(*range(8, 13))
    assert second.health.dropped == {"duplicate": 3}


def test_nothing_is_told_before_it_is_in_the_store(kept: Callable[..., Node], tmp_path: Path) -> None:
    node = kept()
    node.feed(0, 1, idle=False)
    assert node.outlet.on(FUEL_MAP_UPDATE) == []
    with TileStore.open_read_only(tmp_path / "kept" / STORE_FILE, "fuel") as reader:
        assert reader.frame_count() == 0
        node.handler.tick(0.5)
        assert reader.frame_count() == 2
    assert len(node.outlet.on(FUEL_MAP_UPDATE)) == 2
    node.feed(2)
    assert len(node.outlet.on(FUEL_MAP_UPDATE)) == 2, "live, what is idle waits for the tick: one transaction for many"
    node.handler.tick(0.5)
    assert len(node.outlet.on(FUEL_MAP_UPDATE)) == 3


def test_order_lateness_and_repetition_make_no_difference(site: Path) -> None:
    straight, mixed = Node(site), Node(site)
    straight.feed(*range(12))
    mixed.feed(*np.random.default_rng(3).permutation(12).tolist(), 3, 3, 11)
    assert mixed.health.dropped == {"duplicate": 3}
    for name, values in state(straight.map).items():
        np.testing.assert_allclose(state(mixed.map)[name], values, rtol=1e-12)
    np.testing.assert_array_equal(mixed.map.layers().code, straight.map.layers().code)


def test_journal_gives_the_map_as_of_any_date(kept: Callable[..., Node], site: Path, tmp_path: Path) -> None:
    node, seen = kept(), {}
    for number in range(0, 900, 30):
        node.feed(number)
        seen[node.map.newest_ns] = node.handler.persistence.shown.copies()
    node.handler.persistence.store.close()  # killed
    node = kept()
    node.feed(900)
    node.handler.finish()
    config = load_site(site)
    empty = site_evidence_map(config, grid_of(site), LABELS)
    initial = empty.layers()
    with open_stored_map(tmp_path / "kept" / STORE_FILE, config, empty) as store:
        assert_same_state(empty, node.map)
        for date, layers in seen.items():
            for name, layer in layers.items():
                np.testing.assert_array_equal(store.as_of(name, getattr(initial, name), date), layer)
        now = node.map.layers()
        np.testing.assert_array_equal(store.as_of("code", initial.code, 2**62), now.code)
        np.testing.assert_array_equal(store.as_of("code", initial.code, BEGIN_NS - 1), initial.code)
    codes = [layers["code"] for layers in seen.values()]
    assert (codes[3] != codes[-1]).any()


def test_changes_of_code_that_were_not_journaled_before_a_kill_are_found(
    kept: Callable[..., Node], tmp_path: Path
) -> None:
    node = kept()
    node.feed(0)
    node.handler.persistence.store.close()  # killed
    with contextlib.closing(sqlite3.connect(tmp_path / "kept" / STORE_FILE)) as database, database:
        database.execute("DELETE FROM changes")
    node = kept()
    node.feed(1)
    initial = {"code": node.map.layers().code.copy()}
    initial["code"][:] = -9999
    np.testing.assert_array_equal(
        node.handler.persistence.store.as_of("code", initial["code"], 2**62), node.handler.persistence.shown.code
    )


def test_full_disk_map_lives_on_and_catches_up(
    kept: Callable[..., Node], site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = SmallDisk(monkeypatch)
    node = kept()
    node.feed(0, 1)
    disk.fill()
    for number in range(2, 60):
        node.feed(number, idle=False)
        node.handler.tick(0.5)
    assert 2 <= int(node.gauge("frames")) < 40
    assert int(node.gauge("frames")) + int(node.gauge("unsaved_frames")) == 60
    assert node.health.troubled
    assert "SQLITE_FULL" in node.health.last_error
    assert "frames are in memory only" in node.health.last_error
    assert len(node.outlet.on(FUEL_MAP_UPDATE)) == int(node.gauge("frames")), "only what is saved is told"
    shown = node.handler.persistence.shown
    np.testing.assert_array_equal(msg_to_classes(node.outlet.on(FUEL_MAP)[-1])[0], shown.life_form)
    shown.refresh_all()
    np.testing.assert_array_equal(shown.life_form, node.map.layers().life_form)
    node.feed(5, 59)
    assert node.health.dropped == {"duplicate": 2}

    disk.free()
    node.handler.tick(retry.LONGEST_RETRY_S)
    assert (node.gauge("frames"), node.gauge("unsaved_frames"), node.gauge("noted.store_back")) == ("60", "0", "1")
    assert sorted(node.outlet.stamps(FUEL_MAP_UPDATE)) == [stamp_of_frame(n) for n in range(60)]
    node.handler.persistence.store.close()
    whole = Node(site)
    whole.feed(*range(60))
    assert_same_state(kept().map, whole.map)


def test_store_that_cannot_be_opened_yet(
    kept: Callable[..., Node], site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The node begins in memory; once the disk is there, what it counted comes on top of what the store holds."""
    first = kept()
    first.feed(*range(6))
    first.handler.finish()
    opened = TileStore.open

    def away(*_: object) -> TileStore:
        raise StoreError("disk is not there")

    monkeypatch.setattr(TileStore, "open", away)
    node = kept()
    assert "disk is not there" in node.health.last_error
    node.feed(4, 6, 7, idle=False)
    node.handler.tick(1.0)
    assert (node.gauge("frames"), node.gauge("unsaved_frames")) == ("0", "3")
    monkeypatch.setattr(TileStore, "open", opened)
    node.handler.tick(1.5)
    assert (node.gauge("frames"), node.gauge("unsaved_frames")) == ("8", "0")
    whole = Node(site)
    whole.feed(*range(8))
    assert_same_state(node.map, whole.map)


def test_foreign_and_damaged_stores_end_the_node_and_stay_as_they_are(site: Path, tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    folder.mkdir()
    path = folder / STORE_FILE
    other = tmp_path / "other"
    other.mkdir()
    Node(write_site(other, fuel={"resolution": 60.0}), folder=str(folder)).handler.finish()
    damaged = bytearray(path.read_bytes())
    damaged[5000:9000] = bytes(4000)
    cases = {"geometry is": (path.read_bytes(), {}), "damaged": (bytes(damaged), {}), "not a tile": (b"diary" * 99, {})}
    Node(site, folder=str(other)).handler.finish()
    with contextlib.closing(sqlite3.connect(other / STORE_FILE)) as store:
        (described,) = store.execute("SELECT content FROM description").fetchone()
        older = json.dumps(json.loads(described) | {"version": 1})
        store.execute("UPDATE description SET content = ?", (older,))
        store.commit()
    cases["version is 1"] = ((other / STORE_FILE).read_bytes(), {})
    for complaint, (content, changes) in cases.items():
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=complaint):
            Node(write_site(tmp_path, **changes), folder=str(folder))
        assert path.read_bytes() == content


def test_folder_is_made_but_not_the_way_to_it(site: Path, tmp_path: Path) -> None:
    Node(site, folder="beside").handler.finish()
    assert (tmp_path / "beside" / STORE_FILE).is_file()
    with pytest.raises(ConfigError, match=r"missing.* does not exist"):
        Node(site, folder="missing/kept")
    with pytest.raises(ConfigError, match="no folder"):
        Node(site, folder="site.yaml")


def test_clocks_that_jump(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TileStore, "in_memory", partial(TileStore.in_memory, kept_frames=10, most_frames=10))
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
    assert node.gauge("noted.stamp_jump") == "1"
    for number in range(30):
        send(now - day + number)
    assert send(now - 6 * day + 1)["too_old"] == 1


def test_a_replay_has_the_time_of_its_recording(site: Path) -> None:
    """Frames of years ago, with hours between them, while the graph's time is theirs; and before that has begun."""
    node = Node(site)
    node.feed(0)
    for number in range(1, 10):
        stamp = BEGIN_NS + number * 5 * 3600 * 10**9
        node.outlet.now = stamp + 10**8
        node.handler.on_votes("north", message(number, node.map.geometry, stamp))
    node.handler.idle()
    assert node.health.dropped == {}
    assert node.gauge("frames") == "10"
    assert "noted.stamp_jump" not in node.health.summary()


def test_empty_votes_push_out_no_frame(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The attack: more votes that say nothing than a store remembers, each stamped as far ahead as may be."""
    monkeypatch.setattr(TileStore, "in_memory", partial(TileStore.in_memory, kept_frames=10, most_frames=10))
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


def test_many_votes_of_a_minute_push_out_none_of_the_day(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TileStore, "in_memory", partial(TileStore.in_memory, kept_frames=10))
    now = BEGIN_NS + 10**15
    node = Node(site, now=now)
    for number in range(50):
        node.handler.on_votes("north", message(0, node.map.geometry, now + 9 * 10**9 + number))
        node.handler.idle()
    node.handler.on_votes("north", message(0, node.map.geometry, now - 3600 * 10**9))
    node.handler.idle()
    assert node.health.dropped == {}
    assert node.gauge("frames") == "51"


def test_clear_and_burn_are_off_unless_the_site_allows_them(site: Path) -> None:
    node = Node(site)
    for service, serve in (("clear", node.handler.clear), ("burn", node.handler.burn)):
        with pytest.raises(ConfigError, match=f"fuel_map/{service} is off: set `allow_clear_and_burn: true`"):
            serve()


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


def test_unknown_cameras_only_where_they_are_welcome(site: Path) -> None:
    assert Node(site).handler.discoverable == {}
    node = Node(site, accept_unknown_cameras=True)
    ((topic, callback),) = node.handler.discoverable.items()
    assert topic.name == f"/{NAME}/*/fuel/votes"
    assert topic.type is FUEL_VOTES.type
    callback(f"/{NAME}/west/fuel/votes", message(0, node.map.geometry))
    node.handler.idle()
    assert node.handler.persistence.store.sources() == {"west": 1}
    for name in ("fuel_map", "West", "a__;"):
        with pytest.raises(LtmError):
            callback(f"/{NAME}/{name}/fuel/votes", message(1, node.map.geometry))


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


def test_network_that_labels_is_kept_with_the_frames(kept: Callable[..., Node]) -> None:
    node = kept()
    node.feed(0)
    node.handler.on_label_info(camera_of(0), label_set_to_msg(LABELS, "spine 0123456789ab"))
    node.handler.on_votes(camera_of(0), message(0, node.map.geometry, stamp_of_frame(0) + 1))
    node.handler.idle()
    seen = votes(0, node.map.geometry)
    key = (int(seen.rows[0]) // 32, int(seen.cols[0]) // 32)
    found = node.handler.persistence.store.touches(key)
    assert [(t.source, t.model, t.frames) for t in found] == [("north", "", 1), ("north", "spine 0123456789ab", 1)]


def test_clearing_a_region(kept: Callable[..., Node], tmp_path: Path) -> None:
    node = kept(allow_clear_and_burn=True)
    node.feed(*range(60))
    with pytest.raises(ConfigError, match="fuel_map/region"):
        node.handler.clear()
    grid = node.map.geometry
    before = node.map.layers()
    region = PolygonStamped()
    region.header.frame_id = "map"
    corners = [grid.to_map(row - 0.5, col - 0.5) for row, col in ((10, 20), (10, 45), (38, 45), (38, 20))]
    region.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in corners]
    node.handler.on_region(region)
    assert node.handler.clear() == "evidence of 700 cells forgotten"
    with pytest.raises(ConfigError, match="fuel_map/region"):
        node.handler.clear()
    inside = np.zeros(grid.shape, bool)
    inside[10:38, 20:45] = True
    assert (before.last_seen[inside] > 0).sum() > 300

    def check(evidence: EvidenceMap) -> None:
        after = evidence.layers()
        assert not after.last_seen[inside].any()
        assert (after.life_form[inside] == 255).all()
        np.testing.assert_array_equal(after.last_seen[~inside], before.last_seen[~inside])

    check(node.map)
    np.testing.assert_array_equal(msg_to_classes(node.outlet.on(FUEL_MAP)[-1])[0], node.map.layers().life_form)
    node.handler.persistence.store.close()  # killed
    again = kept()
    check(again.map)
    again.feed(*range(60))
    assert again.health.dropped == {"duplicate": 60}
    region.header.frame_id = "odom"
    with pytest.raises(MessageError, match="odom"):
        node.handler.on_region(region)
    region.header.frame_id, region.polygon.points = "map", region.polygon.points[:2]
    with pytest.raises(MessageError, match="2 corners"):
        node.handler.on_region(region)


def test_save_writes_where_the_configuration_says(kept: Callable[..., Node], site: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="export_path"):
        Node(site).handler.save()
    node = kept()
    node.feed(*range(5))
    assert node.handler.save() == "fuel map of 5 frames written to fuel_map.tif"
    classes, geometry = read_fuel_map(tmp_path / "kept" / "fuel_map.tif")
    np.testing.assert_array_equal(classes, node.map.layers().life_form)
    assert geometry.crs == "EPSG:26911"


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


def test_frames_survive_as_bytes() -> None:
    grid = GridGeometry(0.0, 2100.0, 30.0, 90, 70)
    given = votes(5, grid)
    back = votes_of(FrameRecord(given.source, given.stamp_ns, payload=votes_to_bytes(given)), grid)
    for name in ("rows", "cols", "counts", "z", "confidence"):
        found, expected = getattr(back, name), getattr(given, name)
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)
    for found, expected in zip(back.visibility.columns(), given.visibility.columns(), strict=True):
        np.testing.assert_array_equal(found, expected)
    for payload in (b"", b"x" * 40, votes_to_bytes(given)[:-7]):
        with pytest.raises(ConfigError, match="damaged"):
            votes_of(FrameRecord("north", 1, payload=payload), grid)


def test_classes_of_the_map_are_the_life_forms() -> None:
    classes = life_form_labels(LABELS)
    assert [classes.name_of(form) for form in LifeForm] == [form.name.lower() for form in LifeForm]
    assert classes.colors[: len(LABELS)] == LABELS.colors
