"""What the largest messages that are taken cost each node, and that larger ones cost nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltm_lab.bench.message_bounds import dropped, nodes_at_bound


@pytest.mark.slow
def test_no_node_holds_a_gigabyte_and_what_is_larger_is_dropped(tmp_path: Path) -> None:
    nodes = {use.node: use.most_mb for use in nodes_at_bound(tmp_path)}
    assert {"east/capture", "east/depth", "east/segmentation", "east/topodepth", "terrain"} < nodes.keys()
    assert max(nodes.values()) < 1000, nodes
    drops = list(dropped(tmp_path))
    assert len(drops) == 5
    assert {drop.cause for drop in drops} == {"dropped.too_large"}
    assert max(drop.grown_mb for drop in drops) < 20
