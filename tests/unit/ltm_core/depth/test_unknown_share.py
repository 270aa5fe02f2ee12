"""How much of a picture is unknown, and the likely reason."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.depth.unseen_terrain import unknown_share


def picture() -> np.ndarray:
    """400 x 240: the upper half sky, the lower known ground."""
    depth = np.full((240, 400), 50.0, np.float32)
    depth[:120] = np.inf
    return depth


@pytest.mark.parametrize(
    ("part", "name", "reason"),
    [
        ((slice(60, 120), slice(0, 400)), "beyond", "beyond the DEM's edge"),
        ((slice(160, 200), slice(40, 400)), "between", "holes"),
        ((slice(180, 240), slice(0, 400)), "before", "beyond the DEM's edge"),
        ((slice(0, 240), slice(100, 300)), "no_ground", "misses the DEM"),
    ],
)
def test_where_it_lies_tells_the_reason(part: tuple[slice, slice], name: str, reason: str) -> None:
    depth = picture()
    depth[part] = np.nan
    share = unknown_share(depth)
    assert getattr(share, name) == pytest.approx(np.isnan(depth).mean(), abs=0.01)
    assert share.whole == getattr(share, name)
    assert reason in share.reason
    assert f"{np.isnan(depth).mean():.0%}" in share.reason


def test_a_picture_that_is_known() -> None:
    assert unknown_share(picture()).whole == 0.0
