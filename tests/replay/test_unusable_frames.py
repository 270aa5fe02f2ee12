from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.networks import write_depth_network
from scenes.small_site import FRAMES, NAME, SmallSite, write_small_site

from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg, msg_to_array, msg_to_depth
from ltm_msgs_py.stamp import stamp_of
from ltm_msgs_py.status import msg_to_values
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.nodes.fuel_votes import FuelVotesHandler
from ltm_ros.nodes.terrain import TerrainHandler
from ltm_ros.nodes.topodepth import TopoDepthHandler
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline
from ltm_ros.runtime.handler import Handler
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    FUEL_VOTES,
    FUSED_DEPTH,
    FUSED_INFO,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    LABELS_IMAGE,
    MEASURED_DEPTH,
    camera_topic,
)

DARK = (2, 3)
"""Frames of each camera that were taken by night."""


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    """The small site, whose cameras go dark for two frames."""
    small = write_small_site(tmp_path_factory.mktemp("night"), recording=False)
    small.write_bag(small.folder / "day")
    seen = {"tower": 0, "mast": 0}
    frames = {(f.camera_name, f.stamp_ns): f for f in small.frames()}
    with BagWriter(small.bag) as bag:
        reader = BagReader(small.folder / "day")
        for message in reader.messages():
            decoded = reader.decode(message)
            camera = message.topic.split("/")[2]
            if message.topic.endswith((IMAGE_COMPRESSED.name, IMAGE_RAW.name)):
                seen[camera] += 1
                if seen[camera] - 1 in DARK:
                    stamp = stamp_of(decoded)
                    night = (small.photo(frames[camera, stamp]) * 0.1).astype(np.uint8)
                    optical = f"{camera}_optical"
                    decoded = (
                        image_to_msg(night, "rgb8", stamp, optical)
                        if camera == "mast"
                        else compressed_to_msg(encode_rgb(night, quality=95), "jpeg", stamp, optical)
                    )
            bag.write(message.topic, decoded, message.log_time_ns)
    return small


def test_dark_frames_change_nothing_and_are_counted(small: SmallSite, tmp_path: Path) -> None:
    write_depth_network(small.folder)
    content = yaml.safe_load(small.path.read_text()) | {"depth_model": "depth.yaml", "terrain": {}}
    path = small.folder / "with_terrain.yaml"
    path.write_text(yaml.safe_dump(content))
    summaries = run_offline(small.bag, path, ReplayOptions(record=tmp_path / "bag"), lambda done, total: None)
    reader = BagReader(tmp_path / "bag", allow_damaged=False)
    for camera in ("tower", "mast"):
        found = {
            topic: [reader.decode(m) for m in reader.messages([camera_topic(NAME, camera, topic)])]
            for topic in (LABELS_IMAGE, FUEL_VOTES, DEPTH_IMAGE, FUSED_DEPTH, FUSED_INFO, MEASURED_DEPTH)
        }
        assert {topic.name: len(messages) for topic, messages in found.items()} == dict.fromkeys(
            (topic.name for topic in found), FRAMES
        )
        for i in range(FRAMES):
            labels = msg_to_array(found[LABELS_IMAGE][i], ("mono8",))
            info = msg_to_values(found[FUSED_INFO][i])
            if i not in DARK:
                assert (labels != 255).any()
                assert found[FUEL_VOTES][i].width > 0
                assert info["verdict"] != "picture_unusable"
                continue
            assert (labels == 255).all()
            assert found[FUEL_VOTES][i].width == 0
            assert (info["verdict"], info["reason"]) == ("picture_unusable", "night: the image is too dark")
            assert np.isnan(msg_to_depth(found[MEASURED_DEPTH][i])).all()
            # Where the terrain lies is known at night, too.
            np.testing.assert_array_equal(msg_to_depth(found[FUSED_DEPTH][i]), msg_to_depth(found[DEPTH_IMAGE][i]))
        summary = summaries[f"/{NAME}/{camera}/segmentation"]
        assert summary["noted.unusable.night"] == str(len(DARK))
        assert summary["picture"] == "usable"
        assert summaries[f"/{NAME}/{camera}/topodepth"]["noted.verdict.picture_unusable"] == str(len(DARK))
    assert {name: s["dropped"] for name, s in summaries.items()} == dict.fromkeys(summaries, "0")


def test_nodes_finish_after_those_that_they_listen_to(
    small_site: SmallSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a node still has to say at the end is heard by one that is still open."""
    write_depth_network(small_site.folder)
    content = yaml.safe_load(small_site.path.read_text()) | {"depth_model": "depth.yaml", "terrain": {}}
    path = small_site.folder / "with_terrain.yaml"
    path.write_text(yaml.safe_dump(content))
    finished: list[str] = []

    def noted(handler: type[Handler[Any]]) -> None:
        finish = handler.finish

        def wrapped(self: Handler[Any]) -> None:
            finished.append(handler.__name__)
            finish(self)

        monkeypatch.setattr(handler, "finish", wrapped)

    for handler in (TopoDepthHandler, TerrainHandler, FuelVotesHandler, FuelMapHandler):
        noted(handler)
    run_offline(small_site.bag, path, ReplayOptions(duration=1.0), lambda done, total: None)
    assert sorted(finished) == [
        "FuelMapHandler",
        *["FuelVotesHandler"] * 2,
        "TerrainHandler",
        *["TopoDepthHandler"] * 2,
    ]
    assert finished[-1] == "FuelMapHandler"
    assert finished.index("TerrainHandler") > max(i for i, name in enumerate(finished) if name == "TopoDepthHandler")
