"""What labels may call sky."""

from __future__ import annotations

import numpy as np

from ltm_core.depth.unseen_terrain import with_labelled_sky

SKY, LAND = 0, 4
nan, inf = np.nan, np.inf


def test_unknown_under_sky_becomes_sky() -> None:
    depth = np.array([[nan, nan, inf, nan], [nan, nan, nan, nan], [nan, 9, nan, nan], [7, nan, 5, nan]], np.float32)
    labels = np.array([[0, 0, 0, LAND], [0, 0, 0, 0], [LAND, 0, 0, 0], [LAND, 0, LAND, 0]], np.uint8)
    found = with_labelled_sky(depth, labels, SKY)
    # The first column ends at land, the second at known ground (a lake below it is none), the fourth begins with land.
    expected = [[inf, inf, inf, nan], [inf, inf, inf, nan], [nan, 9, inf, nan], [7, nan, 5, nan]]
    np.testing.assert_array_equal(found, np.array(expected, np.float32))
    assert np.isnan(depth[0, 0])


def test_what_is_known_stays_as_it_is() -> None:
    depth = np.array([[inf, inf, 4], [3, nan, 2]], np.float32)
    assert with_labelled_sky(depth, np.array([[0, LAND, 0], [0, 0, 0]], np.uint8), SKY) is depth
