from __future__ import annotations

from pathlib import Path

import numpy as np
from scenes.fuel_frames import BEGIN_NS
from scenes.region_scene import CAMERA, write_region_scene

from ltm_core.fuel.cell_state import TILE
from ltm_ros.region.aggregator import Aggregator
from ltm_ros.region.inbox import KEPT_BYTES, Inbox
from ltm_ros.region.tiles import TilePublisher, opened_tile
from ltm_ros.runtime.health import Health


class Link:
    """Takes `room` messages, as a connection that then is lost."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, bytes]] = []
        self.room = 1000

    def send(self, topic: str, payload: bytes, retain: bool = False, qos: int = 0) -> bool:
        assert (retain, qos) == (True, 1)
        if len(self.sent) >= self.room:
            return False
        self.sent.append((topic, payload))
        return True

    def taken(self) -> list[str]:
        topics = [topic for topic, _ in self.sent]
        self.sent.clear()
        return topics


def test_of_most_of_a_region_nobody_has_seen_anything_and_nothing_is_sent(tmp_path: Path) -> None:
    """Also when an hour has gone by, after which all of the map is decided anew."""
    scene, link = write_region_scene(tmp_path), Link()
    aggregator = Aggregator(scene.config, Health(), lambda: BEGIN_NS + 10**13)
    tiles = TilePublisher("kern", aggregator, link)  # type: ignore[arg-type]
    for number in (1, 4000):
        aggregator.take("alta", scene.sealed("alta", number))
        windows = aggregator.show()
        assert windows[0] == (0, 0, *scene.geometry.shape)
        tiles.note(windows)
    tiles.send()
    rows, cols = np.nonzero(aggregator.persistence.map.seen_by(f"alta_{CAMERA}"))
    seen = {f"ltm/kern/tile/{row // TILE}/{col // TILE}" for row, col in zip(rows, cols, strict=True)}
    assert set(link.taken()) == seen
    down, across = aggregator.persistence.map.tiles
    assert 0 < len(seen) < down * across
    aggregator.close()


def test_a_tile_goes_when_it_differs_from_what_followers_have(tmp_path: Path) -> None:
    scene, link = write_region_scene(tmp_path), Link()
    aggregator = Aggregator(scene.config, Health(), lambda: BEGIN_NS + 10**13)
    tiles = TilePublisher("kern", aggregator, link)  # type: ignore[arg-type]
    for number in range(8):
        aggregator.take("alta", scene.sealed("alta", number))
    assert aggregator.persistence.shown.seen_cells == 0, "nobody has asked for it yet"
    windows = aggregator.show()
    tiles.note(windows)
    link.room = 1
    tiles.send()
    link.room = 1000
    tiles.send()
    first = len(link.sent)
    assert 1 < first == len(set(link.taken()))
    tiles.note(windows)
    tiles.send()
    assert link.taken() == [], "nothing has changed since"
    shown = aggregator.persistence.shown.life_form
    shown[0, 0] = shown[0, 0] % 5 + 1
    tiles.note([(0, 0, *shown.shape)])
    tiles.send()
    ((topic, content),) = [sent for sent in link.sent if sent[0].endswith("/tile/0/0")]
    assert opened_tile(scene.identity("desk"), content)[1].shape == shown[:32, :32].shape
    assert topic == "ltm/kern/tile/0/0"
    link.taken()
    tiles.note_all()
    tiles.send()
    assert len(link.sent) >= 1, "the broker may have forgotten them"
    aggregator.close()


def drained(inbox: Inbox) -> list[tuple[str, bytes]]:
    found = []
    while (came := inbox.get(0.0)) is not None:
        found.append(came)
    return found


def test_a_tower_that_floods_delays_nobody_s_frames() -> None:
    health = Health()
    inbox = Inbox(["alta", "bear", "crow"], health)
    for number in range(50):
        inbox.put("alta", b"flood %d" % number)
    for number in range(2):
        inbox.put("bear", b"%d" % number)
        inbox.put("crow", b"%d" % number)
    came = drained(inbox)
    assert [tower for tower, _ in came[:7]] == ["alta", "bear", "crow", "alta", "bear", "crow", "alta"]
    assert [content for tower, content in came if tower == "alta"] == [b"flood %d" % number for number in range(50)]
    assert (len(came), inbox.bytes, health.dropped) == (54, 0, {})


def test_where_there_is_no_room_the_one_with_most_in_it_loses_its_last() -> None:
    health = Health()
    inbox = Inbox(["alta", "bear"], health, most=10 * (KEPT_BYTES + 100))
    for number in range(30):
        inbox.put("alta", bytes([number]) * 100)
    assert health.dropped == {"overload": 20}
    for number in range(4):
        inbox.put("bear", bytes([number]) * 100)
    assert inbox.bytes == 10 * (KEPT_BYTES + 100)
    came = drained(inbox)
    assert [content[0] for tower, content in came if tower == "alta"] == [0, 1, 2, 3, 4, 5]
    assert [content[0] for tower, content in came if tower == "bear"] == [0, 1, 2, 3]
    assert "most of them from alta" in health.last_error


def test_any_number_of_names_that_are_no_towers_has_one_turn_and_is_bounded() -> None:
    health = Health()
    inbox = Inbox(["alta"], health, most=8 * KEPT_BYTES)
    for number in range(1000):
        inbox.put(f"nobody{number}", b"")
    inbox.put("alta", b"")
    came = [tower for tower, _ in drained(inbox)]
    assert came == ["nobody0", "alta", *(f"nobody{number}" for number in range(1, 7))]
    assert health.dropped == {"overload": 993}
    assert "most of them from unknown towers" in health.last_error
    inbox.put("alta" + 60_000 * "x", b"")
    ((name, _),) = drained(inbox)
    assert name == "alta" + 96 * "x"
