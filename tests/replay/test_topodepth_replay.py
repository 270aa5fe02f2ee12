"""Offline replay of a site with a depth network: every frame comes out fused, twice the same."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.networks import write_depth_network
from scenes.small_site import FRAMES, NAME, SmallSite

from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import msg_to_depth
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.nodes.fuel_votes import FuelVotesHandler
from ltm_ros.nodes.terrain import TerrainHandler
from ltm_ros.nodes.topodepth import TopoDepthHandler
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline
from ltm_ros.runtime.handler import Handler
from ltm_ros.runtime.topics import DEPTH_IMAGE, FUSED_DEPTH, FUSED_INFO, camera_topic


def test_every_frame_of_every_camera_is_fused(small_site: SmallSite, tmp_path: Path) -> None:
    write_depth_network(small_site.folder)
    content = yaml.safe_load(small_site.path.read_text()) | {"depth_model": "depth.yaml"}
    path = small_site.folder / "with_depth.yaml"
    path.write_text(yaml.safe_dump(content))
    summaries = run_offline(small_site.bag, path, ReplayOptions(record=tmp_path / "bag"), lambda done, total: None)
    assert {name: s["dropped"] for name, s in summaries.items()} == dict.fromkeys(summaries, "0")
    reader = BagReader(tmp_path / "bag", allow_damaged=False)
    for camera in ("tower", "mast"):
        summary = summaries[f"/{NAME}/{camera}/topodepth"]
        assert "noted.unlabelled" not in summary
        topics = {topic: camera_topic(NAME, camera, topic) for topic in (DEPTH_IMAGE, FUSED_DEPTH, FUSED_INFO)}
        found = {topic: [] for topic in topics}  # type: ignore[var-annotated]
        for topic, name in topics.items():
            found[topic] = [reader.decode(message) for message in reader.messages([name])]
        infos = [json.loads(message.data) for message in found[FUSED_INFO]]
        assert len(infos) == len(found[FUSED_DEPTH]) == FRAMES
        print(camera, Counter(info["verdict"] for info in infos))
        for traced, fused, info in zip(found[DEPTH_IMAGE], found[FUSED_DEPTH], infos, strict=True):
            assert traced.header == fused.header
            # Painted squares are no depth: whatever the verdict, the terrain's answer flows.
            assert info["verdict"] != "ok" or info["inlier_ratio"] > 0
            a, b = msg_to_depth(traced), msg_to_depth(fused)
            known = np.isfinite(a) & np.isfinite(b)
            assert known.mean() > 0.5
            assert np.median(np.abs(b[known] / a[known] - 1)) < 0.05


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
