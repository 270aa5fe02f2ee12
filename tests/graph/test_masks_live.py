"""The masks of a site in its living graph, whose nodes share one process: as in an offline replay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.masked_site import hidden_of, write_masked_site
from scenes.small_site import FRAMES, NAME, SmallSite

from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import msg_to_array, msg_to_depth
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.graph import describe
from ltm_ros.launching.runner import Runner
from ltm_ros.recordings.replay.offline import Selection
from ltm_ros.recordings.replay.run import LivePlayer, ReplayOptions, run_offline
from ltm_ros.runtime.topics import DEPTH_IMAGE, FUEL_VOTES, FUSED_DEPTH, LABELS_IMAGE, camera_topic

# What masks do is tested in tests/replay/test_masks.py, that a living graph makes what a replay makes in test_layouts.
pytestmark = [pytest.mark.graph, pytest.mark.slow]

HIDDEN = {LABELS_IMAGE: 255.0, DEPTH_IMAGE: np.nan, FUSED_DEPTH: np.nan}


def test_the_living_graph_keeps_to_the_masks(small_site: SmallSite, ros_domain: int, tmp_path: Path) -> None:
    path = write_masked_site(small_site)
    site = load_site(path)
    graph = describe(site, path, sim_time=True, record={"bag": str(tmp_path / "live")})
    with Runner(graph, domain_id=ros_domain, log_folder=tmp_path / "log", console=lambda line: None) as runner:
        runner.wait_until_ready(120.0)
        with LivePlayer(Selection.open(small_site.bag, site), rate=0.25) as player:
            player.wait_for_listeners(len(graph), 60.0)
            player.play()
            assert player.drain([node.full_name for node in graph]), player.summaries
    run_offline(small_site.bag, path, ReplayOptions(record=tmp_path / "offline"), lambda done, total: None)
    live, offline = (BagReader(tmp_path / name, allow_damaged=False) for name in ("live", "offline"))
    for camera in ("tower", "mast"):
        hidden = hidden_of(camera)
        for topic, nothing in HIDDEN.items():
            name = camera_topic(NAME, camera, topic)
            found = [live.decode(message) for message in live.messages([name])]
            assert len(found) == FRAMES
            for message in found:
                values = msg_to_array(message, ("mono8",)) if topic is LABELS_IMAGE else msg_to_depth(message)
                np.testing.assert_array_equal(values[hidden], nothing)
                assert (values[~hidden] != nothing).any()
        name = camera_topic(NAME, camera, FUEL_VOTES)
        votes = [{stamp_of(m): bytes(m.data) for m in map(bag.decode, bag.messages([name]))} for bag in (live, offline)]
        assert votes[0] == votes[1]
