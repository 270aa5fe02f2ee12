"""Thinning, for any frames: there is room afterwards, no view is lost while one could be kept, and the newest stay."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ltm_core.uplink.outbox_io import thinned

FRAMES = st.lists(st.tuples(st.integers(0, 10**15), st.integers(0, 5), st.integers(1, 64_000)), min_size=1, max_size=60)


@given(FRAMES, st.floats(0, 1.2))
def test_there_is_room_and_nothing_goes_without_need(frames: list[tuple[int, int, int]], share: float) -> None:
    stamps, views, sizes = (np.array(column, np.int64) for column in zip(*frames, strict=True))
    spare = round(share * sizes.sum())
    gone = thinned(stamps, views, sizes, spare)
    assert sizes[gone].sum() >= min(spare, sizes.sum())
    assert gone.any() == (spare > 0)


@given(FRAMES, st.floats(0, 1))
def test_no_view_is_lost_while_another_has_two_frames(frames: list[tuple[int, int, int]], share: float) -> None:
    stamps, views, sizes = (np.array(column, np.int64) for column in zip(*frames, strict=True))
    gone = thinned(stamps, views, sizes, round(share * sizes.sum()))
    left, counts = np.unique(views[~gone], return_counts=True)
    lost = set(views.tolist()) - set(left.tolist())
    assert not lost or not (counts > 1).any()


@given(FRAMES)
def test_a_little_room_is_made_among_the_older_half(frames: list[tuple[int, int, int]]) -> None:
    stamps, views, sizes = (np.array(column, np.int64) for column in zip(*frames, strict=True))
    gone = thinned(stamps, views, sizes, 1)
    order = np.argsort(stamps, kind="stable")
    older = order[: (len(order) + 1) // 2]
    if len(np.unique(views[older])) < len(older):
        assert set(np.flatnonzero(gone)) <= set(older.tolist())
