from pathlib import Path

import numpy as np
import pytest
from scenes.rain_store import GRID, SCHEMA, changes, tile
from scenes.small_disk import SmallDisk

from ltm_core.base.errors import ConfigError, StoreError
from ltm_core.storage import tile_store_file
from ltm_core.storage.tile_store import TileStore
from ltm_core.storage.tile_store_schema import FrameRecord, Tile, Touch


def assert_same(found: Tile | None, expected: Tile) -> None:
    assert found.keys() == expected.keys()
    for name, array in expected.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype


def test_what_is_committed_is_there_after_opening_again(tmp_path: Path) -> None:
    path = tmp_path / "map.ltm"
    with TileStore.open(path, SCHEMA) as store:
        assert (store.keys(), store.read((0, 1)), store.frame_count(), store.newest_ns()) == ([], None, 0, None)
        store.commit({(1, 2): tile(1), (0, 1): tile(2)}, [FrameRecord("north", 5), FrameRecord("east", 7)])
        store.commit({(0, 1): tile(3)}, [FrameRecord("north", 3)])
    with TileStore.open(path, SCHEMA) as store:
        assert store.keys() == [(0, 1), (1, 2)]
        assert_same(store.read((1, 2)), tile(1))
        assert_same(store.read((0, 1)), tile(3))
        asked = [("north", 5), ("north", 3), ("east", 7), ("east", 5), ("west", 7)]
        assert [store.counted(*frame) for frame in asked] == [True, True, True, False, False]
        assert store.sources() == {"east": 1, "north": 2}
        assert (store.frame_count(), store.newest_ns()) == (3, 7)


def test_payloads_wait_until_tiles_hold_their_effect(tmp_path: Path) -> None:
    path = tmp_path / "map.ltm"
    with TileStore.open(path, SCHEMA) as store:
        store.commit(frames=[FrameRecord("b", 9, [(0, 0)], "net", b"first"), FrameRecord("a", 2, payload=b"second")])
        store.commit(frames=[FrameRecord("a", 1)])
    with TileStore.open(path, SCHEMA) as store:
        waiting = [(f.source, f.stamp_ns, f.model, f.payload) for f in store.waiting()]
        assert waiting == [("b", 9, "net", b"first"), ("a", 2, "", b"second")]
        store.commit({(0, 0): tile(1)}, [FrameRecord("c", 1, payload=b"third")])
        assert store.waiting() == []
        assert store.frame_count() == 4


def test_a_transaction_is_whole_or_not_at_all(tmp_path: Path) -> None:
    with TileStore.open(tmp_path / "map.ltm", SCHEMA) as store:
        store.commit({(0, 0): tile(1)}, [FrameRecord("a", 1)])
        again = [FrameRecord("b", 2, [(0, 0)]), FrameRecord("a", 1)]
        with pytest.raises(ValueError, match="frame 1 of a"):
            store.commit({(0, 0): tile(2)}, again, [changes("life", 2, [(1, 1, 0, 4)])])
        assert_same(store.read((0, 0)), tile(1))
        assert store.sources() == {"a": 1}
        assert (list(store.changes("life")), store.touches((0, 0))) == ([], [])


def test_who_touched_a_tile(tmp_path: Path) -> None:
    with TileStore.open(tmp_path / "map.ltm", SCHEMA) as store:
        for stamp, model in ((5, "old"), (9, "new"), (7, "new")):
            store.commit(frames=[FrameRecord("north", stamp, [(0, 0), (1, 2)], model)])
        store.commit(frames=[FrameRecord("east", 1, [(1, 2)], "new")])
        north = [Touch("north", "new", 2, 7, 9), Touch("north", "old", 1, 5, 5)]
        assert store.touches((0, 0)) == north
        assert store.touches((1, 2)) == [Touch("east", "new", 1, 1, 1), *north]


def test_layer_as_of_any_date(tmp_path: Path) -> None:
    path = tmp_path / "map.ltm"
    initial = np.full(GRID.shape, 9, np.uint8)
    with TileStore.open(path, SCHEMA) as store:
        store.commit(
            changes=[changes("life", 10, [(0, 0, 9, 1), (12, 20, 9, 2)]), changes("code", 10, [(0, 0, 9, 204)])]
        )
        store.commit(changes=[changes("life", 30, [(0, 0, 1, 3)]), changes("life", 20, [(5, 6, 9, 4)])])
        expected = {9: {}, 10: {(0, 0): 1, (12, 20): 2}, 29: {(0, 0): 1, (12, 20): 2, (5, 6): 4}}
        expected[30] = expected[29] | {(0, 0): 3}
        for date, cells in expected.items():
            layer = initial.copy()
            for cell, value in cells.items():
                layer[cell] = value
            np.testing.assert_array_equal(store.as_of("life", initial, date), layer)
        assert store.as_of("code", initial, 10)[0, 0] == 204
        with pytest.raises(ValueError, match="initial layer"):
            store.as_of("life", initial.T, 10)


