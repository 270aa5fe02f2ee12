"""Votes against a count by hand, pixel by pixel."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenes.traced_votes import cast_votes

from ltm_core.fuel.class_map import UNSEEN, MajorityFuelMap
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.range_image import RangeImage
from ltm_core.raster.dem import Dem

pytestmark = pytest.mark.kernel

CAMERA = Camera(7, 5, 4.0, 4.5, 2.5, 2.0, (-0.05, 0.01, 0.0, 0.001, 0.0))
DEM = Dem(np.arange(120, dtype=np.float32).reshape(10, 12), GridGeometry(-180.0, 150.0, 30.0, 12, 10))
FUEL = GridGeometry(-90.0, 60.0, 30.0, 6, 4)
ranges_ = arrays(
    np.float32, (5, 7), elements=st.one_of(st.floats(0.125, 300, width=32), st.sampled_from([np.inf, np.nan]))
)
labels_ = arrays(np.uint8, (5, 7), elements=st.sampled_from([0, 1, 2, 3, 4, 9, 255]))
poses = st.builds(
    Pose.from_angles,
    st.tuples(st.floats(-60, 60), st.floats(-60, 60), st.floats(0, 90)),
    st.floats(0, 360),
    st.floats(-90, 10),
    st.floats(-30, 30),
)
voting = st.tuples(st.just(False), *[st.booleans()] * 4)


@settings(max_examples=120, deadline=None)
@given(ranges_, labels_, poses, voting, st.sampled_from([np.inf, 150.0, 20.0]))
def test_counted_by_hand(
    slant: np.ndarray, labels: np.ndarray, pose: Pose, votes_for: tuple[bool, ...], max_range: float
) -> None:
    ranges = RangeImage(slant, CAMERA, pose, 1e-4)
    votes = cast_votes(ranges, labels, FUEL, DEM, np.array(votes_for), 5, "north", max_range)

    points = ranges.points()
    count: Counter[tuple[int, int, int]] = Counter()
    for v in range(5):
        for u in range(7):
            label, (x, y, _) = int(labels[v, u]), points[v, u].astype(float)
            if label >= 5 or not votes_for[label] or not slant[v, u] <= max_range or np.isinf(slant[v, u]):
                continue
            col, row = int((x + 90) // 30), int((60 - y) // 30)
            if 0 <= row < 4 and 0 <= col < 6:
                count[row, col, label] += 1

    cells = list(zip(votes.rows.tolist(), votes.cols.tolist(), strict=True))
    assert cells == sorted({(row, col) for row, col, _ in count})
    for (row, col), counts, z in zip(cells, votes.counts, votes.z, strict=True):
        assert counts.tolist() == [count[row, col, label] for label in range(5)]
        # The DEM's surface is a plane: 1 m a cell eastwards, 12 m a cell southwards; fuel edges are its own.
        assert z == (row + 3) * 12 + col + 3

    fuel = MajorityFuelMap(FUEL, 5)
    fuel.add(votes)
    for row, col in np.ndindex(FUEL.shape):
        here = [count[row, col, label] for label in range(5)]
        assert fuel.classes()[row, col] == (here.index(max(here)) if any(here) else UNSEEN)
