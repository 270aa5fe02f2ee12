"""The node `uplink`: what cameras vote is in the outbox, with the direction in which they looked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes.fuel_frames import LABELS, stamp_of_frame, votes
from scenes.outlets import Kept
from scenes.region_scene import REGION, RegionScene, write_region_scene

from ltm_core.base.errors import ConfigError, MessageError, StoreError
from ltm_core.uplink.config import BrokerConfig, UplinkConfig
from ltm_core.uplink.outbox_io import Outbox, OutboxFrame
from ltm_msgs_py.json_topics import label_set_to_msg
from ltm_msgs_py.pointcloud import votes_to_msg
from ltm_ros.nodes.uplink import OUTBOX_FILE, SECTORS, UplinkHandler, UplinkNodeConfig, sector
from ltm_ros.region.tower_link import TowerLink
from ltm_ros.runtime.health import Health

SECTION = {
    "name": REGION,
    "tower": "alta",
    "broker": {
        "host": "127.0.0.1",
        "port": 1,  # where nobody listens
        "ca": "certs/ca.crt",
        "certificate": "certs/alta.crt",
        "key": "certs/alta.key",
    },
}


@pytest.fixture
def scene(tmp_path: Path) -> RegionScene:
    scene = write_region_scene(tmp_path)
    site = (tmp_path / "site.yaml").read_text()
    (tmp_path / "site.yaml").write_text(site + f"region: {SECTION}\n")
    return scene


def test_votes_are_in_the_outbox_at_the_end_of_the_node(scene: RegionScene) -> None:
    node = UplinkHandler(UplinkNodeConfig(site=str(scene.config.site), folder="map"), Kept(), Health())
    topics = {topic.name for topic in node.subscriptions}
    assert topics == {
        f"/kern_map/{camera}/{what}" for camera in scene.site.cameras for what in ("fuel/votes", "labels/info")
    }
    node.start()
    node.on_label_info("alta_mast", label_set_to_msg(LABELS, "landscape_lite0"))
    sent = [votes_to_msg(votes(number, scene.geometry), LABELS.names) for number in range(4)]
    for number, message in enumerate(sent):
        node.on_votes("alta_mast" if number < 3 else "bear_mast", message)
    node.finish()
    with Outbox(scene.folder / "map" / OUTBOX_FILE, 10**9, 1e9) as outbox:
        found = [frame for key, _ in outbox.waiting(10, 0.0) if (frame := outbox.frame(key))]
        assert [frame.key for frame in found] == [
            ("bear_mast", stamp_of_frame(3)),
            *(("alta_mast", stamp_of_frame(number)) for number in (2, 1, 0)),
        ]
        assert [frame.model for frame in found] == ["", *(3 * ["landscape_lite0"])]
        assert [frame.view for frame in found] == [sector(message) for message in reversed(sent)]


def test_frames_that_no_disk_took_are_lost_aloud(scene: RegionScene, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a tower that was started on a dead disk, and is stopped before anybody has seen to it."""

    def dead(*_: object) -> None:
        raise StoreError("outbox.sqlite: disk I/O error")

    monkeypatch.setattr("ltm_ros.region.tower_link.Outbox", dead)
    monkeypatch.setattr("ltm_ros.region.tower_link.LAST_TRIES_S", 0.0)
    health = Health()
    node = UplinkHandler(UplinkNodeConfig(site=str(scene.config.site), folder="map"), Kept(), health)
    node.start()
    for number in range(3):
        node.on_votes("alta_mast", votes_to_msg(votes(number, scene.geometry), LABELS.names))
    with pytest.raises(StoreError, match="frames are lost"):
        node.finish()
    assert health.dropped == {"outbox_full": 3}


def test_a_tower_without_an_outbox_tells_what_waits_all_the_same(
    scene: RegionScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A monitoring system shall see link and age while the outbox's disk is away, and the outbox once it is back."""
    away = True

    def opened(*arguments: Any) -> Outbox:
        if away:
            raise StoreError("outbox.sqlite: disk I/O error")
        return Outbox(*arguments)

    monkeypatch.setattr("ltm_ros.region.tower_link.Outbox", opened)
    now_ns, health = stamp_of_frame(0) + 90 * 10**9, Health()
    certs = scene.certs
    broker = BrokerConfig(
        host="127.0.0.1",
        port=1,
        ca=certs / "ca.crt",
        certificate=certs / "alta.crt",
        key=certs / "alta.key",
    )
    config = UplinkConfig(name=REGION, tower="alta", broker=broker)
    link = TowerLink(config, scene.grid, scene.folder / "map" / OUTBOX_FILE, health, lambda: now_ns)
    for number in (1, 0, 2):
        link.offer(OutboxFrame("mast", stamp_of_frame(number), 0, "", b"votes" * number))
    with pytest.raises(StoreError, match="I/O"):
        link.step(10.0)
    expected = {"outbox_frames": "3", "outbox_bytes": "15", "outbox_age_s": "90.0", "link_up": "0"}
    assert {key: health.summary().get(key) for key in expected} == expected
    away = False
    link.step(100.0)
    assert {key: health.summary().get(key) for key in expected} == expected
    assert link.kept == 3
    link.close()


def test_votes_that_no_region_takes_are_refused_at_once(scene: RegionScene) -> None:
    node = UplinkHandler(UplinkNodeConfig(site=str(scene.config.site), folder="map"), Kept(), Health())
    message = votes_to_msg(votes(1, scene.geometry), LABELS.names)
    message.header.frame_id = "x" * (2 << 20)
    with pytest.raises(MessageError, match="maximum of a region is 64000"):
        node.on_votes("alta_mast", message)
    node.start()
    node.finish()


@pytest.mark.parametrize(("bearings_deg", "expected"), [((350, 8), 23), ((10, 20), 1), ((175, 179), 11), ((), -1)])
def test_the_sector_is_that_of_the_mean_bearing(
    scene: RegionScene, bearings_deg: tuple[float, ...], expected: int
) -> None:
    some = votes(1, scene.geometry)
    assert some.visibility is not None
    some = some.only(np.arange(len(bearings_deg)))
    assert some.visibility is not None
    seen = replace(some.visibility, bearing=np.radians(np.array(bearings_deg, np.float32)))
    assert sector(votes_to_msg(replace(some, visibility=seen), LABELS.names)) == expected
    assert sector(votes_to_msg(replace(some, visibility=None), LABELS.names)) == -1
    assert -1 <= expected < SECTORS


def test_what_it_lacks_is_said(scene: RegionScene) -> None:
    with pytest.raises(ConfigError, match="--state FOLDER"):
        UplinkHandler(UplinkNodeConfig(site=str(scene.config.site)), Kept(), Health())
    (scene.certs / "alta.key").unlink()
    with pytest.raises(ConfigError, match=r"alta\.key: the key cannot be read"):
        UplinkHandler(UplinkNodeConfig(site=str(scene.config.site), folder="map"), Kept(), Health())
