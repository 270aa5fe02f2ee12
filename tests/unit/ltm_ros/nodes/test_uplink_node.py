from contextlib import closing
from pathlib import Path

import pytest
from scenes.fuel_frames import LABELS, stamp_of_frame, votes
from scenes.outlets import Kept
from scenes.region_scene import REGION, RegionScene, write_region_scene

from ltm_core.base.errors import MessageError, StoreError
from ltm_core.uplink.outbox_io import Outbox
from ltm_msgs_py.json_topics import label_set_to_msg
from ltm_msgs_py.pointcloud import votes_to_msg
from ltm_ros.nodes.uplink import OUTBOX_FILE, UplinkHandler, UplinkNodeConfig, sector
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
    with closing(Outbox(scene.folder / "map" / OUTBOX_FILE, 10**9, 1e9)) as outbox:
        found = [frame for key, _ in outbox.waiting(10, 0.0) if (frame := outbox.frame(key))]
        assert [(frame.camera, frame.stamp_ns) for frame in found] == [
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


def test_votes_that_no_region_takes_are_refused_at_once(scene: RegionScene) -> None:
    node = UplinkHandler(UplinkNodeConfig(site=str(scene.config.site), folder="map"), Kept(), Health())
    message = votes_to_msg(votes(1, scene.geometry), LABELS.names)
    message.header.frame_id = "x" * (2 << 20)
    with pytest.raises(MessageError, match="maximum of a region is 64000"):
        node.on_votes("alta_mast", message)
    node.start()
    node.finish()