def test_oldest_stamps_are_forgotten_and_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By number, not by age: a camera whose clock was once ahead by years is neither refused nor counted twice."""
    monkeypatch.setattr(tile_store_file, "KEPT_FRAMES", 40)
    with TileStore.open(tmp_path / "map.ltm", SCHEMA) as store:
        store.commit(frames=[FrameRecord("north", 10**18), FrameRecord("east", 3)])
        for stamp in range(100):
            assert not store.counted("north", stamp)
            store.commit(frames=[FrameRecord("north", stamp)])
        assert store.counted("north", 10**18)
        assert not store.forgotten("north", 10**18)
        assert all(store.counted("north", stamp) for stamp in range(100))
        known = [stamp for stamp in range(100) if not store.forgotten("north", stamp)]
        assert 39 <= len(known) <= 42
        assert known == list(range(known[0], 100))
        assert not store.counted("east", 2), "another camera's frames are its own"
        assert store.sources() == {"north": 101, "east": 1}


def test_a_flood_of_stamps_pushes_out_none_of_the_same_days(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The attack: 21,050 stamps ten minutes ahead made a camera's true frames too old."""
    now, minute = 1_800_000_000 * 10**9, 60 * 10**9
    flood = [FrameRecord("north", now + 10 * minute + n) for n in range(21_050)]
    with TileStore.open(tmp_path / "map.ltm", SCHEMA) as store:
        store.commit(frames=flood)
        assert not store.counted("north", now)
        assert not store.counted("north", now - 24 * 60 * minute)
    monkeypatch.setattr(tile_store_file, "KEPT_FRAMES", 1000)
    with TileStore.open(tmp_path / "bounded.ltm", SCHEMA) as store:
        for begin in range(0, 2000, 100):
            store.commit(frames=flood[begin : begin + 100])
        known = [frame.stamp_ns for frame in flood[:2000] if not store.forgotten("north", frame.stamp_ns)]
        assert 1000 <= len(known) <= 1100
        assert known[-1] == flood[1999].stamp_ns


def test_one_writer_and_readers_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "map.ltm"
    with TileStore.open(path, SCHEMA) as store:
        store.commit({(0, 0): tile(1)})
        with pytest.raises(StoreError, match="another process writes"):
            TileStore.open(path, SCHEMA)
        with TileStore.open_read_only(path, "weather") as reader:
            assert reader.schema == SCHEMA
            store.commit({(0, 0): tile(2)})
            assert_same(reader.read((0, 0)), tile(2))
            with pytest.raises(StoreError, match="READONLY"):
                reader.commit({(0, 0): tile(3)})
    with pytest.raises(ConfigError, match="weather, not fuel"):
        TileStore.open_read_only(path, "fuel")
    TileStore.open(path, SCHEMA).close()


def test_full_disk_loses_nothing_and_goes_on_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "map.ltm"
    disk = SmallDisk(monkeypatch)
    with TileStore.open(path, SCHEMA) as store:
        store.commit({(0, 0): tile(1)}, [FrameRecord("a", 1)])
        disk.fill(spare_pages=1)
        for _ in range(3):
            with pytest.raises(StoreError, match=r"map\.ltm.*SQLITE_FULL.*free space"):
                store.commit({(0, 1): tile(2), (1, 1): tile(3)}, [FrameRecord("a", 2)])
        assert store.keys() == [(0, 0)]
        assert not store.counted("a", 2)
        disk.free()
        store.commit({(0, 1): tile(2), (1, 1): tile(3)}, [FrameRecord("a", 2)])
    with TileStore.open(path, SCHEMA) as store:
        assert_same(store.read((1, 1)), tile(3))
        assert store.counted("a", 2)


def test_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="does not exist"):
        TileStore.open(tmp_path / "no" / "map.ltm", SCHEMA)
    with pytest.raises(ConfigError, match="no such store"):
        TileStore.open_read_only(tmp_path / "map.ltm", "weather")
    assert list(tmp_path.iterdir()) == []
