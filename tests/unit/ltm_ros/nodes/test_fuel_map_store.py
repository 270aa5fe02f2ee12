import contextlib
import json
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scenes.fuel_frames import (
    BEGIN_NS,
    LABELS,
    grid_of,
    stamp_of_frame,
    write_site,
)
from scenes.fuel_map_node import Node, assert_same_state, state
from scenes.small_disk import SmallDisk

from ltm_core.base.errors import ConfigError, StoreError
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, open_stored_map
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store import TileStore
from ltm_msgs_py.grid import msg_to_classes
from ltm_ros.fuel_map import persistence
from ltm_ros.runtime import retry
from ltm_ros.runtime.topics import FUEL_MAP, FUEL_MAP_UPDATE


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
    cases = {
        "geometry is": (path.read_bytes(), {}),
        "damaged": (bytes(damaged), {}),
        "not an LTM store": (b"diary" * 99, {}),
    }
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
