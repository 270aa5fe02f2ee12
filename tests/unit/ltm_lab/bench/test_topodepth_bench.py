"""The bench of fusion measures what a node does, on a frame that is fused in earnest."""

from __future__ import annotations

from ltm_lab.bench.topodepth import run


def test_every_part_and_the_whole_are_timed() -> None:
    costs = run(320, 180, repeats=1, extent=1000)
    assert [cost.part for cost in costs][-1] == "whole"
    assert len({cost.part for cost in costs}) == 12
    assert all(cost.cost.wall_ms > 0 for cost in costs)
