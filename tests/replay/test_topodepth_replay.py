"""Offline replay of a site with a depth network and a terrain: in which order its nodes finish."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from scenes.networks import write_depth_network
from scenes.small_site import SmallSite

from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.nodes.fuel_votes import FuelVotesHandler
from ltm_ros.nodes.terrain import TerrainHandler
from ltm_ros.nodes.topodepth import TopoDepthHandler
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline
from ltm_ros.runtime.handler import Handler


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
